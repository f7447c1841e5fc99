"""model.toml: a physics model with its effects, as a file that its user keeps and edits."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from torch import Tensor

from bench.diagnose.result import NamedEffect, ParameterEstimate, write_text
from registry.core import EFFECTS, finite
from registry.dynamics import Effect, Parameter, PhysicsModel
from registry.errors import BenchError
from registry.model_file import numbers, options, read, toml_text
from registry.terms.shapes import SPLINE

__all__ = ["read", "write"]

_HEAD = """\
# A physics model: base constants, then one table for every effect, SI units.
# `bench extend DATA --add EFFECT` adds another and fits them all again.
"""


def write(path: Path, model: PhysicsModel, effects: Sequence[NamedEffect] = ()) -> None:
    """Write the model with its effects, whole or not at all; numbers keep nine digits.

    Args:
        path: the file.
        model: its constants and those of ``model.effects`` are scalars or tuples.
        effects: what is known about the effects' parameters; their 95 % intervals become comments.

    Raises:
        BenchError: a constant is not finite, or the file cannot be written.
    """
    lines = [_HEAD, f"system = {toml_text(type(model).system_name())}"]
    lines += [f"{f.name} = {toml_text(getattr(model, f.name))}" for f in options(type(model), changed=model)]
    lines += ["", "[physics]", *_table(path, model.parameters(), {})]
    known = {e.id: e for e in effects if not e.learned}
    terms = [e for e in effects if e.learned]
    # Of several learned terms the last are those that something is known about.
    several = sum(e.learned for e in model.effects)
    told = iter([*[None] * (several - len(terms)), *terms])
    for effect in model.effects:
        said = next(told) if effect.learned else known.get(EFFECTS.name_of(type(effect)))
        lines += _effect(path, model, effect, said)
    write_text(path, "\n".join(lines) + "\n")


def _effect(path: Path, model: PhysicsModel, effect: Effect, known: NamedEffect | None) -> list[str]:
    """The table of an effect of ``model``: what it is, its options if it has some, its parameters."""
    name = EFFECTS.name_of(type(effect))
    parameters = [replace(p, unit=model.effect_unit(p.unit)) for p in effect.parameters()]
    said = effect.equation if known is None or not effect.learned else known.described
    forecast_only = known is not None and known.forecast_only
    why = "  For forecasts only: no equation by itself confirms it." if forecast_only else ""
    if effect.learned:
        parameters = [replace(p, about=_values_told(known) or p.about) for p in parameters]
    return [
        "",
        f"[[effects]]  # {_plain(EFFECTS.summary(name))}{why}",
        f"# {_plain(said)}",
        f"id = {toml_text(name)}",
        *(f"{key} = {toml_text(value)}" for key, value in effect.options().items()),
        *_table(path, parameters, {} if known is None else known.parameters),
    ]


def _values_told(told: NamedEffect | None) -> str:
    """Names, units and intervals of a formula's parameters; empty of a spline."""
    if told is None or told.term is None or told.term.shape == SPLINE:
        return ""
    return "; ".join(f"{n} [{p.unit}], 95 %: {p.low:.4g} to {p.high:.4g}" for n, p in told.parameters.items())


def _table(path: Path, parameters: Sequence[Parameter], known: dict[str, ParameterEstimate]) -> list[str]:
    """One line a parameter; the comments say what it is and how well it is known, in one column."""
    rows = []
    for p in parameters:
        value = p.value.tolist() if isinstance(p.value, Tensor) else p.value
        if not all(map(finite, numbers(value))):
            raise BenchError(f"{path} is not written: {p.name} = {value!r} is not finite.")
        comment = p.about if p.unit == "1" else f"{p.unit}: {p.about}"
        if p.name in known and all(map(finite, (known[p.name].low, known[p.name].high))):
            comment = f"{p.unit}, 95 %: {known[p.name].low:.4g} to {known[p.name].high:.4g}; {p.about}"
        rows.append((f"{p.name} = {_toml(value)}", _plain(comment)))
    width = max((len(line) for line, _ in rows if len(line) < 48), default=0)
    return [f"{line:<{width}}  # {comment}" for line, comment in rows]


def _toml(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml, value)) + "]"
    text = f"{float(value):.9g}"
    return text if {".", "e"} & set(text) else text + ".0"


def _plain(text: str) -> str:
    """One line, as a comment must be."""
    return " ".join(text.split())
