"""First-order lags with a time constant in each direction, over whole recordings."""

import math
from functools import lru_cache
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from registry.equations import lanes
from registry.equations.lanes import Lanes
from registry.equations.trace import traced


def lagged(first: Tensor, segments: Tensor, up: Tensor, down: Tensor, half: float) -> np.ndarray:
    """Speeds (2 K + 1, …, m) at the start, middle and end of K steps, in the arithmetic of `FirstOrderLag.act`.

    With one time constant in both directions what it adds is linear in the commands, and summed at once.

    Args:
        first: (…, m) speed at the start.
        segments: (…, K, 3, m) commands.
        up: (…, m) time constants [s] when rising.
        down: (…, m) when falling.
        half: of a step [s].
    """
    once = segments[tuple(slice(1) if s == 0 else slice(None) for s in segments.stride()[:-3])]  # not model by model
    alike = torch.equal(up, down)
    if not alike and lanes.available() and segments.dtype == torch.float64:
        return _by_program(first, once, up, down, half)
    given = once.movedim((-3, -2), (0, 1)).numpy()  # (K, 3, …, m)
    starts, ends = (given[:, i : i + 2].reshape(-1, *given.shape[2:]) for i in (0, 1))
    means, slopes = (starts + ends) / 2, (ends - starts) / half
    held = not slopes.any()
    taus = [t.contiguous().numpy() for t in (up, down)]
    decays = [torch.exp(-half / t.clamp(min=1e-9)).contiguous().numpy() for t in (up, down)]
    if alike:
        lagging = taus[0] * slopes  # as below
        return _decaying(first.numpy(), decays[0], ends - lagging + (lagging - starts) * decays[0])
    path = np.empty((len(starts) + 1, *first.shape), dtype=given.dtype)
    path[0] = first.numpy()
    for k, (speed, after) in enumerate(pairwise(path)):
        rising = means[k] > speed
        np.subtract(speed, starts[k], out=after)
        if held:
            after *= np.where(rising, *decays)
            after += ends[k]
        else:
            lagging = np.where(rising, *taus) * slopes[k]  # how far behind a ramp the lag settles
            after += lagging
            after *= np.where(rising, *decays)
            after += ends[k] - lagging
    return path


def _by_program(first: Tensor, segments: Tensor, up: Tensor, down: Tensor, half: float) -> np.ndarray:
    """`lagged`, half a step of every channel of every recording as one lane of a compiled program."""
    given = segments.movedim(-1, -3)  # (…, m, K, 3)
    ramps = torch.stack([given[..., :2], given[..., 1:]], dim=-2).flatten(-3, -2)  # (…, m, 2 K, 2)
    numbers = (up, down, *(torch.exp(-half / t.clamp(min=1e-9)) for t in (up, down)), torch.full_like(up, half))
    fixed = torch.stack(numbers, dim=-1).reshape(1, -1, len(numbers))
    ramps = ramps.expand(*first.shape, *ramps.shape[-2:]).reshape(1, fixed.shape[1], *ramps.shape[-2:])
    out = _half_step().run((first.reshape(1, -1, 1), ramps, fixed), 1, *ramps.shape[1:3])
    return torch.cat([first.unsqueeze(0), out.reshape(*first.shape, -1).movedim(-1, 0)]).numpy()


@lru_cache
def _half_step() -> Lanes:
    """Speed (1), command at start and end (2) and time constants, decays of each and half a step (5) → speed (1)."""

    def function(speed: Tensor, ramp: Tensor, numbers: Tensor) -> Tensor:
        (start, end), (up, down, decay_up, decay_down, half) = ramp.split(1), numbers.split(1)
        rising = (start + end) / 2 > speed
        lagging = torch.where(rising, up, down) * ((end - start) / half)  # how far behind a ramp the lag settles
        return (speed - start + lagging) * torch.where(rising, decay_up, decay_down) + (end - lagging)

    return Lanes.of(traced(function, {"speed": 1, "ramp": 2, "numbers": 5}))


def _decaying(first: np.ndarray, decay: np.ndarray, added: np.ndarray) -> np.ndarray:
    """The path (K + 1, …) of x_{k+1} = d x_k + a_k.

    Cut into √K stretches, which are summed side by side and then joined one after another.

    Args:
        first: (…) x_0.
        decay: (…) d, 0 to 1.
        added: (K, …) a.
    """
    count, shape = len(added), first.shape
    length = max(1, math.isqrt(count))
    stretches = -(-count // length)
    path = np.zeros((stretches * length + 1, *shape), dtype=added.dtype)
    path[0], path[1 : count + 1] = first, added
    parts = path[1:].reshape(stretches, length, *shape)
    powers = np.empty((length, *shape), dtype=added.dtype)
    powers[0] = decay
    for k in range(1, length):
        parts[:, k] += decay * parts[:, k - 1]
        powers[k] = decay * powers[k - 1]
    for part, before in zip(parts, path[:-1:length], strict=True):
        part += powers * before
    return path[: count + 1]
