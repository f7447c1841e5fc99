"""What noise alone leaves of the error of a free run: the noise floor."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from bench.diagnose.logs.noise import DERIVED_FROM, Noise, channel_indices, impulse_response
from bench.diagnose.logs.subject import Log
from bench.diagnose.settings import RUNNING
from bench.diagnose.simulate.free_run import Group, errors, past, windows
from bench.diagnose.simulate.roll import roll
from registry.contracts import Channel
from registry.dynamics import PhysicsModel


def floor(
    model: PhysicsModel, logs: Sequence[Log], at: Sequence[np.ndarray], steps: int, noise: Noise, of: Sequence[Group]
) -> Tensor:
    """Squared errors (draws, W, steps + 1, groups) that an exact model would make in the same windows.

    The model's own free run, begun a filter's reach before each window, is taken for the truth; it is measured with
    noise and smoothed as the data were; the same model, run from the smoothed start with noisy inputs, is compared with
    the smoothed rest. What the filter does to fast motion is thus part of the floor.

    Args:
        model: taken for exact.
        logs: give states to start from, and inputs.
        at: first samples of the windows of each log; none nearer than `Noise.half_width` to an end of the log.
        steps: samples of a window after its first.
        noise: of states and inputs.
        of: what is judged.
    """
    r, size = noise.half_width, len(model.state_channels)
    generator = np.random.default_rng(0)
    early = [k - r for k in at]
    inputs, dt = windows([log.inputs for log in logs], early, steps + 2 * r), logs[0].dt
    true = roll(model, past(model, logs, early), inputs, dt)
    found = []
    for _ in range(RUNNING.draws):
        measured = measure(true[..., :size], noise, model.state_channels, dt, generator)
        start = torch.cat([measured[..., 0, :], true[..., r, size:]], dim=-1)
        around = max(r, len(noise.input_weights) // 2)
        drawn = generator.normal(size=(len(start), steps + 2 * around + 1, len(noise.inputs))) * np.array(noise.inputs)
        drawn = _convolved(drawn, noise.input_weights, around)
        noisy = inputs[..., r : r + steps + 1, :] + torch.from_numpy(drawn)
        found.append(errors(roll(model, start, noisy, dt)[..., :size], measured, of))
    return torch.stack(found)


@np.errstate(invalid="ignore")  # of a model that diverged
def measure(
    states: Tensor, noise: Noise, channels: Sequence[Channel], dt: float, generator: np.random.Generator
) -> Tensor:
    """What sensors and filter make (W, N − 2 half widths, s) of true states (W, N, s)."""
    r, x = noise.half_width, states.numpy()
    groups = channel_indices(channels, [True] * len(channels))
    noisy = x + generator.normal(size=x.shape) * np.array(noise.raw)
    if "attitude" in groups:
        at = list(groups["attitude"])
        wobble = generator.normal(size=(*x.shape[:-1], 3)) * noise.raw[at[0]] / 2
        noisy[..., at] = _product(x[..., at], np.concatenate([wobble, np.ones_like(wobble[..., :1])], axis=-1))
    out = _convolved(noisy, impulse_response(noise.smoothing, False), r)
    if "attitude" in groups:
        out[..., at] /= np.linalg.norm(out[..., at], axis=-1, keepdims=True)
    for group, places in groups.items():
        if group in DERIVED_FROM and noise.derived[places[0]]:
            pose = list(groups[DERIVED_FROM[group]])
            slope = _convolved(noisy[..., pose], impulse_response(noise.smoothing, True), r) / dt
            if group == "body_rates":
                slope = 2 * _product(out[..., pose] * np.array([-1.0, -1.0, -1.0, 1.0]), slope)[..., :3]
            out[..., list(places)] = slope
    for place, read in noise.slopes.items():
        weights = impulse_response(read.smoothing, True)
        out[..., [place]] = _convolved(noisy[..., [read.of]], weights, r) / dt
    unmeasured = [i for i, s in enumerate(noise.processed) if s == 0]
    out[..., unmeasured] = x[:, r : x.shape[1] - r, unmeasured]
    return torch.from_numpy(out)


def _convolved(x: np.ndarray, weights: np.ndarray, r: int) -> np.ndarray:
    half, n = len(weights) // 2, x.shape[1] - 2 * r
    return np.asarray(sum(w * x[:, r - half + j : r - half + j + n] for j, w in enumerate(weights)))


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of quaternions xyzw (…, 4)."""
    av, aw, bv, bw = a[..., :3], a[..., 3:], b[..., :3], b[..., 3:]
    return np.concatenate([aw * bv + bw * av + np.cross(av, bv), aw * bw - (av * bv).sum(-1, keepdims=True)], axis=-1)
