"""Constants of a system as a drafted `dataset.toml` has them: what is known is stated, what is not is asked for."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from registry.core import PHYSICS
from registry.stated import needed


@dataclass(frozen=True)
class Constant:
    """A constant of the vehicle, as dataset.toml has it under [physics]."""

    value: Any
    """SI; lists as TOML has them."""
    origin: str
    """Where it is from, in a few words."""
    uncertainty: float | None = None
    """Relative 1σ, where it is not the usual one."""


def physics_lines(
    system: str, drive: str, stated: Mapping[str, Constant], hints: Mapping[str, str] | None = None
) -> list[str]:
    """Of a drafted dataset.toml: the constants that it must state, open where nobody states them, and those it may.

    Args:
        system: the physics model's registered name.
        drive: the signal that drives it; "": none yet.
        stated: what is known of its constants.
        hints: how one that is not known follows from others, by its name.
    """
    kind: Any = PHYSICS.get(system)
    lines = {p.name: (json.dumps(p.value), f"# {p.unit}; {p.about}") for p in kind().parameters()}
    given = {name: stated[name] for name in lines if name in stated}
    own = [p.name for p in needed(kind, drive) if p.name not in given]
    spread = {name: c.uncertainty for name, c in given.items() if c.uncertainty is not None}
    uncertain = ["", "[physics.uncertainty]  # relative, 1σ", *(f"{name} = {u:g}" for name, u in spread.items())]
    ask = "# TODO: what this system has, SI; physics models need all of these, networks none"
    others = {p.name for signal in kind.input_signals for p in needed(kind, signal)}  # what only another drive needs
    free = {name: line for name, line in lines.items() if name not in {*own, *given, *others}}
    return [
        *(["[physics]"] if given else [] if own else ["# [physics]"]),
        *(f"{name} = {json.dumps(c.value)}  {lines[name][1]}; {c.origin}" for name, c in given.items()),
        *([ask if given else f"# [physics]  {ask}"] if own else []),
        *(f"# {name} = …  {lines[name][1]}" + (f"; {hints[name]}" if hints and name in hints else "") for name in own),
        *["# These may be left out, and are then as here:"] * bool(free),
        *(f"# {name} = {value}  {about}" for name, (value, about) in free.items()),
        *(uncertain if spread else []),
    ]
