"""The conditions in which a system is met: what a region of its errors is told in."""

from dataclasses import dataclass

import numpy as np

from bench.diagnose.regression.weak import Stack
from registry.dynamics import PhysicsModel
from registry.physics.rigid_body import RigidBody


@dataclass(frozen=True, eq=False)
class Condition:
    """One quantity at every sample."""

    name: str
    """As a reader says it."""
    unit: str
    """SI, or "rotor radii"."""
    values: np.ndarray
    """(L, N); at invalid samples and beyond the end of a log they mean nothing."""

    def means(self, log: int, first: np.ndarray, samples: int) -> np.ndarray:
        """Means (W,) over ``samples`` samples from each of ``first`` on."""
        known = np.nan_to_num(self.values[log])  # invalid samples, which no window touches
        sums = np.concatenate([[0.0], np.cumsum(known)])
        return np.asarray((sums[first + samples] - sums[first]) / samples)


def conditions(model: PhysicsModel, stack: Stack) -> list[Condition]:
    """Every condition that was measured and that varies."""
    found = _flight(model, stack) if isinstance(model, RigidBody) else _states(model, stack)
    drives = stack.inputs.shape[-1] - len(model.extras)
    names = {"battery": ("battery voltage", "V"), "time": ("time since the start", "s")}
    for i, extra in enumerate(model.extras):
        found.append(Condition(*names.get(extra, (extra, "1")), stack.inputs[..., drives + i].numpy()))
    return [c for c in found if np.isfinite(c.values).any() and np.nanmax(c.values) > np.nanmin(c.values)]


def _flight(model: RigidBody, stack: Stack) -> list[Condition]:
    drives = stack.inputs.shape[-1] - len(model.extras)
    slopes = np.zeros(stack.inputs.shape)
    slopes[..., :drives] = np.gradient(stack.inputs[..., :drives].numpy(), stack.dt, axis=1)
    motion = model.unloaded(model.project(stack.states), stack.inputs, stack.states.new_tensor(slopes))[0]
    units = [c.unit for c in stack.logs[0].recording.input_channels][:drives]
    unit = "rad/s" if motion.thrust.shape[-1] else (units or ["1"])[0]
    air, position = motion.air_velocity.numpy(), motion.position.numpy()
    height, radius = position[..., 2] - float(model.ground_z), getattr(model, "rotor_radius", None)
    rows = [
        ("airspeed", "m/s", np.linalg.norm(air, axis=-1)),
        ("forward airspeed", "m/s", air[..., 0]),
        ("leftward airspeed", "m/s", air[..., 1]),
        ("climb rate", "m/s", motion.velocity[..., 2].numpy()),
        ("height over ground", "rotor radii", height / float(radius))
        if radius
        else ("height over ground", "m", height),
        ("position x", "m", position[..., 0]),
        ("position y", "m", position[..., 1]),
        ("total thrust", "N", motion.total_thrust.numpy()),
        ("rate of turn", "rad/s", motion.body_rates.norm(dim=-1).numpy()),
        *((f"body rates {a}", "rad/s", motion.body_rates[..., i].numpy()) for i, a in enumerate("pqr")),
        ("change of inputs", _per_second(unit), motion.input_rates.abs().mean(-1).numpy()),
    ]
    return [Condition(name, unit, values) for name, unit, values in rows]


def _states(model: PhysicsModel, stack: Stack) -> list[Condition]:
    drives, log = stack.inputs.shape[-1] - len(model.extras), stack.logs[0]
    inputs = log.recording.input_channels[:drives]
    columns = [(c, stack.states[..., i].numpy()) for i, c in enumerate(model.state_channels) if log.measured[i]]
    columns += [(c, stack.inputs[..., i].numpy()) for i, c in enumerate(inputs)]
    groups = [c.group for c, _ in columns]
    found = []
    for channel, values in columns:
        name = channel.group if groups.count(channel.group) == 1 else channel.name
        name = name.replace("_", " ").replace(".", " ")
        found.append(Condition(name, channel.unit, values))
        if np.nanmin(values) < 0 < np.nanmax(values):
            found.append(Condition(f"|{name}|", channel.unit, np.abs(values)))
        if channel in inputs:
            slope = np.abs(np.gradient(values, stack.dt, axis=1))
            found.append(Condition(f"change of {name}", _per_second(channel.unit), slope))
    return found


def _per_second(unit: str) -> str:
    """The unit of a rate of change."""
    return f"{unit}^2" if unit.endswith("/s") else f"{unit}/s"
