"""The core of a hybrid model: a physics model that moves on by one step under what the input model gives."""

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor
from typing_extensions import override

from registry.dynamics import Parameter, PhysicsModel, tensor
from registry.kernels.rigid_body import RigidBodyStep
from registry.physics.quadrotor import Quadrotor
from registry.predictors.parts.white_box import WhiteBox

SPREAD = 10.0
"""How many of its standard deviations a fitted constant may leave its nominal value."""


class PhysicsCore(ABC):
    """Moves the state (s, B) of a physics model from sample to sample. Made anew for every run."""

    @abstractmethod
    def load(self, given: Tensor) -> Tensor:
        """What the input model gives at a sample (r, B), scaled, in SI units."""

    @abstractmethod
    def step(self, k: int, state: Tensor, start: Tensor, end: Tensor) -> Tensor:
        """State (s, B) at horizon sample ``k``, SI.

        Args:
            k: counted from 0.
            state: (s, B) at the sample before.
            start, end: loads (r, B) at the sample before and at this one.
        """


class RigidBodyCore(PhysicsCore):
    """A quadrotor without effects: thrust and torques move it; in part or in whole they come from the input model."""

    def __init__(self, box: WhiteBox, model: Quadrotor, before: Tensor, driving: Tensor, residual: bool) -> None:
        """
        Args:
            box: the model with its nominal constants.
            model: the model with constants that may be fitted.
            before: (B, d) what drives the model at k0, SI.
            driving: (B, T, d) what drives it then.
            residual: whether the nominal map of the rotor speeds is part of the load.
        """
        self.held = box.held
        x, y, z = tensor(model.inertia, before).unbind(-1)
        coupling = torch.stack([(y - z) / x, (z - x) / y, (x - y) / z])
        self.body = RigidBodyStep(box.dt, float(model.gravity), coupling)
        self.scale = before.new_tensor(magnitudes(box.model)).unsqueeze(-1)
        self.given = None
        if residual:
            series = torch.cat([before.unsqueeze(-2), driving], -2)
            old, new = series[..., :-1, :], series[..., 1:, :]
            moments = (old, old, old) if self.held else (old, (old + new) / 2, new)
            self.given = torch.stack([_accelerations(model, u) for u in moments]).permute(2, 0, 3, 1)  # (T, 3, 4, B)

    def load(self, given: Tensor) -> Tensor:
        """Thrust over mass and torques over inertia (4, B)."""
        return given * self.scale

    @override
    def step(self, k: int, state: Tensor, start: Tensor, end: Tensor) -> Tensor:
        return self.body(state, start, start if self.held else end, None if self.given is None else self.given[k])


class GeneralCore(PhysicsCore):
    """Any physics model: the input model gives the signal that drives it, or adds to it."""

    def __init__(
        self,
        box: WhiteBox,
        model: PhysicsModel,
        before: Tensor,
        driving: Tensor,
        residual: bool,
        scale: tuple[Tensor, Tensor],
    ) -> None:
        """
        Args:
            box, model, before, driving: as for `RigidBodyCore`; extras follow what drives the model.
            residual: whether the input model's output adds to the measured driving signal.
            scale: offset and scale (r,) of the driving signal.
        """
        self.box, self.model, self.residual = box, model, residual
        self.series = torch.cat([before.unsqueeze(-2), driving], -2)
        self.offset, self.scale = (s.unsqueeze(-1) for s in scale)

    def load(self, given: Tensor) -> Tensor:
        """What drives the model (r, B), or what is added to that."""
        return self.scale * given if self.residual else self.offset + self.scale * given

    @override
    def step(self, k: int, state: Tensor, start: Tensor, end: Tensor) -> Tensor:
        before, after = self._inputs(k, start), self._inputs(k + 1, end)
        return self.model.step(state.T, before, after, self.box.dt).T

    def _inputs(self, k: int, load: Tensor) -> Tensor:
        measured, extras = self.series[:, k].split([len(load), self.box.extras], -1)
        return torch.cat([measured + load.T if self.residual else load.T, extras], -1)


def magnitudes(model: Any) -> tuple[float, float, float, float]:
    """Scale of thrust over mass [m/s²] and of torques over inertia [rad/s²]: those of the rotors where it hovers.

    The thrust is the weight. A torque is what the rotors make if one half of them carries the weight alone.
    """
    x, y, _ = (sum(map(abs, axis)) / len(axis) for axis in zip(*model.rotor_positions, strict=True))
    reaction = model.torque_coefficient / model.thrust_coefficient
    weight = model.mass * model.gravity
    roll, pitch, yaw = (weight * arm / j for arm, j in zip((y, x, reaction), model.inertia, strict=True))
    return model.gravity, roll, pitch, yaw


def _accelerations(model: Quadrotor, driving: Tensor) -> Tensor:
    """Thrust over mass and torques over inertia (…, 4) of the rotors at the driving signal (…, d)."""
    speed, _ = model.actuate(driving, driving)
    thrust, torque = model.loads(model.rotor_thrust(speed), speed)
    return torch.cat([(thrust / tensor(model.mass, thrust)).unsqueeze(-1), torque / tensor(model.inertia, torque)], -1)


def uncertain_constants(model: PhysicsModel) -> list[Parameter]:
    """The constants that are not known exactly: those of the system, not gravity."""
    return [p for p in model.parameters() if p.uncertainty > 0 and p.name != "gravity"]


def with_constants(model: PhysicsModel, position: Tensor) -> PhysicsModel:
    """The model with its uncertain constants moved.

    Args:
        model: with nominal constants.
        position: one number for each number of the `uncertain_constants`, end to end; 0: nominal. A constant stays
            within `SPREAD` of its standard deviations.
    """
    values: dict[str, Any] = {}
    at = 0
    for p in uncertain_constants(model):
        nominal = tensor(p.value, position)
        moved = position[at : at + nominal.numel()].view(nominal.shape)
        values[p.name] = nominal * torch.exp(SPREAD * p.uncertainty * moved.tanh())
        at += nominal.numel()
    return replace(model, **values)
