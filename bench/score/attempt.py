"""One case diagnosed, and what is right about the answer."""

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from bench.diagnose.compare import compare
from bench.diagnose.diagnose import diagnose
from bench.diagnose.result import ByGroup, Diagnosis
from bench.score.case import Case
from bench.score.chains import measured, true_model
from registry.core import EFFECTS

INERTIA = {"rotor_gyroscopic_torque", "rotor_reaction_torque"}
"""They share a constant: either, or both, is right where the truth is the rotor inertia."""


MEASURED = ("single", "pair", "triple", "tie")
"""Conditions in which errors are asked for, and not the verdict alone."""


_MEANT = {"body_velocity": "velocity", "airspeed": "velocity", "height": "position"}
"""What was measured, of signals of learned terms that are computed from it."""


@dataclass(frozen=True)
class Answer:
    """What was said of a case."""

    id: str
    condition: str
    vehicle: str
    style: str
    noise: str
    truth: dict[str, dict[str, float]]
    verdict: str
    named: dict[str, dict[str, tuple[float, float, float]]]
    """Effects in the extended model: by parameter value, low, high."""
    rivals: dict[str, tuple[str, ...]]
    follows: tuple[str, ...]
    error: dict[str, dict[str, float]]
    """By line (nominal, calibrated, extended, floor, true) and group, at the longest horizon, SI.

    "true" is the error of the simulator with the hidden effects and constants put in: what these recordings' own noise
    leaves, beside the floor, which is what such noise leaves on average.
    """
    problems: tuple[tuple[str, str, str, tuple[int, int] | None, str], ...] = ()
    """Recording, signal, kind, rows (first and last; None: all), detail."""
    faults: tuple[tuple[str, str, str, tuple[int, int]], ...] = ()
    """The true ones: recording, signal, kind, rows (first and last)."""
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    constants: dict[str, tuple[float, float, float, float]] = field(default_factory=dict)
    """Of the base model, and ratios of two: nominal, calibrated, low, high."""
    extra: dict[str, Any] = field(default_factory=dict)


def attempt(case: Case, cache: Path) -> Answer:
    """Fly a case (or take its flights from the cache) and diagnose it."""
    who, faults = measured(case, cache)
    names = [n for n in EFFECTS.names() if n not in case.catalogue_without]
    began = time.perf_counter()
    said, _ = diagnose(who, catalogue=names, brief=case.condition not in MEASURED)
    seconds = time.perf_counter() - began
    exact = compare(who, {"true": true_model(case, who.model)}).error("true") if case.condition in MEASURED else {}
    return answer(case, said, faults, seconds, exact)


def answer(case: Case, said: Diagnosis, faults: Any, seconds: float, exact: ByGroup) -> Answer:
    """What a diagnosis says of a case, as plain values; ``exact`` is the error of the true model."""

    def plain(errors: ByGroup) -> dict[str, float]:
        return {g: e.rmse for g, e in errors.items()}

    lines = {k: plain(getattr(said.error, k)) for k in ("nominal", "calibrated", "extended")}
    named = [e for e in said.effects if e.found]
    return Answer(
        id=case.id,
        condition=case.condition,
        vehicle=case.vehicle,
        style=case.style,
        noise=case.noise,
        truth={k: dict(v) for k, v in case.effects.items()},
        verdict=said.verdict,
        named={e.id: {n: (p.value, p.low, p.high) for n, p in e.parameters.items()} for e in named},
        rivals={e.id: e.indistinguishable_from for e in named},
        follows=_followed(said),
        error={**lines, "floor": plain(said.noise_floor), "true": plain(exact)},
        problems=tuple((p.recording, p.signal, p.kind, p.rows, p.detail) for p in said.data_problems),
        faults=tuple((f"flight_{f.recording + 1}", f.signal, f.kind, (f.rows[0], f.rows[1] - 1)) for f in faults),
        notes=(*said.evidence.remarks, *said.evidence.notes),
        seconds=seconds,
        constants={c.constant: (c.nominal, c.calibrated, c.low, c.high) for c in said.evidence.calibration},
    )


def _followed(said: Diagnosis) -> tuple[str, ...]:
    """What an effect that no catalogue has follows: signals of what is left, and of the terms learned in its place."""
    of_terms = (s for e in said.effects if e.term is not None for s in e.term.signals)
    known = (_MEANT.get(s.partition(".")[0], s) for s in of_terms)
    return tuple(dict.fromkeys((*said.unexplained.follows, *known)))


def to_json(one: Answer) -> dict[str, Any]:
    """As JSON values."""
    return asdict(one)
