"""The logs of a case as the diagnosis takes them."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import Subject, log_of
from registry.atomic_io import drafting
from registry.core import EFFECTS
from registry.datasets.signals import recording
from registry.physics.quadrotor import Quadrotor

RATE = 100.0
"""Of all flights [Hz]."""
TEST = (2, 4)
"""Recordings that only test."""


def subject(
    name: str,
    columns: list[dict[str, np.ndarray]],
    nominal: dict[str, Any],
    uncertainty: dict[str, float],
    known: dict[str, dict[str, float]],
    drive: str = "rotor_speed",
    smoothing: Smoothing | None = None,
) -> Subject:
    """A subject from columns in memory, one dictionary a recording, as `cases.fly` gives them."""
    battery = all("battery" in c for c in columns)
    constants = {k: _tuples(v) for k, v in nominal.items()}
    model = Quadrotor(
        **constants,
        drive=drive,
        effects=tuple(EFFECTS.get(k)(**v) for k, v in known.items()),
        input_hold="previous" if drive == "rotor_command" else "linear",
        extras=(("battery",) if battery else ()) + ("time",),
    )
    logs = []
    for i, c in enumerate(columns):
        signals = {k: v if v.ndim > 1 else v[:, None] for k, v in c.items() if k not in (drive, "t")}
        made = recording(f"flight_{i + 1}", RATE, {drive: c[drive]}, signals, np.ones(len(c["t"]), dtype=bool))
        logs.append(log_of(made, model, drive))
    names = [log.name for log in logs]
    held_out = tuple(names[i] for i in TEST if i < len(names))
    return Subject(
        name,
        model,
        tuple(logs),
        training=tuple(n for n in names if n not in held_out),
        held_out=held_out,
        smoothing=smoothing,
        noise={},
        uncertainty=uncertainty,
        signals=tuple(k for k in columns[0] if k != "t"),
    )


def written_once(path: Path, write: Callable[[Path], None]) -> Path:
    """``path``, a folder that ``write`` fills on first use; whole or not there, also beside other processes."""
    if not path.is_dir():
        path.parent.mkdir(parents=True, exist_ok=True)
        with drafting(path.parent, f".{path.name}.") as made:
            write(made)
            with suppress(OSError):  # another process was quicker
                made.rename(path)
    return path


def as_case(found: Subject, name: str, effects: Mapping[str, Mapping[str, float]]) -> Subject:
    """A folder's subject under the name of its case, with the effects that are known."""
    known = tuple(EFFECTS.get(effect)(**values) for effect, values in effects.items())
    return replace(found, name=name, model=replace(found.model, effects=known)) if known else found


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else float(value)
