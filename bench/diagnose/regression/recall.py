"""The own states of waves and hidden modes at every sample: no sensor shows them, what was measured before does."""

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from bench.diagnose.regression.recurrence import normal_equations
from bench.diagnose.settings import WAVING
from registry.dynamics import joined, tensor
from registry.effects.waves.hidden_mode import HiddenMode
from registry.effects.waves.periodic_term import PeriodicTerm

RECALLED = (PeriodicTerm, HiddenMode)
"""The effects whose own states only the past tells."""


def recall(
    effects: Sequence[PeriodicTerm | HiddenMode],
    good: Tensor,
    along: Mapping[str, Tensor],
    drivers: Mapping[str, Tensor],
    *,
    dt: float,
    so_far: bool,
) -> list[Tensor]:
    """The own states (…, L, N, i) of each effect at every sample.

    Modes first, each beside those before it; then waves in what the modes leave.

    Args:
        effects: in the order of the model.
        good: (L, N − 1) intervals that count.
        along: by axis, (…, L, N − 1) mean over each interval of what a model without these effects leaves.
        drivers: by signal, (…, L, N − 1) likewise.
        dt: sampling period [s].
        so_far: whether a sample knows what came before it only, or the whole recording.
    """
    left, found = dict(along), dict[int, Tensor]()
    for i, effect in enumerate(effects):
        if isinstance(effect, HiddenMode):
            parts = []
            for j, (axis, name) in enumerate(zip(effect.axes, effect.drivers, strict=True)):
                own = begun(effect, j, left[axis], drivers[name], good, dt=dt, so_far=so_far)
                parts.append(own)
                if len(effects) > 1:
                    left[axis] = left[axis] - done(effect, j, own, drivers[name])
            found[i] = joined(parts)
    for i, effect in enumerate(effects):
        if isinstance(effect, PeriodicTerm):
            found[i] = wave(left[effect.axis], good, effect.frequency, dt, so_far)
    return [found[i] for i in range(len(effects))]


def wave(left: Tensor, good: Tensor, frequency: float, dt: float, so_far: bool) -> Tensor:
    """The wave and its quadrature (…, L, N, 2) at every sample, each recording with its own amplitude and phase.

    By least squares, a constant beside it.

    Args:
        left: (…, L, N − 1) mean over each sampling interval.
        good: (L, N − 1) intervals that count.
        frequency: of the wave [Hz].
        dt: sampling period [s].
        so_far: whether a sample knows what came before it only, or the whole recording.
    """
    count = left.shape[-1]
    turn = 2 * math.pi * frequency * dt
    middle = turn * (torch.arange(count, dtype=left.dtype) + 0.5)
    seen = torch.stack([middle.cos(), middle.sin(), torch.ones_like(middle)], dim=-1)
    seen = seen * good.unsqueeze(-1)  # (L, N − 1, 3)
    gram, moment = normal_equations(seen.unsqueeze(-2), torch.where(good, left, 0.0).unsqueeze(-1), so_far)
    cycle = 1 / (frequency * dt)
    held = torch.diag(torch.tensor([WAVING.silent * cycle / 2, WAVING.silent * cycle / 2, 1.0], dtype=left.dtype))
    held = held if so_far else held * 1e-6
    both = torch.linalg.solve(gram + held, moment.unsqueeze(-1)).squeeze(-1)[..., :2]
    both = torch.where(gram[..., 2, 2].unsqueeze(-1) >= WAVING.heard * cycle, both, 0.0)
    at = turn * torch.arange(count + 1, dtype=left.dtype)
    a, b = (both[..., i].expand(*both.shape[:-2], count + 1) for i in range(2))
    return torch.stack([a * at.cos() + b * at.sin(), b * at.cos() - a * at.sin()], dim=-1)


def done(mode: HiddenMode, axis: int, path: Tensor, driver: Tensor) -> Tensor:
    """What a mode does (…, L, N − 1) along an axis, as a mean over each interval.

    Args:
        mode: parameters may be tensors (B, 1, 1).
        axis: its number.
        path: (…, L, N, order) of its states along that axis.
        driver: (…, L, N − 1).
    """
    own, gains = (path[..., :-1, :] + path[..., 1:, :]) / 2, _gains(mode, axis, driver)
    return (gains * own).sum(-1) - gains[..., 0] * driver


def _gains(mode: HiddenMode, axis: int, like: Tensor) -> Tensor:
    """ω times the gains (…, order) of one axis."""
    places = slice(mode.order * axis, mode.order * (axis + 1))
    return tensor(mode.gains, like)[..., places] * (2 * math.pi * tensor(mode.frequency, like))[..., None]


def turned(mode: HiddenMode, t: Tensor) -> Tensor:
    """e^{At} (…, order, order) of one axis at times (…) [s]; parameters may be tensors (B, 1, 1)."""
    turn = 2 * math.pi * tensor(mode.frequency, t)
    if mode.order == 1:
        return torch.exp(-turn * t)[..., None, None]
    zeta = tensor(mode.damping, t).clamp(max=1 - 1e-6)
    swing = turn * (1 - zeta * zeta).sqrt()
    decay, c, s = torch.exp(-zeta * turn * t), torch.cos(swing * t), torch.sin(swing * t) / (1 - zeta * zeta).sqrt()
    rows = [[c + zeta * s, s], [-s, c - zeta * s]]
    return torch.stack([torch.stack([decay * x for x in row], dim=-1) for row in rows], dim=-2)


def driven(mode: HiddenMode, driver: Tensor, dt: float) -> Tensor:
    """States (…, N, order) along one axis from rest, under a driver (…, N − 1), its mean over each interval.

    At rest z is the first driver. The recursion x ← D + F (x − D) is multiplied out by doubling.
    """
    step = turned(mode, torch.full((1, 1), dt, dtype=driver.dtype))  # (…, 1, 1, order, order)
    rest = torch.nn.functional.pad(driver.unsqueeze(-1), (0, mode.order - 1))
    first = rest[..., :1, :]
    rest = rest - first
    added = rest - (step @ rest.unsqueeze(-1)).squeeze(-1)
    reach, power = 1, step
    while reach < added.shape[-2]:
        before = (power @ added[..., :-reach, :].unsqueeze(-1)).squeeze(-1)
        added = torch.cat([added[..., :reach, :], added[..., reach:, :] + before], dim=-2)
        power, reach = power @ power, 2 * reach
    return torch.cat([torch.zeros_like(added[..., :1, :]), added], dim=-2) + first


def begun(
    mode: HiddenMode, axis: int, left: Tensor, driver: Tensor, good: Tensor, *, dt: float, so_far: bool
) -> Tensor:
    """The states (…, L, N, order) of one axis at every sample, each recording begun as its residual tells.

    By least squares, a constant beside what swings out.

    Args:
        mode: parameters may be tensors (B, 1, 1).
        axis: its number.
        left: (…, L, N − 1) mean over each sampling interval of what a model without the mode leaves along the axis.
        driver: (…, L, N − 1) of that axis, likewise.
        good: (L, N − 1) intervals that count.
        dt: sampling period [s].
        so_far: whether a sample knows what came before it only, or the whole recording.
    """
    path, count, order = driven(mode, driver, dt), left.shape[-1], mode.order
    gains, forced = _gains(mode, axis, left), done(mode, axis, path, driver)
    times = dt * torch.arange(count + 1, dtype=left.dtype)
    free = turned(mode, (times[:-1] + dt / 2).expand(1, -1))  # (…, 1, N − 1, order, order)
    basis = (gains.unsqueeze(-2) @ free).squeeze(-2)
    seen = torch.cat([basis, torch.ones_like(basis[..., :1])], dim=-1)
    shape = torch.broadcast_shapes(seen.shape[:-1], left.shape)
    seen = seen.expand(*shape, order + 1) * good.unsqueeze(-1)
    gram, moment = normal_equations(seen.unsqueeze(-2), torch.where(good, left - forced, 0.0).unsqueeze(-1), so_far)
    # What is known beforehand, of the whole recording, for a driver may rest long at first: the free swing is about as
    # large as the driven one, and the noise is what no free swing has.
    swung = path[..., :-1, :].square().sum(-1) - 2 * path[..., :-1, 0] * driver + driver.square()
    rough = _rough(mode, torch.where(good, left - forced, 0.0), good, dt)
    silent = (rough / swung.mean(-1).clamp_min(1e-12)).unsqueeze(-1) + 1e-9 * gains.square().sum(-1)
    held = torch.diag_embed(torch.stack([*[silent] * order, torch.ones_like(silent)], dim=-1))
    held = held + 1e-12 * torch.eye(order + 1, dtype=left.dtype)
    start = torch.linalg.solve(gram + held, moment.unsqueeze(-1))[..., :order, :]
    return path + (turned(mode, times.expand(1, -1)) @ start).squeeze(-1)


def _rough(mode: HiddenMode, told: Tensor, good: Tensor, dt: float) -> Tensor:
    """The mean square (…, L) of the noise in what a mode that swings out and noise do together over each interval.

    A free swing obeys the recursion of its characteristic polynomial; white noise is left, larger by its coefficients.
    """
    step, order = turned(mode, torch.full((1, 1), dt, dtype=told.dtype)), mode.order  # (…, 1, 1, order, order)
    recursion = [torch.ones_like(step[..., 0, 0]), -torch.diagonal(step, dim1=-2, dim2=-1).sum(-1)]
    if order == 2:
        recursion.append(torch.linalg.det(step))
    count = told.shape[-1] - order
    left = torch.stack([c * told[..., order - i : order - i + count] for i, c in enumerate(recursion)]).sum(0)
    whole = torch.stack([good[..., i : i + count] for i in range(order + 1)]).all(0)
    size = torch.stack([c.square() for c in recursion]).sum(0)
    return (whole * left.square() / size).sum(-1) / whole.sum(-1).clamp_min(1)
