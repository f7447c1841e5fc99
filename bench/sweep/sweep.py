"""`bench.sweep`: search, train the best and the default configuration from fresh seeds, compare them."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import optuna
import pandas as pd

from bench.analysis.display import Displayed, new_axes
from bench.execution import engine, lock
from bench.experiment.config import RunConfig
from bench.experiment.request import Options, by_owner
from bench.records.finished import slug
from bench.records.record import RunRecord
from bench.sweep import finalists, journal, page
from bench.sweep.request import request
from bench.sweep.search import search
from bench.sweep.space import configured
from registry.contracts import Dataset

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class SweepResult(Displayed):
    """The trials, and whether the best configuration beats the default one."""

    asked: journal.Sweep
    study: optuna.Study
    verdicts: tuple[finalists.Verdict, ...]
    """Best against default on the validation and the test part; none where no trial was better."""
    records: tuple[RunRecord, ...]
    """Runs of the best, then of the default configuration, from fresh seeds."""
    folder: Path

    @property
    def headline(self) -> str:
        """The verdicts."""
        return " ".join(v.sentence for v in self.verdicts) or "No trial was better than the default configuration."

    @property
    def best(self) -> RunConfig:
        """The configuration with the smallest error on the validation part."""
        return configured(self.asked.configs, journal.best(self.study).params)

    def to_frame(self) -> pd.DataFrame:
        """One row a finished trial.

        Returns:
            trial, state, rmsse (validation part, in standard deviations of the outputs; NaN where there is none), a
            column for each option searched.
        """
        finished = [(t, t.values[0] if t.values else math.nan) for t in journal.finished(self.study)]
        rows = [{"trial": t.number, "state": t.state.name.lower(), "rmsse": error, **t.params} for t, error in finished]
        return pd.DataFrame(rows, columns=["trial", "state", "rmsse", *self.asked.space])

    def plot(self) -> "Axes":
        """Error of every finished trial, and the best so far: matplotlib axes."""
        (axes,) = new_axes(1)
        done = self.to_frame().dropna(subset="rmsse")
        axes.plot(done.trial, done.rmsse, "o", label="trial")
        axes.step(done.trial, done.rmsse.cummin(), where="post", label="best so far")
        axes.set(xlabel="trial", ylabel="RMSSE, validation part [standard deviations]")
        axes.grid(alpha=0.3)
        axes.legend()
        return axes


def sweep(
    target: str,
    dataset: str | Path | Dataset | None = None,
    *,
    trials: int = 30,
    searched: Mapping[str, str] | None = None,
    options: Mapping[str, Any] | None = None,
    objectives: Sequence[str] = (),
    preset: str = "laptop",
    seed: int = 0,
    workers: int = 1,
    cluster: str | None = None,
    name: str | None = None,
    resume: bool = False,
    results: str | Path = "results",
) -> SweepResult:
    """Search the options of a configuration, or the configurations of a study, for the smallest validation error.

    Args:
        target: a study's name, or a configuration such as "LSTM: 1x50 - MLP: 60x10".
        dataset: registered name, a folder with a dataset.toml, or a data set; default: the study's own.
        trials: in all, those of a sweep that is resumed included.
        searched: ranges by path, such as {"predictor.hidden": "10:200:log"}, beside the default ones.
        options: options by path that are set and not searched, such as {"training.updates": 500}.
        objectives: beside the error, "weights" or "latency".
        preset: size of a study.
        seed: of the proposals.
        workers: processes.
        cluster: address of a Dask scheduler whose workers do it instead.
        name: of the folder in results/sweeps; default: made of what is searched.
        resume: go on with a sweep that was stopped.
        results: folder of the sweep and of the finalists' records.

    Raises:
        BenchError: an unknown name or option, a sweep of that name that is another one, or one that is in use.
    """
    source = str(dataset) if isinstance(dataset, Path) else dataset
    ranges = [f"{path}={values}" for path, values in (searched or {}).items()]
    asked = request(target, Options(source, preset, None, *by_owner(options or {})), ranges, objectives, seed)
    folder, runs = Path(results) / "sweeps" / slug(name or asked.title), Path(results) / "runs"

    def train(configs: list[RunConfig]) -> list[RunRecord]:
        return engine.execute(engine.plan(configs, runs), runs, workers, cluster=cluster)

    with lock.held(folder, asked.title):
        study = journal.begin(asked, folder, resume)
        search(asked, study, folder, trials, workers, cluster=cluster)
        return train_finalists(asked, study, folder, train)


def train_finalists(
    asked: journal.Sweep,
    study: optuna.Study,
    folder: Path,
    train: Callable[[list[RunConfig]], list[RunRecord]],
) -> SweepResult:
    """Train the best and the default configuration from fresh seeds, compare them, and write page and result.

    Args:
        asked: what was searched.
        study: with every trial finished.
        folder: of the sweep.
        train: makes the records of configurations, in their order.
    """
    best, default = finalists.finalists(asked, study)
    records = train([*best, *default])
    sides = records[: len(best)], records[len(best) :]
    verdicts = finalists.judge(*sides) if default else []
    page.write(folder / journal.REPORT, page.Content(asked, study, verdicts, *sides))
    finalists.write(folder / journal.RESULT, asked, study, records, verdicts)
    return SweepResult(asked, study, tuple(verdicts), tuple(records), folder)
