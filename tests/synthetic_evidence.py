"""Evidence of made-up studies whose truth is known."""

from collections.abc import Callable, Mapping, Sequence
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from bench.claims.evidence import COST, Evidence, StudyRun
from bench.experiment import study
from bench.records.record import RunRecord
from bench.reporting.study_outputs import write_outputs

Truth = Callable[[str, str, np.ndarray], np.ndarray]
"""(configuration, signal, step) → mean error."""
AXES = {"velocity": "xyz", "body_rates": "pqr"}


def evidence(
    truth: Truth,
    specs: tuple[str, ...],
    horizons: tuple[int, ...] = (40,),
    signals: tuple[str, ...] = ("body_rates",),
    seeds: int = 5,
    recordings: int = 12,
    noise: float = 0.02,
    weights: Mapping[str, int] | None = None,
    updates: Mapping[str, float] | None = None,
    lost: Mapping[str, int] | None = None,
    euclid: Mapping[str, float] | None = None,
    draw: int = 0,
) -> Evidence:
    """Signals of three axes predicted whole; log-normal spread over recordings (shared), seeds and both.

    Args:
        truth: what the mean errors are.
        specs: configurations.
        horizons: prediction lengths.
        signals: what is predicted.
        seeds: of every configuration and horizon.
        recordings: of the test part.
        noise: standard deviation of the log error of a seed, and of a seed on a recording.
        weights: by configuration.
        updates: in which the validation cost falls to 1/e, by configuration.
        lost: how many of the seeds diverged, by configuration.
        euclid: Euclidean norm over the paper's, by configuration.
        draw: of the random spread.
    """
    shared = np.random.default_rng([draw, 9]).normal(0, 0.3, recordings)
    runs, tables = [], []
    for s, spec in enumerate(specs):
        for horizon in horizons:
            for seed in range(seeds):
                key = f"{spec}|{horizon}|{seed}"
                diverged = seed < (lost or {}).get(spec, 0)
                step = np.arange(1, horizon + 1)
                metrics: dict[str, float | None] = {}
                for signal in signals:
                    rng = np.random.default_rng([draw, s, horizon, seed, *map(ord, signal)])
                    spread = rng.normal(0, noise) + rng.normal(0, noise, recordings)
                    curves = truth(spec, signal, step) * np.exp(shared + spread)[:, None]  # (R, T)
                    values = {f"mean@flight{r}": c for r, c in enumerate(curves)} | {"mean": curves.mean(0)}
                    factor = 1.7 * (euclid or {}).get(spec, 1.0)
                    norms = {"paper": values, "euclidean": {n: factor * v for n, v in values.items()}}
                    found = {(signal, norm): v for norm, v in norms.items()}
                    channels = [f"{signal}.{a}" for a in AXES[signal.partition("_un")[0].partition("_forced")[0]]]
                    found |= {(c, "axis"): {"q99": 3 * values["mean"]} for c in channels}
                    metrics[f"rmsse.{signal}"] = None if diverged else float(curves.mean())
                    for (quantity, norm), by_statistic in found.items():
                        for statistic, value in by_statistic.items():
                            columns = {"key": key, "quantity": quantity, "norm": norm, "step": step}
                            unit = "deg/s" if "rates" in signal else "m/s"
                            tables.append(
                                pd.DataFrame({**columns, "unit": unit, "statistic": statistic, "value": value})
                            )
                update = np.arange(10, 410, 10)
                fall = (updates or {}).get(spec, 100.0) * np.exp(rng.normal(0, noise))
                learned = {"key": key, "quantity": COST, "norm": "scaled", "unit": "1", "statistic": "mean"}
                tables.append(pd.DataFrame({**learned, "step": update, "value": np.exp(-update / fall)}))
                outputs = tuple(
                    f"{s}.{a}" for s in signals for a in AXES[s.partition("_un")[0].partition("_forced")[0]]
                )
                runs.append(
                    StudyRun(
                        key,
                        spec,
                        "twin",
                        outputs,
                        horizon,
                        seed,
                        "diverged" if diverged else "finished",
                        (weights or {}).get(spec, 1000),
                        metrics,
                    )
                )
    return Evidence("made_up", "twin", "laptop", tuple(runs), pd.concat(tables, ignore_index=True))


def concluded(records: Sequence[RunRecord], command: str, folder: Path) -> None:
    """The folder of a study, without what is drawn and printed."""
    with pytest.MonkeyPatch.context() as quick:
        for name in ("figures.per_step_figure", "report.render_terminal", "study_page.write"):
            quick.setattr(f"bench.reporting.{name}", lambda *_: None)
        quick.setattr("bench.reporting.report.to_markdown", lambda *_: "")
        write_outputs(Console(file=StringIO()), records, "made up", study.get("washout_vs_mlp"), command, folder)
