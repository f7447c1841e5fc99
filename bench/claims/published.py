"""Numbers that this suite published still hold: against runs made here, or against a small set trained again."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import stdtrit

from bench.claims.estimate import ALPHA
from bench.claims.evidence import StudyRun
from bench.claims.gathering import Folder, folders
from bench.claims.manifest import entered
from bench.records.record import RunRecord, exists, write_json
from registry.atomic_io import scratch, writing
from registry.errors import BenchError

OTHER_PROCESSOR = 0.01
"""Relative difference that is nobody's fault: another kind of processor rounds otherwise and training amplifies it."""
RERUN_SEEDS = 3
SMOKE = Path("check") / "smoke.json"
RERUN = (
    ("helicopter_twin", "euler_rates", "MLFC: 1x20 - MLP: 30x10"),
    ("helicopter_twin", "euler_rates", "LSTM: 1x20 - MLP: 30x10"),
    ("helicopter_twin", "euler_rates", "LSTM: 1x20 - Washout: 10"),
    ("helicopter_twin", "euler_rates", "LSTM TDL: 1x20 - RNN: 20x10"),
    ("pelican_twin", "velocity,body_rates", "Cascade: 1x20 - MLP: 30x10"),
    ("pelican_twin", "velocity,body_rates", "Hybrid: 1x20 - MLP: 30x10"),
)
"""Data set, outputs and configuration of the small fixed set: every kind of predictor and initializer."""


@dataclass(frozen=True)
class Held:
    """One published number beside the one made here."""

    name: str
    published: float
    here: float
    band: float
    """Largest relative difference that is allowed; 0: the same run, which must be equal."""
    holds: bool

    @property
    def how(self) -> str:
        """ "same", "within spread" of seeds, or "moved"."""
        return ("within spread" if self.band else "same") if self.holds else "moved"


Group = tuple[str, str, str, str, tuple[str, ...], int]
"""Study, data set, preset, configuration, outputs, horizon."""


def check(published: Path, results: Path) -> list[Held]:
    """Every published number that was also made in this results folder.

    The same run key is the same run and must be equal. Otherwise the means over seeds (of the logarithm) may differ
    by Student's band from the spread over seeds, pooled over all configurations of a study, data set and horizon and
    corrected (Bonferroni) for the number of checks, or by `OTHER_PROCESSOR` where that is more.
    """
    here: dict[Group, dict[str, StudyRun]] = {}
    for folder in folders(results / "studies"):
        if folder.comparable:
            _file(here, folder)
    there: dict[Group, dict[str, StudyRun]] = {}
    for folder in folders(published):
        if folder.comparable:
            _file(there, folder)
    found: list[Held] = []
    loose: list[tuple[Group, str, list[float], list[float]]] = []
    for group, runs in there.items():
        made = here.get(group, {}) | {k: r for k in runs if (r := _recorded(results / "runs", k)) is not None}
        for key in runs.keys() & made.keys():
            found += _equal(f"{_words(group)}, seed {runs[key].seed}", runs[key].metrics, made[key].metrics)
        if made and not runs.keys() & made.keys():
            for metric in next(iter(runs.values())).metrics:
                sides = [_logs(side.values(), metric) for side in (runs, made)]
                if all(sides):
                    loose.append((group, metric, sides[0], sides[1]))
    spread = _spread(there, here)
    for group, metric, a, b in loose:
        deviation, freedom = spread.get((*group[:3], group[-1]), (math.nan, 0))
        if freedom:
            t = float(stdtrit(freedom, 1 - ALPHA / (2 * len(loose))))
            band = max(math.expm1(t * deviation * math.sqrt(1 / len(a) + 1 / len(b))), OTHER_PROCESSOR)
            difference = abs(math.expm1(float(np.mean(b) - np.mean(a))))
            name = f"{_words(group)}, {metric}, mean of {len(a)} and {len(b)} seeds"
            published_mean, mean = (math.exp(float(np.mean(x))) for x in (a, b))
            found.append(Held(name, published_mean, mean, band, difference <= band))
    return found


def _file(into: dict[Group, dict[str, StudyRun]], folder: Folder) -> None:
    for run in folder.runs:
        group = (folder.study, run.dataset, folder.preset, run.spec, run.outputs, run.horizon)
        into.setdefault(group, {})[run.key] = run


def _recorded(runs: Path, key: str) -> StudyRun | None:
    """The run of this key as its own record says it."""
    return StudyRun.of(RunRecord(runs / key).summary) if exists(runs, key) else None


def _words(group: Group) -> str:
    study, dataset, _, spec, outputs, horizon = group
    signals = dict.fromkeys(o if len(outputs) == 1 else o.partition(".")[0] for o in outputs)
    return f"{study}, {dataset}, {spec}, {', '.join(signals)}, T = {horizon}"


def _equal(name: str, a: Mapping[str, float | None], b: Mapping[str, float | None]) -> list[Held]:
    """Metric by metric, None being a diverged run."""
    found = []
    for metric in sorted({*a, *b}):
        x, y = (math.nan if m.get(metric) is None else float(m[metric] or 0) for m in (a, b))
        holds = (math.isnan(x) and math.isnan(y)) or x == y
        found.append(Held(f"{name}, {metric}", x, y, 0.0, holds))
    return found


def _logs(runs: Iterable[StudyRun], metric: str) -> list[float]:
    return [math.log(v) for r in runs if r.sound and (v := r.metrics.get(metric))]


def _spread(*sides: dict[Group, dict[str, StudyRun]]) -> dict[tuple[Any, ...], tuple[float, int]]:
    """(study, data set, preset, horizon) → standard deviation of log errors over seeds, degrees of freedom."""
    squares: dict[tuple[Any, ...], list[float]] = {}
    for side in sides:
        for group, runs in side.items():
            for metric in next(iter(runs.values())).metrics:
                logs = _logs(runs.values(), metric)
                if len(logs) > 1:
                    total = squares.setdefault((*group[:3], group[-1]), [0.0, 0])
                    total[0] += float(np.var(logs)) * len(logs)
                    total[1] += len(logs) - 1
    return {k: (math.sqrt(total / freedom), int(freedom)) for k, (total, freedom) in squares.items()}


# --------------------------------------------------------------------------------------------------- trained again


def rerun() -> list[dict[str, Any]]:
    """Train the small fixed set, from nothing, in a folder of its own: minutes on one core."""
    from bench.execution import engine  # what trains takes seconds to import, and `check` needs none of it
    from bench.experiment.config import RunConfig, Training
    from bench.experiment.notation import parse
    from registry.core import DATASETS

    training = Training(updates=150, evaluate_every=50, validation_windows=128)
    configs = []
    for dataset, outputs, spec in RERUN:
        run = RunConfig(
            *parse(spec),
            DATASETS.get(dataset)(),
            outputs=tuple(outputs.split(",")),
            training=training,
            test_stride=50,
        )
        configs += [replace(run, seed=seed) for seed in range(RERUN_SEEDS)]
    with scratch() as folder:
        records = engine.execute(engine.plan(configs, folder), folder)
        names = ("key", "spec", "dataset", "outputs", "horizon", "seed", "status", "metrics")
        return [{n: r.summary[n] for n in names} for r in records]


def write_smoke(published: Path, runs: Sequence[Mapping[str, Any]]) -> Path:
    """Publish the numbers of `rerun`."""
    path = published / SMOKE
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, {"command": "bench check --rerun smoke --write", "runs": list(runs)})
    return entered(path)


def check_smoke(published: Path, runs: Sequence[Mapping[str, Any]]) -> list[Held]:
    """The numbers of `rerun` beside the published ones, each seed of a configuration beside the same one.

    Equal where a run has its published key. Another kernel or processor gives another key, and twins whose last bits
    may differ: then the mean over seeds (of the logarithm) may differ by Student's band from the published spread over
    seeds, pooled over the configurations of a data set and corrected (Bonferroni) for the number of checks.
    """
    there = _smoke(published / SMOKE)
    found: list[Held] = []
    loose: list[tuple[str, str, list[float], list[float]]] = []
    for dataset, _, spec in RERUN:
        made = [dict(r) for r in runs if (r["dataset"], r["spec"]) == (dataset, spec)]
        name = f"{spec} on {dataset}"
        published_runs = [there.get((dataset, spec, r["seed"])) for r in made]
        if not made or None in published_runs:
            remedy = "write it again with `bench check --rerun smoke --write`"
            raise BenchError(f"{published / SMOKE} lacks {name}: {remedy}.")
        sides = [r for r in published_runs if r is not None], made
        if all(a["key"] == b["key"] for a, b in zip(*sides, strict=True)):
            for a, b in zip(*sides, strict=True):
                found += _equal(f"{name}, seed {a['seed']}", a["metrics"], b["metrics"])
        else:
            for m in sorted(sides[0][0]["metrics"]):
                loose.append((dataset, f"{name}, {m}", _column(sides[0], m), _column(sides[1], m)))
    spread = _smoke_spread(there.values())
    return found + [_within(name, *spread[dataset], a, b, len(loose)) for dataset, name, a, b in loose]


def _smoke(path: Path) -> dict[tuple[str, str, int], dict[str, Any]]:
    """What was published, by data set, configuration and seed."""
    try:
        return {(r["dataset"], r["spec"], r["seed"]): r for r in json.loads(path.read_text())["runs"]}
    except FileNotFoundError:
        raise BenchError(f"{path} is not there: write it with `bench check --rerun smoke --write`.") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BenchError(f"{path} is damaged: write it again with `bench check --rerun smoke --write`.") from error


def _column(runs: Sequence[Mapping[str, Any]], metric: str) -> list[float]:
    """A metric of every run, NaN where it diverged."""
    return [math.nan if (v := r["metrics"].get(metric)) is None else float(v) for r in runs]


def _smoke_spread(runs: Iterable[Mapping[str, Any]]) -> dict[str, tuple[float, int]]:
    """Data set → standard deviation of log errors over seeds, degrees of freedom; the metrics of a run count once."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for r in runs:
        groups.setdefault((r["dataset"], r["spec"]), []).append(r)
    totals: dict[str, tuple[float, int]] = {}
    for (dataset, _), made in groups.items():
        variances = [np.var(np.log(_column(made, m)), ddof=1) for m in made[0]["metrics"]] if len(made) > 1 else []
        finite = [float(v) for v in variances if math.isfinite(v)]
        square, freedom = totals.get(dataset, (0.0, 0))
        own = len(made) - 1 if finite else 0
        totals[dataset] = square + own * (float(np.mean(finite)) if finite else 0.0), freedom + own
    return {d: (math.sqrt(square / freedom) if freedom else 0.0, freedom) for d, (square, freedom) in totals.items()}


def _within(name: str, deviation: float, freedom: int, a: Sequence[float], b: Sequence[float], checks: int) -> Held:
    """Whether two means over seeds differ by no more than seeds do."""
    t = float(stdtrit(freedom, 1 - ALPHA / (2 * checks))) if freedom else 0.0
    band = max(math.expm1(t * deviation * math.sqrt(1 / len(a) + 1 / len(b))), OTHER_PROCESSOR)
    there, here = (math.exp(float(np.mean(np.log(x)))) for x in (a, b))
    diverged = [math.isnan(x) for x in (*a, *b)]
    holds = all(diverged) or (not any(diverged) and abs(math.log(here / there)) <= math.log1p(band))
    return Held(f"{name}, mean of {len(a)} seeds", there, here, band, holds)
