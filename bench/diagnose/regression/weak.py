"""The weak form: changes of the measured state against the model's integral, through smooth test functions.

With a test function φ (a Hann window over intervals) the residual of ẋ = f(x, u) is

    r_j = Σ_k φ_jk (x_{k+1} − x_k) − dt Σ_k φ_jk (κ ∗ f)_k,

where κ is the smoothing that the measured states went through. Nothing is differentiated and no initial state is
needed; as κ acts on both sides, a smoothed rate is not taken for a weak motor. After Messenger and Bortz, "Weak
SINDy" (2021).
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import torch
from scipy import sparse
from torch import Tensor

from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import Log
from registry.dynamics import Effect, InternalEffect, Motion, PhysicsModel
from registry.errors import BenchError
from registry.physics.rigid_body import RigidBody

M = TypeVar("M", bound=PhysicsModel)


@dataclass(frozen=True, eq=False)
class Stack:
    """Logs of one rate side by side, the shorter ones padded with their last sample."""

    logs: tuple[Log, ...]
    states: Tensor
    """(L, N, s)."""
    inputs: Tensor
    """(L, N, m)."""
    dt: float

    @classmethod
    def of(cls, logs: Sequence[Log]) -> "Stack":
        """Stack ``logs``.

        Raises:
            BenchError: they were sampled at different rates.
        """
        rates = {log.rate for log in logs}
        if len(rates) != 1:
            raise BenchError(f"The recordings were sampled at {sorted(rates)} Hz: resample them to one rate first.")
        longest = max(map(len, logs))

        def padded(x: Tensor) -> Tensor:
            return torch.cat([x, x[-1:].expand(longest - len(x), -1)])

        states = torch.stack([padded(log.states) for log in logs])
        return cls(tuple(logs), states, torch.stack([padded(log.inputs) for log in logs]), logs[0].dt)


def mean_rates(model: PhysicsModel, stack: Stack) -> Tensor:
    """The model's rates (…, L, N − 1, s) of the state proper over each sampling interval, at the measured states.

    The model's constants and its effects' parameters may be tensors (…, 1, 1), for many models at once.
    """
    size = stack.states.shape[-1]
    before, after = stack.states[:, :-1], stack.states[:, 1:]
    u0, u1 = stack.inputs[:, :-1], stack.inputs[:, 1:]
    held = model.input_hold == "previous"
    if model.input_effects():
        acting = _transmitted(model, stack)
        middle, slopes = acting[..., 1, :], (acting[..., 2, :] - acting[..., 0, :]) / stack.dt
    else:
        middle, slopes = (u0, torch.zeros_like(u0)) if held else ((u0 + u1) / 2, (u1 - u0) / stack.dt)
    state, many = model.project((before + after) / 2), how_many(model)
    if many is not None:
        state = state.expand(many, *state.shape)
        middle = middle.expand(many, *middle.shape[-3:])
        slopes = slopes.expand(many, *slopes.shape[-3:])
    if model.internal_size:
        path = _own_path(model, stack, middle, slopes)
        own = (path[..., :-1, :] + path[..., 1:, :]) / 2
        state = torch.cat([state.expand(*own.shape[:-1], size), own], dim=-1)
    return model.derivative(state, middle, slopes)[..., :size]


def _transmitted(model: PhysicsModel, stack: Stack) -> Tensor:
    """What acts (…, L, N − 1, 3, m) at start, middle and end of each interval, after delays and lags."""
    return _pass(model, stack)[1]


def memories(model: PhysicsModel, stack: Stack) -> Tensor:
    """Memories (…, L, N, size) of delays and lags at every sample, as the inputs until then left them."""
    return _pass(model, stack)[0]


def _pass(model: PhysicsModel, stack: Stack) -> tuple[Tensor, Tensor]:
    many, narrow = how_many(model), narrowed(model)
    before, after = stack.inputs[:, :-1], stack.inputs[:, 1:]
    held = model.input_hold == "previous"
    segments = torch.stack([before, before, before] if held else [before, (before + after) / 2, after], dim=-2)
    if many is not None:
        segments = segments.expand(many, *segments.shape)
    driving, extras = segments.split([segments.shape[-1] - len(model.extras), len(model.extras)], dim=-1)
    parts = []
    for effect in narrow.input_effects():
        memory, driving = effect.over(driving[..., 0, 0, :], driving, stack.dt, held)
        parts.append(memory)
    return torch.cat(parts, dim=-1), torch.cat([driving, extras], dim=-1)


def own_states(model: PhysicsModel, stack: Stack) -> Tensor:
    """The effects' own states (…, L, N, i) at every sample, driven by the measured states."""
    u0, u1 = stack.inputs[:, :-1], stack.inputs[:, 1:]
    held = model.input_hold == "previous"
    middle, slopes = (u0, torch.zeros_like(u0)) if held else ((u0 + u1) / 2, (u1 - u0) / stack.dt)
    return _own_path(model, stack, middle, slopes)


def _own_path(model: PhysicsModel, stack: Stack, middle: Tensor, slopes: Tensor) -> Tensor:
    many, narrow, size = how_many(model), narrowed(model), stack.states.shape[-1]
    shape: tuple[int, ...] = (len(stack.logs),)
    if many is not None:
        shape = (many, *shape)
        middle = middle.expand(many, *middle.shape[-3:])
        slopes = slopes.expand(many, *slopes.shape[-3:])
    states = model.project((stack.states[:, :-1] + stack.states[:, 1:]) / 2)
    own = stack.states.new_zeros(*shape, model.internal_size)
    if isinstance(model, RigidBody):
        rate = _swing_rates(model, states, middle, slopes)
    else:

        def rate(k: int, own: Tensor) -> Tensor:
            at = states[:, k].expand(*shape, size)
            return narrow.derivative(torch.cat([at, own], dim=-1), middle[..., k, :], slopes[..., k, :])[..., size:]

    path = [own]
    for k in range(states.shape[1]):
        own = own + stack.dt * rate(k, own + stack.dt / 2 * rate(k, own))
        path.append(own)
    return torch.stack(path, dim=-2)


def _swing_rates(model: RigidBody, states: Tensor, middle: Tensor, slopes: Tensor) -> Callable[[int, Tensor], Tensor]:
    """Rates of the own states of a rigid body's effects at interval k: all that does not depend on them at once."""
    narrow = narrowed(model)
    seen, _, _, _, acceleration = model.unloaded(states, middle, slopes)
    constants = narrow.unloaded(states[:, 0], middle[..., 0, :], slopes[..., 0, :])[0].model
    effects = [e for e in narrow.effects if isinstance(e, InternalEffect)]

    def rate(k: int, own: Tensor) -> Tensor:
        now = Motion(
            constants,
            seen.position[..., k, :],
            seen.velocity[..., k, :],
            seen.rotation[..., k, :, :],
            seen.body_rates[..., k, :],
            seen.air_velocity[..., k, :],
            seen.inputs[..., k, :],
            seen.input_rates[..., k, :],
            seen.thrust[..., k, :],
            {name: x[..., k] for name, x in seen.extras.items()},
        )
        rates, at = [], 0
        for effect in effects:
            size = effect.internal_size
            rates.append(effect.internal_rate(replace(now, internal=own[..., at : at + size]), acceleration[..., k, :]))
            at += size
        return torch.cat(rates, dim=-1)

    return rate


def how_many(model: PhysicsModel) -> int | None:
    """How many models the parameters (B, 1, 1) stand for; None: numbers."""
    sizes = [v.shape[0] for _, v in _tensors(model, *model.effects)]
    return max(sizes) if sizes else None


def _tensors(*owners: PhysicsModel | Effect) -> list[tuple[str, Tensor]]:
    return [(p.name, p.value) for o in owners for p in o.parameters() if isinstance(p.value, Tensor)]


def narrowed(model: M) -> M:
    """The model with parameters (B, 1) in place of (B, 1, 1): for one time step at a time."""

    def narrow(owner: PhysicsModel | Effect) -> dict[str, Tensor]:
        return {name: value.squeeze(1) for name, value in _tensors(owner)}

    changes: dict[str, Any] = narrow(model)
    effects = tuple(dataclasses.replace(e, **narrow(e)) for e in model.effects)
    return dataclasses.replace(model, effects=effects, **changes)


@dataclass(frozen=True, eq=False)
class TestFunctions:
    """Hann windows over the sampling intervals of each log, none of which touches an invalid sample."""

    measured: tuple[sparse.csr_matrix, ...]
    """A log: (J, N − 1), for measured increments."""
    modelled: tuple[tuple[sparse.csr_matrix, ...], ...]
    """A log, a channel: (J, N − 1) with the channel's smoothing, for the model's."""
    centres: tuple[np.ndarray, ...]
    """A log: (J,) middle of each window [samples]."""
    hop: int
    """Samples from one window to the next; a window spans two hops."""

    @classmethod
    def over(cls, logs: Sequence[Log], hop: int, smoothing: Sequence[Smoothing]) -> "TestFunctions":
        """Windows every ``hop`` samples over ``logs``; ``smoothing`` of each channel that is looked at."""
        hann = np.hanning(2 * hop + 1)
        bump = hann[:-1] + hann[1:]
        bump = bump / bump.sum() * hop  # windows half a span apart add up to one
        kernels = [s.kernel() for s in smoothing]
        reach = max(len(k) // 2 for k in kernels)
        measured, modelled, centres = [], [], []
        for log in logs:
            intervals = len(log) - 1
            starts = np.arange(reach, intervals - 2 * hop - reach + 1, hop)
            good = (log.valid[:-1] & log.valid[1:]).numpy()
            bad = np.concatenate([[0], np.cumsum(~good)])
            starts = starts[bad[starts + 2 * hop + reach] == bad[starts - reach]] if len(starts) else starts
            measured.append(_rows(bump, starts, intervals))
            by = {k.tobytes(): _rows(np.convolve(bump, k), starts - len(k) // 2, intervals) for k in kernels}
            modelled.append(tuple(by[k.tobytes()] for k in kernels))
            centres.append(starts + hop)
        return cls(tuple(measured), tuple(modelled), tuple(centres), hop)

    def increment(self, log: int, states: np.ndarray) -> np.ndarray:
        """Weighted increments (J, channels) of measured states (N, channels) of the log of that number."""
        out: np.ndarray = self.measured[log] @ np.diff(states, axis=0)
        return out

    def integral(self, log: int, rates: np.ndarray, dt: float) -> np.ndarray:
        """Weighted integrals (c, J, channels) of rates (c, ≥ N − 1, channels) over the log of that number."""
        used = rates[:, : self.measured[log].shape[1]]
        return np.stack([(rows @ used[..., c].T).T for c, rows in enumerate(self.modelled[log])], axis=-1) * dt


def _rows(weights: np.ndarray, starts: np.ndarray, width: int) -> sparse.csr_matrix:
    columns = starts[:, None] + np.arange(len(weights))
    rows = np.repeat(np.arange(len(starts)), len(weights))
    return sparse.csr_matrix((np.tile(weights, len(starts)), (rows, columns.ravel())), shape=(len(starts), width))
