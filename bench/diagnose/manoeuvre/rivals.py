"""What is to be told apart: the candidates that a diagnosis left, or numbers that it knows badly."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.diagnose.extend import extend
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.settings import DESIGNING
from registry.core import EFFECTS
from registry.dynamics import PhysicsModel
from registry.errors import BenchError
from registry.regular_file import regular


@dataclass(frozen=True, eq=False)
class Question:
    """What a manoeuvre should answer."""

    models: tuple[tuple[str, PhysicsModel], ...]
    """By effect the candidates, or the one model whose parameters are to be known better."""
    parameters: tuple[tuple[int, str], ...] = ()
    """Place of the effect in the model, and name, of those known badly; empty: there are candidates."""

    without: tuple[str, ...] = ()
    """Effects that could not be fitted, and are no candidates."""

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids in question."""
        model = self.models[0][1]
        at = dict.fromkeys(i for i, _ in self.parameters)
        return tuple(EFFECTS.name_of(type(model.effects[i])) for i in at) or tuple(n for n, _ in self.models)


def of_diagnosis(
    subject: Subject, file: Path, model: PhysicsModel, noise: Noise, tick: Callable[[str], None] = lambda what: None
) -> Question:
    """The question that a diagnosis.json leaves open: its first tie, else its wide intervals.

    Args:
        subject: measurements, read when the inputs act.
        file: the diagnosis.json.
        model: the model that was written beside it.
        noise: of the measurements.
        tick: called with what is being done.

    Raises:
        BenchError: the file cannot be read, or nothing is left open.
    """
    said = _read(file)
    effects = said["effects"]
    tied = next((e for e in effects if e["indistinguishable_from"]), None)
    if tied is not None:
        return between(subject, model, (tied["id"], *tied["indistinguishable_from"]), noise, tick)
    held = [EFFECTS.name_of(type(e)) for e in model.effects]
    first = len(held) - len(effects)
    wide = tuple(
        (first + i, name)
        for i, e in enumerate(effects)
        for name, p in e["parameters"].items()
        if first >= 0 and held[first + i] == e["id"] and _wide(p)
    )
    if wide:
        names = {p.name for i, _ in wide for p in model.effects[i].parameters()}
        # Of a learned term the numbers of its formula make one vector.
        chosen = tuple(dict.fromkeys((i, n if n in names else "values") for i, n in wide))
        return Question((("model", model),), chosen)
    raise BenchError(
        f"Nothing is left to separate: the diagnosis of {said['dataset']} says {said['verdict']}, without a tie and "
        f"without an interval wider than ±{100 * DESIGNING.wide:.0f} %; --between names candidates all the same."
    )


def between(
    subject: Subject,
    model: PhysicsModel,
    names: Sequence[str],
    noise: Noise,
    tick: Callable[[str], None] = lambda what: None,
) -> Question:
    """Candidates that each have one of the effects ``names`` in the place of the others, fitted to the recordings.

    Raises:
        BenchError: fewer than two, or an effect that the system does not have.
    """
    if len(set(names)) < 2:
        raise BenchError("Nothing to separate: name at least two effects with --between.")
    base = replace(model, effects=tuple(e for e in model.effects if EFFECTS.name_of(type(e)) not in names))
    found, without = [], []
    for name in dict.fromkeys(names):
        EFFECTS.check(name)
        held = next((e for e in model.effects if EFFECTS.name_of(type(e)) == name), None)
        tick(f"fitting {name.replace('_', ' ')}")
        start = None if held is None else replace(base, effects=(*base.effects, held))
        try:
            found.append((name, extend(subject, base, [name], noise=noise, start=start).model))
        except (BenchError, ValueError):  # such as a dead zone as wide as the whole drive: nothing is left to fit
            without.append(name)
    if len(found) < 2:
        raise BenchError(f"Nothing to separate: {', '.join(without)} cannot be fitted to these recordings.")
    return Question(tuple(found), without=tuple(without))


def _wide(p: dict[str, float | None]) -> bool:
    value, low, high = (p[k] for k in ("value", "low", "high"))
    return value is not None and low is not None and high is not None and (high - low) / 2 > DESIGNING.wide * abs(value)


def _read(file: Path) -> dict[str, Any]:
    regular(file)
    try:
        said = json.loads(file.read_text(encoding="utf-8"))
        for e in said["effects"]:
            for p in e["parameters"].values():
                _wide(p)
            if not all(isinstance(name, str) for name in (e["id"], *e["indistinguishable_from"], *e["parameters"])):
                raise TypeError
        said["dataset"], said["verdict"]
    except (OSError, ValueError, LookupError, TypeError, ArithmeticError, AttributeError, RecursionError) as error:
        raise BenchError(f"{file} is no diagnosis.json as `bench diagnose` writes it: diagnose again.") from error
    return dict(said)
