"""The axes along which a learned term can act, and the signals that it can follow, by the kind of model."""

from collections.abc import Callable
from functools import lru_cache
from itertools import combinations
from typing import Any

import torch
from torch import Tensor

from registry.dynamics import Motion, PhysicsModel, tensor
from registry.terms.unit_algebra import product
from registry.units import channel_names

FORCES = {f"force_{a}": (i, False) for i, a in enumerate("xyz")}
WORLD_FORCES = {f"world_force_{a}": (i, True) for i, a in enumerate("xyz")}
TORQUES = {f"torque_{a}": i for i, a in enumerate("xyz")}


def _component(of: Callable[[Motion], Tensor], place: int) -> Callable[[Motion], Tensor]:
    return lambda motion: of(motion)[..., place]


def _vector(name: str, axes: str, unit: str, of: Callable[[Motion], Tensor]) -> "dict[str, _Followed]":
    return {f"{name}.{a}": (unit, _component(of, i)) for i, a in enumerate(axes)}


_Followed = tuple[str, Callable[[Motion], Tensor]]
_OF_MOTION: dict[str, _Followed] = {
    **_vector("position", "xy", "m", lambda m: m.position),
    "height": ("m", lambda m: m.position[..., 2] - tensor(m.model.ground_z, m.position)),
    **_vector("velocity", "xyz", "m/s", lambda m: m.velocity),
    **_vector("body_velocity", "xyz", "m/s", lambda m: m.air_velocity),
    "airspeed": ("m/s", lambda m: torch.linalg.vector_norm(m.air_velocity, dim=-1)),
    **_vector("body_rates", "pqr", "rad/s", lambda m: m.body_rates),
    "roll": ("rad", lambda m: torch.atan2(m.rotation[..., 2, 1], m.rotation[..., 2, 2])),
    "pitch": ("rad", lambda m: -torch.asin(m.rotation[..., 2, 0].clamp(-1 + 1e-9, 1 - 1e-9))),
    "thrust": ("N", lambda m: m.total_thrust),
}
"""By name: unit, and the signal (…) of a rigid body's motion."""
_EXTRA_UNITS = {"battery": "V", "time": "s"}


def flies(kind: type[PhysicsModel]) -> bool:
    """Whether models of a class are rigid bodies that forces and torques act on."""
    return {"position", "velocity", "attitude", "body_rates"} <= {c.group for c in kind.state_channels}


@lru_cache(maxsize=256)
def axes_of(kind: type[PhysicsModel]) -> dict[str, str]:
    """The axes along which a term can act in models of a class, and the unit of what it adds there."""
    if flies(kind):
        return {**dict.fromkeys((*FORCES, *WORLD_FORCES), "N"), **dict.fromkeys(TORQUES, "N m")}
    rates = {c.name: product((c.unit, 1), ("s", -1)) for c in kind.state_channels}
    return {**rates, **dict.fromkeys(drives_of(kind), _input_unit(kind, _drive(kind)))}


@lru_cache(maxsize=256)
def drives_of(kind: type[PhysicsModel]) -> tuple[str, ...]:
    """The driving inputs of a system that is given by its rates: what is missing can act where they act.

    Friction of a joint moves every part that is coupled to it, as the joint's motor does.
    """
    drive = _drive(kind)
    if flies(kind) or not drive or not hasattr(kind, "own_rate"):
        return ()
    known = kind.signal(drive)
    return input_names(kind, drive, 1 if known is None else len(known.axes) or 1)


def quantity_of(kind: type[PhysicsModel], axis: str) -> str:
    """What a term along an axis is."""
    if flies(kind):
        return axis
    return f"missing {axis}" if axis in drives_of(kind) else f"rate of change of {axis}"


@lru_cache(maxsize=256)
def signals_of(kind: type[PhysicsModel], drive: str, drives: int, extras: tuple[str, ...]) -> dict[str, str]:
    """The signals that a term can follow in models of a class, and their units.

    Args:
        kind: the class.
        drive: name of the driving signal.
        drives: number of its channels.
        extras: signals that follow it in the inputs.
    """
    inputs = dict.fromkeys(input_names(kind, drive, drives), _input_unit(kind, drive))
    known = {n: signal.unit for n in extras if (signal := kind.signal(n))}
    inputs |= {n: known.get(n) or _EXTRA_UNITS.get(n, "1") for n in extras}
    if flies(kind):
        own = {n: unit for n, (unit, _) in _OF_MOTION.items() if n != "thrust" or hasattr(kind, "rotor_positions")}
        return {**own, **inputs}
    states = {c.name: c.unit for c in kind.state_channels}
    return {**states, **{n: states[first] for n, (first, _, _) in combinations_of(kind).items()}, **inputs}


@lru_cache(maxsize=256)
def combinations_of(kind: type[PhysicsModel]) -> dict[str, tuple[str, str, int]]:
    """Sums and differences of two states of a kind, such as the angle of a second link or the stretch of a coupling.

    Returns:
        By name: the two states, and the sign of the second; of rigid bodies none, whose signals have axes of their own.
    """
    if flies(kind):
        return {}
    states = [c for c in kind.state_channels if c.unit]
    return {
        f"{a.name}{'+' if sign > 0 else '-'}{b.name}": (a.name, b.name, sign)
        for a, b in combinations(states, 2)
        if a.unit == b.unit and a.group == b.group
        for sign in (1, -1)
    }


def input_names(kind: type[PhysicsModel], drive: str, drives: int) -> tuple[str, ...]:
    """Names of the channels of the driving signal."""
    known = kind.signal(drive) if drive else None
    if known is not None and len(known.axes) == drives:
        return channel_names(drive, known.axes)
    return (drive,) if drives == 1 else tuple(f"{drive}.{i + 1}" for i in range(drives))


def _input_unit(kind: type[PhysicsModel], drive: str) -> str:
    known = kind.signal(drive) if drive else None
    return "1" if known is None else known.unit


def drive_of(model: PhysicsModel) -> tuple[str, int]:
    """Name of the signal that drives a model, and its number of channels."""
    drive = _drive(type(model))
    chosen = str(getattr(model, "drive", "")) if type(model).chooses_drive() else drive
    return (chosen, model.driving_channels) if drive else ("", 0)


def _drive(kind: type[PhysicsModel]) -> str:
    return next(iter(kind.input_signals), "")


def available(model: PhysicsModel) -> dict[str, str]:
    """The signals that a term can follow in a model, and their units."""
    return signals_of(type(model), *drive_of(model), model.extras)


def of_motion(name: str, motion: Motion) -> Tensor:
    """A signal (…) of a rigid body's motion."""
    if name in _OF_MOTION:
        return _OF_MOTION[name][1](motion)
    if name in motion.extras:
        return motion.extras[name]
    places = input_names(type(motion.model), *drive_of(motion.model))
    return motion.inputs[..., places.index(name)]


def of_state(name: str, model: Any, state: Tensor, inputs: Tensor) -> Tensor:
    """A signal (…) of a system that is given by its rates, at states (…, s) and inputs (…, m).

    The extras, after what drives it, are looked at where one of them is asked for.
    """
    channels = [c.name for c in model.state_channels]
    kind: type[PhysicsModel] = type(model)
    combined = combinations_of(kind)
    if name in combined:
        first, second, sign = combined[name]
        return state[..., channels.index(first)] + sign * state[..., channels.index(second)]
    if name in channels:
        return state[..., channels.index(name)]
    if name in model.extras:
        extra: Tensor = model.extra(name, inputs)
        return extra
    return inputs[..., input_names(type(model), *drive_of(model)).index(name)]


def load_along(axis: str, amount: Tensor, motion: Motion) -> tuple[Tensor, Tensor]:
    """Force (…, 3) [N] and torque (…, 3) [N m] in the body frame, of so much (…) along an axis."""
    none, amount = torch.zeros_like(motion.air_velocity), amount.unsqueeze(-1)
    unit = torch.eye(3, dtype=none.dtype, device=none.device)
    if axis in TORQUES:
        return none, amount * unit[TORQUES[axis]]
    i, of_world = {**FORCES, **WORLD_FORCES}[axis]
    return amount * (motion.rotation[..., i, :] if of_world else unit[i]), none


def rate_along(axis: str, amount: Tensor, model: Any, state: Tensor, inputs: Tensor) -> Tensor:
    """What so much (…) along an axis adds to dx/dt (…, s), at states (…, s) and inputs (…, m), driving ones first."""
    kind: type[PhysicsModel] = type(model)
    drives = drives_of(kind)
    if axis in drives:
        unit = torch.eye(len(drives), dtype=state.dtype, device=state.device)[drives.index(axis)]
        acting = inputs[..., : len(drives) + len(kind.disturbances)]
        added: Tensor = model.driven_by(amount.unsqueeze(-1) * unit, state, acting)
        return added
    place = [c.name for c in model.state_channels].index(axis)
    return amount.unsqueeze(-1) * torch.eye(state.shape[-1], dtype=state.dtype, device=state.device)[place]
