"""A simple pilot built from a quadrotor's own model: set-points of position and yaw to what drives the rotors.

Position and velocity errors ask for an acceleration, that for a thrust and a tilt, the tilt for body rates and these
for torques; the inverse of the model's own map from squared rotor speeds to thrust and torque gives the rotors.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from registry.dynamics import Pilot, SetPoint, cross, rotation_matrix
from registry.physics.vehicle import BODY_RATES, POSITION, VELOCITY

STIFFNESS, DAMPING = 4.0, 3.5
"""Accelerations for an error of position [1/s²] and of velocity [1/s]."""
TILT, TURN = 8.0, 18.0
"""Body rate for a tilt [1/s], angular acceleration for a body rate [1/s]."""
STEEPEST = 0.6
"""Tangent of the largest tilt that is asked for."""
LAG = 0.22
"""Of each of four equal lags that a set-point goes through, so that a vehicle can follow it [s]."""
SLOWEST = 0.3
"""Of the speed at which the rotors hover: their slowest."""
FASTEST = 1.7
"""And their fastest."""


def smoothed(asked: np.ndarray, dt: float) -> np.ndarray:
    """Position, velocity and acceleration (W, N, 3, c) of set-points (W, N, c) after four equal lags."""
    keep, stages = np.exp(-dt / LAG), [asked]
    for _ in range(4):
        out, value = np.empty_like(asked), asked[:, 0]
        for k in range(asked.shape[1]):
            value = stages[-1][:, k] + (value - stages[-1][:, k]) * keep
            out[:, k] = value
        stages.append(out)
    _, _, b, c, d = stages
    return np.stack([d, (c - d) / LAG, (b - 2 * c + d) / LAG**2], axis=2)


class QuadrotorPilot(Pilot):
    """Flies along x, y and z [m] at a yaw [rad]."""

    set_points = (
        *(SetPoint(f"position.{a}", "m", VELOCITY.start + i, POSITION.start + i) for i, a in enumerate("xyz")),
        SetPoint("yaw", "rad", BODY_RATES.stop - 1, ends=(-np.pi / 2, np.pi / 2)),
    )
    band = (0.05, 1.0)
    path_columns = (
        *((f"position.{a}", "m") for a in "xyz"),
        *((f"velocity.{a}", "m/s") for a in "xyz"),
        *((f"acceleration.{a}", "m/s^2") for a in "xyz"),
        ("yaw", "rad"),
        ("yaw_rate", "rad/s"),
    )

    def __init__(self, model: Any) -> None:
        self.model = model
        """Parameters are numbers."""

    def path(self, asked: np.ndarray, dt: float) -> np.ndarray:
        """Position, velocity, acceleration, yaw and its rate (W, N, 11) of set-points (W, N, 4), `smoothed`."""
        at = smoothed(asked, dt)  # (W, N, 3, 4)
        return np.concatenate([at[..., 0, :3], at[..., 1, :3], at[..., 2, :3], at[..., :2, 3]], axis=-1)

    def flown(self, asked: np.ndarray, extras: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """What drives (W, N, 4) and the states (W, N, 13) of flights along set-points (W, N, 4); see `Pilot.flown`."""
        model, path = self.model, torch.from_numpy(smoothed(asked, dt))
        count, samples = path.shape[:2]
        state = torch.zeros(count, 13, dtype=torch.float64)
        state[:, POSITION] = path[:, 0, 0, :3]
        state[:, 8], state[:, 9] = torch.sin(path[:, 0, 0, 3] / 2), torch.cos(path[:, 0, 0, 3] / 2)
        mixer, hover = _mixer(model), _hover(model)
        drive = _driving(model, torch.full((count, 4), hover, dtype=torch.float64))
        full = model.initial(state, torch.cat([drive, extras[:, 0]], dim=-1), dt)
        drives, states = [drive], [state]
        for k in range(1, samples):
            last = torch.cat([drive, extras[:, k - 1]], dim=-1)
            drive = _driving(model, _speeds(model, states[-1], path[:, k - 1], mixer, hover))
            full = model.step(full, last, torch.cat([drive, extras[:, k]], dim=-1), dt)
            drives.append(drive)
            states.append(full[:, :13])
        return torch.stack(drives, dim=1), torch.stack(states, dim=1)


def _hover(model: Any) -> float:
    return float(np.sqrt(model.mass * model.gravity / (4 * model.thrust_coefficient)))


def _mixer(model: Any) -> Tensor:
    """(4, 4): thrust and body torques to the squares of the rotor speeds."""
    arms, k_f = np.array(model.rotor_positions), model.thrust_coefficient
    loads = [
        np.full(4, k_f),
        k_f * arms[:, 1],
        -k_f * arms[:, 0],
        model.torque_coefficient * np.array(model.rotor_directions),
    ]
    return torch.from_numpy(np.linalg.inv(np.stack(loads)))


def _driving(model: Any, speeds: Tensor) -> Tensor:
    """The driving signal (W, 4) that means these rotor speeds [rad/s]."""
    return (speeds - model.pwm_offset) / model.pwm_gain if model.drive == "pwm" else speeds


def _speeds(model: Any, state: Tensor, wanted: Tensor, mixer: Tensor, hover: float) -> Tensor:
    """Rotor speeds (W, 4) [rad/s] at states (W, 13) for a path's position, velocity and acceleration (W, 3, 4)."""
    goal, speed, ahead = wanted[..., :3].unbind(1)
    position, velocity, attitude, rates = state.split([3, 3, 4, 3], dim=-1)
    rotation = rotation_matrix(attitude)
    lift = ahead + STIFFNESS * (goal - position) + DAMPING * (speed - velocity)
    lift = lift + lift.new_tensor((0.0, 0.0, float(model.gravity)))
    vertical = lift[:, 2:].clamp(min=1.0)
    lift = torch.cat([torch.clamp(lift[:, :2], -STEEPEST * vertical, STEEPEST * vertical), vertical], dim=-1)
    up = rotation[:, :, 2]
    thrust = model.mass * (lift * up).sum(-1, keepdim=True)
    tilt = cross(up, lift / lift.norm(dim=-1, keepdim=True))
    tilt = (rotation * tilt.unsqueeze(-1)).sum(-2)
    yaw, turning = wanted[:, 0, 3], wanted[:, 1, 3]
    forward = rotation[:, :2, 0]
    off = forward[:, 0] * torch.sin(yaw) - forward[:, 1] * torch.cos(yaw)
    target = torch.cat([TILT * tilt[:, :2], (turning + 3.0 * off).unsqueeze(-1)], dim=-1)
    inertia = lift.new_tensor(model.inertia)
    torque = inertia * TURN * (target - rates) + cross(rates, inertia * rates)
    squares = (mixer * torch.cat([thrust, torque], dim=-1).unsqueeze(-2)).sum(-1)
    return squares.clamp((SLOWEST * hover) ** 2, (FASTEST * hover) ** 2).sqrt()
