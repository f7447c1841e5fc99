"""Numbers that this suite published still hold: against runs made here, or against a small set trained again."""

import json
import math
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import stdtrit

from bench.claims.estimate import ALPHA
from bench.claims.evidence import Folder, StudyRun, folders
from bench.claims.manifest import entered
from bench.records.record import RunRecord, exists, write_json
from registry.errors import BenchError

OTHER_PROCESSOR = 0.01
"""Relative difference that is nobody's fault: another kind of processor rounds otherwise and training amplifies it."""
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


def _equal(name: str, a: Mapping[str, float | None], b: Mapping[str, float | None], band: float = 0.0) -> list[Held]:
    """Metric by metric, None being a diverged run."""
    found = []
    for metric in sorted({*a, *b}):
        x, y = (math.nan if m.get(metric) is None else float(m[metric] or 0) for m in (a, b))
        holds = (math.isnan(x) and math.isnan(y)) or abs(y - x) <= band * abs(x)
        found.append(Held(f"{name}, {metric}", x, y, band, holds))
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
        predictor, initializer = parse(spec)
        configs.append(
            RunConfig(
                predictor,
                initializer,
                DATASETS.get(dataset)(),
                outputs=tuple(outputs.split(",")),
                training=training,
                test_stride=50,
            )
        )
    with tempfile.TemporaryDirectory() as folder:
        records = engine.execute(engine.plan(configs, Path(folder)), Path(folder))
        names = ("key", "spec", "dataset", "outputs", "horizon", "seed", "status", "metrics")
        return [{n: r.summary[n] for n in names} for r in records]


def write_smoke(published: Path, runs: Sequence[Mapping[str, Any]]) -> Path:
    """Publish the numbers of `rerun`."""
    path = published / SMOKE
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, {"command": "bench check --rerun smoke --write", "runs": list(runs)})
    except OSError as error:
        raise BenchError(f"{path} cannot be written: {error.strerror or error}.") from error
    return entered(path)


def check_smoke(published: Path, runs: Sequence[Mapping[str, Any]]) -> list[Held]:
    """The numbers of `rerun` beside the published ones: equal for an equal key, else to `OTHER_PROCESSOR`."""
    path = published / SMOKE
    try:
        there = {(r["dataset"], r["spec"]): r for r in json.loads(path.read_text())["runs"]}
    except FileNotFoundError:
        raise BenchError(f"{path} is not there: write it with `bench check --rerun smoke --write`.") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BenchError(f"{path} is damaged: write it again with `bench check --rerun smoke --write`.") from error
    found: list[Held] = []
    for run in runs:
        old = there.pop((run["dataset"], run["spec"]), None)
        name = f"{run['spec']} on {run['dataset']}"
        if old is None:
            raise BenchError(f"{path} lacks {name}: write it again with `bench check --rerun smoke --write`.")
        band = 0.0 if run["key"] == old["key"] else OTHER_PROCESSOR
        found += _equal(name, old["metrics"], run["metrics"], band)
    return found
