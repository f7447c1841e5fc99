"""What is exported of a physics model: its rates, and how inputs and effects with a memory act over a time step."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch

from registry.core import EFFECTS
from registry.dynamics import PhysicsModel, advanced, sticks
from registry.effects.learned_term import LearnedTerm
from registry.equations.trace import Traced, traced
from registry.errors import BenchError
from registry.terms.shapes import SPLINE


@dataclass(frozen=True)
class Equations:
    """A model as programs. A full state is the state with the effects' own states (``body``), then ``memory``."""

    model: PhysicsModel
    dt: float
    """[s] of the steps."""
    body: int
    """Length of the state and the effects' own states."""
    memory: int
    """Length of what delays and lags remember."""
    inputs: int
    derivative: Traced
    """body, inputs, input_rates → rates of the body."""
    project: Traced
    """body → body."""
    initial: Traced
    """state, inputs → full state after all has been steady."""
    transmit: Traced
    """memory, before, after → the memory after the step, then what acts at its start, middle and end."""
    advance: Traced | None = None
    """body, acting: that at start, middle and end of a step (3 m) → body at its end, where that is no step of the plain
    4th-order Runge–Kutta method of the derivative: with dry friction."""

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the state proper."""
        return tuple(c.name for c in self.model.state_channels)

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""
        return tuple(c.unit for c in self.model.state_channels)

    @property
    def drives(self) -> tuple[str, ...]:
        """Names of the inputs: the driving signal's channels, then the extras."""
        drive, count = next(iter(self.model.input_signals), ""), self.model.driving_channels
        known = self.model.signal(drive) if drive else None
        axes = (known.axes if known else ()) or tuple(str(i + 1) for i in range(count))
        names = tuple(f"{drive}.{axis}" if count > 1 or axis.isalpha() else drive for axis in axes)
        return (*names, *self.model.extras)

    @property
    def about(self) -> str:
        """The system and its effects."""
        effects = ", ".join(EFFECTS.name_of(type(e)) for e in self.model.effects)
        return type(self.model).system_name() + (f" with {effects}" if effects else "")


def equations(model: PhysicsModel, dt: float) -> Equations:
    """Write a model down.

    Args:
        model: with its effects; constants are put in as numbers.
        dt: step [s]; what delays and lags remember depends on it.

    Raises:
        BenchError: it does something that cannot be exported.
    """
    if any(isinstance(e, LearnedTerm) and e.shape == SPLINE for e in model.effects):
        raise BenchError("A learned term that is a spline cannot be exported; one that is a formula can.")
    model = _without_unused_extras(model)
    proper = len(model.state_channels)
    body, width = proper + model.internal_size, model.driving_channels + len(model.extras)
    full = model.initial(torch.ones(proper, dtype=torch.float64), torch.ones(width, dtype=torch.float64), dt)
    memory = len(full) - body

    def acting(m: Any, before: Any, after: Any) -> Any:
        left, segment = model.transmit(m, before, after, dt)
        return torch.cat([left, segment.reshape(-1)])

    def advance(state: Any, acting: Any) -> Any:
        return advanced(model, model.derivative, state, acting.reshape(3, width), dt)

    steps: dict[str, tuple[Callable[..., Any], dict[str, int]]] = {
        "derivative": (model.derivative, {"state": body, "inputs": width, "input_rates": width}),
        "project": (model.project, {"state": body}),
        "initial": (lambda state, inputs: model.initial(state, inputs, dt), {"state": proper, "inputs": width}),
        "transmit": (acting, {"memory": memory, "before": width, "after": width}),
    }
    if sticks(model):
        steps["advance"] = advance, {"state": body, "acting": 3 * width}
    found = {name: traced(function, sizes) for name, (function, sizes) in steps.items()}
    return Equations(model, dt, body, memory, width, **found)


def _without_unused_extras(model: PhysicsModel) -> PhysicsModel:
    """The model without signals, such as time, that are in the data and enter no equation."""
    if not model.extras:
        return model
    drives, width = model.driving_channels, model.driving_channels + len(model.extras)
    body = len(model.state_channels) + model.internal_size
    rates = traced(model.derivative, {"state": body, "inputs": width, "input_rates": width})
    read = {i - drives for name, i in rates.program.read(rates.outputs) if name != "state"}
    return replace(model, extras=tuple(name for i, name in enumerate(model.extras) if i in read))
