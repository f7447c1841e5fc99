"""Reading a model.toml: a physics model with its effects, as a file that its user keeps and edits."""

import dataclasses
import json
import math
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from registry.core import EFFECTS, PHYSICS, finite
from registry.dynamics import Effect, Parameter, PhysicsModel
from registry.errors import BenchError, near
from registry.regular_file import read_toml

PER_ROTOR = ("rotor_positions", "rotor_directions")
"""Constants with as many items as there are rotors."""


def read(path: Path, system: str | type[PhysicsModel] = "") -> PhysicsModel:
    """The model in the file, with its effects.

    Args:
        path: a model.toml.
        system: the physics model that is expected, as a registered name or as a class (which need not be
            registered: a file never says what code to run); "": the registered one that the file names.

    Raises:
        BenchError: the file is absent, damaged or of another system, or a key or value does not fit.
    """
    table = read_toml(path, "`bench diagnose` writes a model.toml")
    if {"signals", "files"} <= table.keys():
        raise BenchError(f"{path} is a dataset.toml: give a model.toml, as `bench diagnose` writes it.")
    expected = system if isinstance(system, str) else system.system_name()
    named = table.pop("system", expected)
    if not isinstance(named, str) or not named:
        raise BenchError(f'{path} names no system: add a line such as system = "quadrotor".')
    if expected and named != expected:
        raise BenchError(f"{path} is a model of {named}, not of {expected}.")
    try:
        kind = PHYSICS.get(named) if isinstance(system, str) else system
    except BenchError as error:
        raise BenchError(f"{path}: {error}") from error
    physics, entries = table.pop("physics", {}), table.pop("effects", [])
    if not isinstance(physics, dict):
        raise BenchError(f"{path}: physics must be a table, [physics].")
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
        raise BenchError(f"{path}: effects must be tables, [[effects]].")
    defaults = {f.name: f.default for f in options(kind)}
    table = {key: tuple(value) if isinstance(value, list) else value for key, value in table.items()}
    for key, value in table.items():
        if key not in defaults:
            raise BenchError(f"{path}: unknown key {key!r}: {near(key, ['system', 'physics', 'effects', *defaults])}")
        if type(value) is not type(defaults[key]):
            raise BenchError(f"{path}: {key} must be of the kind of {toml_text(defaults[key])}, not {value!r}.")
    constants = constants_of(f"{path} [physics]", kind().parameters(), physics)
    try:
        bare: PhysicsModel = kind(**constants, **table)
    except BenchError as error:
        raise BenchError(f"{path}: {error}") from error
    effects = tuple(_effect(path, i, entry, bare) for i, entry in enumerate(entries, start=1))
    try:
        return dataclasses.replace(bare, effects=effects)
    except BenchError as error:
        raise BenchError(f"{path}: {error}") from error


def stated_in(path: Path) -> set[str]:
    """Names of the constants in the [physics] of a file that `read` has read."""
    return set(tomllib.loads(path.read_text(encoding="utf-8")).get("physics", {}))


def _effect(path: Path, number: int, entry: dict[str, Any], model: PhysicsModel) -> Effect:
    where = f"{path} [[effects]] number {number}"
    if not isinstance(entry.get("id"), str):
        raise BenchError(f'{where} has no id: add a line such as id = "rotor_drag".')
    try:
        kind = EFFECTS.get(entry["id"])
    except BenchError as error:
        raise BenchError(f"{where}: {error}") from error
    given, named = {k: v for k, v in entry.items() if k != "id"}, f"{where} ({entry['id']})"
    if effect := kind.from_options(named, given):
        return effect
    neutral: Effect = kind.neutral_for(model, {})
    return dataclasses.replace(neutral, **constants_of(named, neutral.parameters(), given))


def constants_of(where: str, parameters: Sequence[Parameter], given: dict[str, Any]) -> dict[str, Any]:
    """The given values as floats and tuples, each checked against its parameter.

    Raises:
        BenchError: an unknown name, or a value of another shape, not finite or out of its bounds.
    """
    known = {p.name: p for p in parameters}
    for key, value in given.items():
        if key not in known:
            raise BenchError(f"{where}: unknown parameter {key!r}: {near(key, known)}")
        p = known[key]
        flat = list(numbers(value))
        if not flat or not all(finite(v) for v in flat) or _depth(value) != _depth(p.neutral):
            wanted = ("a finite number", "a list of finite numbers", "a list of lists of finite numbers")
            raise BenchError(f"{where}: {key} must be {wanted[_depth(p.neutral)]}, not {value!r}.")
        low, high = -math.inf if p.low is None else p.low, math.inf if p.high is None else p.high
        if not all(low <= v <= high for v in flat):
            span = f"at least {low:g}" if high == math.inf else f"at most {high:g}"
            span = f"from {low:g} to {high:g}" if math.isfinite(low) and math.isfinite(high) else span
            raise BenchError(f"{where}: {key} = {value!r} must be {span} {p.unit}.")
        _refuse_shape(where, p, value)
    per_rotor = {key: len(value) for key, value in given.items() if key in PER_ROTOR}
    if len(set(per_rotor.values())) > 1:
        raise BenchError(f"{where}: {' and '.join(f'{k} has {n}' for k, n in per_rotor.items())} rotors: mend one.")
    return {key: _tuples([[*xy, 0.0][:3] for xy in v] if _depth(v) == 2 else v) for key, v in given.items()}


def _refuse_shape(where: str, p: Parameter, value: Any) -> None:
    """Raise where a vector has another length than its axes; of places (x, y) is enough, then z = 0."""
    if _depth(value) == 1 and p.name not in PER_ROTOR and len(value) != len(p.neutral):
        raise BenchError(f"{where}: {p.name} must be {len(p.neutral)} numbers, not {len(value)}.")
    if _depth(value) == 2 and {len(place) for place in value} not in ({2}, {3}):
        raise BenchError(f"{where}: {p.name} must be a list of places [x, y, z], or all of them [x, y] where z = 0.")


def options(kind: type[PhysicsModel], changed: PhysicsModel | None = None) -> list[dataclasses.Field[Any]]:
    """The fields that are no constants, such as input_hold; only those not at their default in ``changed``."""
    options = [f for f in dataclasses.fields(kind) if "uncertainty" not in f.metadata and f.name != "effects"]
    return [f for f in options if changed is None or getattr(changed, f.name) != f.default]


def toml_text(value: Any) -> str:
    """An option as TOML, which writes texts, whole numbers and lists of them as JSON does."""
    return json.dumps(list(value) if isinstance(value, tuple) else value, ensure_ascii=False)


def numbers(value: Any) -> Iterator[Any]:
    """The numbers within nested lists and tuples, in order."""
    if isinstance(value, (list, tuple)):
        for v in value:
            yield from numbers(v)
    else:
        yield value


def _depth(value: Any) -> int:
    return 1 + max(map(_depth, value), default=0) if isinstance(value, (list, tuple)) else 0


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else float(value)
