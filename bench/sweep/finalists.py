"""The end of a sweep: its best configuration and the default one, trained from fresh seeds and judged side by side.

The seeds are not the one that the trials were chosen by, and the test part is looked at here for the first time.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import torch

from bench.analysis import stats
from bench.experiment.config import RunConfig, from_json
from bench.experiment.seeds import derive
from bench.records.record import RunRecord
from bench.records.stamp import canonical
from bench.reporting.report import number
from bench.sweep import journal as sweep
from bench.sweep.space import configured
from bench.sweep.trial import scaled_rmsse
from bench.training import evaluate
from bench.training.data import prepare
from bench.training.predict import load_model
from registry import atomic_io

SEEDS = 3
"""Fresh ones of each finalist."""
PARTS = ("validation", "test")


def finalists(asked: sweep.Sweep, study: optuna.Study) -> tuple[list[RunConfig], list[RunConfig]]:
    """Runs of the best and of the default configuration; no default ones where it is the best."""
    best, default = configured(asked.configs, sweep.best(study).params), asked.default

    def runs(config: RunConfig) -> list[RunConfig]:
        count = SEEDS if config.predictor.training == "gradient" else 1
        return [replace(config, seed=asked.default.seed + 1 + i) for i in range(count)]

    return runs(best), [] if best == default else runs(default)


@dataclass(frozen=True)
class Verdict:
    """Best against default on one part of the data: RMSSE of the scaled outputs, a row a seed, a column a recording."""

    part: str
    best: list[list[float]]
    default: list[list[float]]
    comparison: stats.Comparison

    @property
    def sentence(self) -> str:
        """What it says."""
        c = self.comparison
        if not math.isfinite(c.ratio):
            return f"On the {self.part} part there is nothing to compare: too many runs diverged."
        word = {"better": "beats", "worse": "is worse than"}.get(c.verdict, "cannot be told from")
        limits = f", 95 % {number(c.low)} to {number(c.high)}" if math.isfinite(c.low) and math.isfinite(c.high) else ""
        return (
            f"On the {self.part} part the best configuration {word} the default: {number(c.ratio)} times its error"
            f"{limits} ({c.basis})."
        )


def by_recording(record: RunRecord, part: str) -> list[float]:
    """RMSSE of the scaled outputs on each recording of a part, those without a window left out."""
    config = from_json(record.config)
    data, model = prepare(config), load_model(record)
    windows = getattr(data, part)
    torch.manual_seed(derive(config.seed, part))  # a random washout start
    measured, predicted = evaluate.predict(model, data, windows.starts.numpy())
    errors = (measured - predicted)[..., : len(data.output_channels)]
    scale = data.output_scale[1].numpy()
    return [scaled_rmsse(errors[windows.recording == i], scale) for i in np.unique(windows.recording)]


def judge(best: Sequence[RunRecord], default: Sequence[RunRecord]) -> list[Verdict]:
    """The paired comparison on the validation and on the test part; seeds that diverged on one side are left out."""
    pairs = [(a, b) for a, b in zip(best, default, strict=False) if a.finished and b.finished]
    made = []
    for part in PARTS:
        a, b = ([by_recording(pair[i], part) for pair in pairs] for i in (0, 1))
        left, right = (np.array(side, dtype=float).reshape(len(pairs), -1) for side in (a, b))
        made.append(Verdict(part, a, b, stats.compare(left, right)))
    return made


def write(
    path: Path, asked: sweep.Sweep, study: optuna.Study, records: Sequence[RunRecord], verdicts: Sequence[Verdict]
) -> None:
    """What came out, as JSON without NaN.

    Raises:
        BenchError: the file cannot be written.
    """

    def finite(value: Any) -> Any:
        return None if isinstance(value, float) and not math.isfinite(value) else value

    best = sweep.best(study)
    content = {
        "title": asked.title,
        "command": asked.command,
        "trials": len(sweep.finished(study)),
        "best": {"trial": sweep.place(study, best), "params": best.params, "rmsse": best.values[0]},
        "keys": [r.key for r in records],
        "verdicts": {
            v.part: {
                **{name: finite(value) for name, value in asdict(v.comparison).items()},
                "verdict": v.comparison.verdict,
                "sentence": v.sentence,
                "best": v.best,
                "default": v.default,
            }
            for v in verdicts
        },
    }
    with atomic_io.writing(path):
        atomic_io.write_text(path, canonical(content))
