"""The initial values of unmeasured states, estimated so that a free run meets the first measurements."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from registry.dynamics.model import PhysicsModel

SETTLING = 100
"""Samples for which the first input is held: the steady state that it leads to is the first guess."""
STEPS = 12
"""Levenberg–Marquardt steps."""
PROBE, DAMPING = 1e-4, 1e-3
"""Relative step of the difference quotients; damping at the start, as a share of the curvature."""


def estimate_initial_state(
    model: PhysicsModel, first: Tensor, hidden: Sequence[int], inputs: Tensor, measured: Tensor, dt: float
) -> Tensor:
    """Unmeasured states (B, H) at the first of N samples, from which a free run is nearest to the measured ones.

    Args:
        model: whose state proper has s components.
        first: (B, s) at the first sample; what it says of the hidden ones is not looked at.
        hidden: the H places in it that were not measured.
        inputs: (B, N, m).
        measured: (B, N, s); of the places that were measured.
        dt: [s].
    """
    seen = [i for i in range(first.shape[-1]) if i not in hidden]
    at, dtype = list(hidden), first.dtype
    first, inputs, measured = (x.double() for x in (first, inputs, measured[..., seen]))
    scale = measured.abs().amax((0, 1)).clamp(min=torch.finfo(dtype).tiny)

    def misfit(values: Tensor) -> Tensor:
        """(B, (N−1)·seen) of initial values (B, H)."""
        state = model.initial(_with(first, at, values), inputs[:, 0], dt)
        met = []
        for k in range(1, inputs.shape[1]):
            state = model.step(state, inputs[:, k - 1], inputs[:, k], dt)
            met.append((state[:, seen] - measured[:, k]) / scale)
        return torch.nan_to_num(torch.cat(met, -1), nan=1e3, posinf=1e3, neginf=-1e3)

    return _levenberg_marquardt(misfit, _steady_state(model, first, at, inputs[:, 0], dt)).to(dtype)


def _with(state: Tensor, at: list[int], values: Tensor) -> Tensor:
    changed = state.clone()
    changed[:, at] = values
    return changed


def _steady_state(model: PhysicsModel, first: Tensor, at: list[int], held: Tensor, dt: float) -> Tensor:
    """The hidden states (B, H) after the first input for long, with the measured ones held."""
    values = torch.zeros_like(first[:, at])
    state = model.initial(_with(first, at, values), held, dt)
    for _ in range(SETTLING):
        after = model.step(state, held, held, dt)
        values = after[:, at]
        state = torch.cat([_with(first, at, values), after[:, first.shape[-1] :]], -1)
    return torch.nan_to_num(values, nan=1.0, posinf=1.0, neginf=1.0)


def _levenberg_marquardt(misfit: Callable[[Tensor], Tensor], guess: Tensor) -> Tensor:
    """(B, H) of least squared misfit, each row by itself."""
    found, damping = guess, torch.full_like(guess[:, :1, None], DAMPING)
    probe = PROBE * (guess.abs() + 1e-2)
    for _ in range(STEPS):
        base = misfit(found)
        moved = [
            found + torch.nn.functional.one_hot(torch.tensor(i), found.shape[1]) * probe for i in range(len(found.T))
        ]
        slopes = torch.stack([misfit(m) - base for m in moved], -1) / probe.unsqueeze(-2)
        gram = slopes.mT @ slopes
        curvature = gram.diagonal(dim1=-2, dim2=-1)
        gram = gram + torch.diag_embed(curvature * damping[..., 0] + torch.finfo(gram.dtype).tiny + 1e-12)
        tried = found - torch.linalg.solve(gram, slopes.mT @ base.unsqueeze(-1))[..., 0]
        better = misfit(tried).square().sum(-1, keepdim=True) < base.square().sum(-1, keepdim=True)
        found = torch.where(better, tried, found)
        damping = torch.where(better.unsqueeze(-1), damping / 5, damping * 10)
    return found
