"""One case of the unknown diagnosed, as plain values."""

import time
from pathlib import Path
from typing import Any

import torch

from bench.diagnose.diagnose import diagnose
from bench.diagnose.learned_shape import WAVE
from bench.diagnose.result import Diagnosis
from bench.score.attempt import answer, to_json
from bench.score.unknown.case import measured
from bench.score.unknown.condition import UnknownCase
from registry.core import EFFECTS
from registry.dynamics import PhysicsModel


def attempt(case: UnknownCase, cache: Path) -> dict[str, Any]:
    """Simulate a case (or take its folder from the cache) and diagnose it."""
    who = measured(case, cache)
    names = [n for n in EFFECTS.names() if n not in case.catalogue_without]
    began = time.perf_counter()
    said, model = diagnose(who, catalogue=names)
    out = to_json(answer(case, said, (), time.perf_counter() - began, {}))
    out["extra"] = {"shares": {}, "distance": {}, "terms": terms(said, model), "horizon_s": _horizon(said)}
    return out


def terms(said: Diagnosis, model: PhysicsModel) -> list[dict[str, Any]]:
    """What was learned: axis, signals, form, frequency where it swings [Hz], curve with its band."""
    learned = [e for e in said.effects if e.learned]
    added = model.effects[len(model.effects) - len(said.effects) :]
    of = [e for e, named in zip(added, said.effects, strict=True) if named.learned]
    curves = list(said.evidence.learned) if len(said.evidence.learned) == len(learned) else [None] * len(learned)
    out = []
    for named, effect, curve in zip(learned, of, curves, strict=True):
        shape = named.term
        frequency = getattr(effect, "frequency", None)
        out.append(
            {
                "axis": "" if shape is None else shape.axis,
                "signals": [] if shape is None else list(shape.signals),
                "shape": "" if shape is None else shape.shape,
                "described": named.described,
                "swings": frequency is not None or (shape is not None and shape.shape == WAVE),
                "frequency": None if frequency is None else float(torch.as_tensor(frequency).reshape(-1)[0]),
                "curve": None if curve is None else {k: list(getattr(curve, k)) for k in ("x", "y", "low", "high")},
            }
        )
    return out


def _horizon(said: Diagnosis) -> dict[str, float]:
    return {g: e.horizon_s for g, e in said.error.nominal.items()}
