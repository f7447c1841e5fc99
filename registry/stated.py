"""Constants that a user's data must state: those of a registered model are another system's."""

import dataclasses
from collections.abc import Collection, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from registry.contracts import Dataset
from registry.core import PHYSICS
from registry.dynamics import Parameter, PhysicsModel
from registry.errors import BenchError
from registry.model_file import stated_in


def physics_of(system: str, label: str) -> type[PhysicsModel]:
    """The class of a registered physics model.

    Raises:
        BenchError: the data ``label`` name none, or one that is not registered.
    """
    if not system:
        raise BenchError(
            f"{label} has no physics model, so that only networks predict it: name a registered one as its system "
            "(`bench list physics`) or add your own by the entry point multistep_bench.physics."
        )
    kind: type[PhysicsModel] = PHYSICS.get(system)
    return kind


@lru_cache(maxsize=32)
def needed(kind: type[PhysicsModel], drive: str = "") -> tuple[Parameter, ...]:
    """Constants on which a model's motion depends and whose values here are those of one vehicle or apparatus.

    These are the ones with a source, where a class of one's own has not its own; gravity is everybody's.

    Args:
        kind: the model's class.
        drive: the signal that drives it; "": its own.
    """
    given: dict[str, Any] = {}
    if drive and kind.chooses_drive():
        given["drive"] = drive
    model = kind(**given)
    before = _rates(model)
    return tuple(
        p
        for p in model.parameters()
        if p.source
        and any(PHYSICS.knows(base) for base in _where(kind, p.name))
        and not torch.equal(before, _rates(_with(model, p.name, _larger(p.value))))
    )


def refuse_unstated(dataset: Dataset, kind: type[PhysicsModel], file: str = "") -> None:
    """Raise where a user's data leave constants open that a model of ``kind`` would take from another vehicle.

    Args:
        dataset: of a user if it has a description; a registered one has the constants of its own system.
        kind: the model's class.
        file: a model.toml that states the constants instead.

    Raises:
        BenchError: one sentence with all that is missing.
    """
    if not dataset.described:
        return
    drive = next((s for s in kind.input_signals if s in dataset.inputs), "")
    stated: Collection[str] = stated_in(Path(file)) if file else dataset.physics
    missing = [p for p in needed(kind, drive) if p.name not in stated]
    if missing:
        name = kind.system_name()
        listed = ", ".join(p.name if p.unit == "1" else f"{p.name} [{p.unit}]" for p in missing)
        raise BenchError(
            f"{file or dataset.described} [physics] does not state {listed}: add what this {name} has "
            f"(`bench show {name if PHYSICS.knows(kind) else _base(kind)}` lists them); only networks do without."
        )


def _where(kind: type[PhysicsModel], name: str) -> Iterator[type]:
    """The classes that hold the same field of that name."""
    field = kind.__dataclass_fields__[name]
    return (b for b in kind.__mro__ if getattr(b, "__dataclass_fields__", {}).get(name) is field)


def _base(kind: type[PhysicsModel]) -> str:
    return next(PHYSICS.name_of(b) for b in kind.__mro__ if PHYSICS.knows(b))


def _rates(model: PhysicsModel) -> Tensor:
    """dx/dt at a state and an input at which nothing is zero."""
    rotors = len(getattr(model, "rotor_positions", ())) or 1
    known = [model.signal(s) for s in model.input_signals]
    width = (max(rotors, *(len(s.axes) if s else 1 for s in known)) if known else 0) + len(model.extras)
    state = torch.linspace(0.5, 1.5, len(model.state_channels), dtype=torch.float64)
    return model.derivative(state, torch.linspace(1.0, 2.0, width, dtype=torch.float64))


def _with(model: PhysicsModel, name: str, value: Any) -> PhysicsModel:
    changes: dict[str, Any] = {name: value}
    return dataclasses.replace(model, **changes)


def _larger(value: Any) -> Any:
    return tuple(map(_larger, value)) if isinstance(value, tuple) else 1.5 * value
