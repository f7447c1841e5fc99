"""Simulators that made recordings, as a smoother sees them: what is unknown at the start, what is measured."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.dynamics.rotations import quaternion_rate, rotation_matrix
from registry.effects.air import Wind
from registry.physics.helicopter import Helicopter
from registry.physics.quadrotor import Quadrotor

P, V, Q, W = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13)
"""Position, velocity, attitude and body rates in the state of a rigid body."""
Measured = Mapping[str, Tensor]
"""Signal → (…, N, k), SI."""


class KnownFlight(ABC):
    """A simulator of a vehicle, and how its flights are measured."""

    measured: ClassVar[tuple[str, ...]]
    """Signals of the history that the start is estimated from."""
    told: ClassVar[tuple[str, ...]]
    """Signals that it predicts."""
    unknowns: ClassVar[int]
    """Numbers that the start is off by."""

    def __init__(self, model: Any, dt: float) -> None:
        self.model, self.dt = model, dt

    @property
    @abstractmethod
    def size(self) -> int:
        """Numbers s of its state."""

    @abstractmethod
    def begin(self, seen: Measured, u: Tensor) -> Tensor:
        """A first guess (…, s) of the state at the first sample of the history, whose inputs are (…, τ, m)."""

    @abstractmethod
    def moved(self, state: Tensor, by: Tensor) -> Tensor:
        """A state (…, s) changed by (…, unknowns)."""

    @abstractmethod
    def off(self, run: Tensor, seen: Measured) -> Tensor:
        """States (…, τ, s) of a run off the measured signals (…, r), each in units of its 1σ."""

    @abstractmethod
    def predicted(self, run: Tensor) -> dict[str, Tensor]:
        """The signals `told` (…, T, k), as they are measured, of states (…, T + 1, s), the first one at k0."""

    def unlikely(self, by: Tensor) -> Tensor:
        """What was known of the unknowns before, (…, q) in units of 1σ; here nothing."""
        return by[..., :0]

    def step(self, state: Tensor, before: Tensor, after: Tensor) -> Tensor:
        """One sampling period, from inputs (…, m) to the next ones."""
        return self.model.step(state, before, after, self.dt)

    def run(self, state: Tensor, u: Tensor) -> Tensor:
        """States (…, N, s) at the samples of the inputs (…, N, m), the first as given."""
        states = [state]
        for k in range(1, u.shape[-2]):
            states.append(self.step(states[-1], u[..., k - 1, :], u[..., k, :]))
        return torch.stack(states, -2)


class KnownQuadrotor(KnownFlight):
    """Poses are measured; velocity and body rates are their differences over a sampling period."""

    measured = "attitude", "position", "velocity", "body_rates"
    told = "velocity", "body_rates"
    unknowns = 12
    noise: ClassVar[tuple[float, float]] = 4e-4, 9e-5
    """1σ of the white errors of position [m] and attitude [rad], as the flights were measured: their ratio counts."""

    @property
    @override
    def size(self) -> int:
        return 13

    @override
    def begin(self, seen: Measured, u: Tensor) -> Tensor:
        pose = [seen[s][..., 0, :] for s in ("position", "velocity", "attitude", "body_rates")]
        return self.model.project(torch.cat(pose, -1))

    @override
    def moved(self, state: Tensor, by: Tensor) -> Tensor:
        turned = state[..., Q] + quaternion_rate(state[..., Q], by[..., 6:9])
        return self.model.project(torch.cat([state[..., P] + by[..., :3], state[..., V] + by[..., 3:6], turned,
                                             state[..., W] + by[..., 9:]], -1))  # fmt: skip

    @override
    def off(self, run: Tensor, seen: Measured) -> Tensor:
        place, turn = run[..., P] - seen["position"], rotation(seen["attitude"], run[..., Q])
        return torch.cat([place / self.noise[0], turn / self.noise[1]], -1).flatten(-2)

    @override
    def predicted(self, run: Tensor) -> dict[str, Tensor]:
        turned = rotation(run[..., :-1, Q], run[..., 1:, Q])
        return {"velocity": run[..., P].diff(dim=-2) / self.dt, "body_rates": turned / self.dt}


class KnownHelicopter(KnownFlight):
    """Velocity, attitude and body rates are measured with white noise; the wind is not, and stays as it is guessed.

    State: [that of the helicopter with what its delayed inputs remember | wind along world x and y].
    """

    measured = "velocity", "attitude", "body_rates"
    told = "velocity", "body_rates", "euler_rates"
    unknowns = 17
    noise: ClassVar[tuple[float, float, float]] = 0.03, 0.0035, 0.006
    """1σ of velocity [m/s], attitude [rad] and body rates [rad/s], as the flights were measured."""
    scatter: ClassVar[tuple[float, float, float]] = 0.2, 0.1, 1.7
    """1σ, before anything is measured, of a servo about the stick, of a disc's tilt [rad], and of the wind [m/s], its
    steady part and gusts together."""

    @property
    @override
    def size(self) -> int:
        remembered = sum(e.memory_size(4, self.dt) for e in self.model.input_effects())
        return len(self.model.state_channels) + remembered + 2

    @override
    def begin(self, seen: Measured, u: Tensor) -> Tensor:
        velocity, attitude, rates = (seen[s][..., 0, :] for s in self.measured)
        none = velocity.new_zeros(*velocity.shape[:-1], 2)
        state = torch.cat([0 * velocity, velocity, attitude, rates, u[..., 0, :], none], -1)
        return torch.cat([self.model.initial(self.model.project(state), u[..., 0, :], self.dt), none], -1)

    @override
    def moved(self, state: Tensor, by: Tensor) -> Tensor:
        speed, turn, spin, inside, wind = by.split([3, 3, 3, 6, 2], -1)
        turned = state[..., Q] + quaternion_rate(state[..., Q], turn)
        turned = turned / turned.square().sum(-1, keepdim=True).sqrt()
        parts = [state[..., P], state[..., V] + speed, turned, state[..., W] + spin, state[..., 13:19] + inside,
                 state[..., 19:-2], state[..., -2:] + wind]  # fmt: skip
        return torch.cat(parts, -1)

    @override
    def unlikely(self, by: Tensor) -> Tensor:
        servo, disc, wind = self.scatter
        return torch.cat([by[..., 9:13] / servo, by[..., 13:15] / disc, by[..., 15:] / wind], -1)

    @override
    def step(self, state: Tensor, before: Tensor, after: Tensor) -> Tensor:
        full, wind = state[..., :-2], state[..., -2:]
        calm = tuple(e for e in self.model.effects if not isinstance(e, Wind))
        model = replace(self.model, effects=(*calm, Wind(w_x=wind[..., 0], w_y=wind[..., 1])))
        return torch.cat([model.step(full, before, after, self.dt), wind], -1)

    @override
    def off(self, run: Tensor, seen: Measured) -> Tensor:
        velocity, attitude, rates = self.noise
        parts = [(run[..., V] - seen["velocity"]) / velocity, rotation(seen["attitude"], run[..., Q]) / attitude,
                 (run[..., W] - seen["body_rates"]) / rates]  # fmt: skip
        return torch.cat(parts, -1).flatten(-2)

    @override
    def predicted(self, run: Tensor) -> dict[str, Tensor]:
        run = run[..., 1:, :]
        rates = run[..., W]
        return {"velocity": run[..., V], "body_rates": rates, "euler_rates": euler_rates(run[..., Q], rates)}


def known(model: Any, dt: float) -> KnownFlight | None:
    """The simulator, if it is one of those above."""
    if isinstance(model, Quadrotor):
        return KnownQuadrotor(model, dt)
    return KnownHelicopter(model, dt) if isinstance(model, Helicopter) else None


def rotation(first: Tensor, second: Tensor) -> Tensor:
    """The small rotation (…, 3) [rad], in body axes, that takes one attitude xyzw (…, 4) to another."""
    v0, w0, v1, w1 = first[..., :3], first[..., 3:], second[..., :3], second[..., 3:]
    vector = w0 * v1 - w1 * v0 - torch.linalg.cross(v0, v1)
    return 2 * vector * torch.sign(w0 * w1 + (v0 * v1).sum(-1, keepdim=True))


def euler_rates(attitude: Tensor, rates: Tensor) -> Tensor:
    """Time derivatives (…, 3) of Euler ZYX angles at attitudes xyzw (…, 4) and body rates (…, 3)."""
    turned = rotation_matrix(attitude)
    sine = -turned[..., 2, 0]  # of the pitch
    cosine = (1 - sine.square()).sqrt()
    sin_roll, cos_roll = turned[..., 2, 1] / cosine, turned[..., 2, 2] / cosine
    p, q, r = rates.unbind(-1)
    turn = sin_roll * q + cos_roll * r
    return torch.stack([p + sine / cosine * turn, cos_roll * q - sin_roll * r, turn / cosine], -1)
