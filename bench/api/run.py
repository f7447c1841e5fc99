"""`bench.run`: a study or one configuration, from data to records, tables and drawings."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from bench.analysis.display import Displayed
from bench.analysis.tables import specs, study_table
from bench.execution import engine
from bench.experiment.request import Options, Request, by_owner, request
from bench.experiment.study import Study
from bench.records.record import RunRecord
from registry.contracts import Dataset

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class Results(Displayed):
    """The records of a study or configuration, in the order asked, baselines included."""

    asked: Request
    records: tuple[RunRecord, ...]

    @property
    def headline(self) -> str:
        """What was run, and how many runs that is."""
        return f"{self.asked.title}: {len(self.records)} runs of {len(specs(self.records))} configurations"

    def to_frame(self) -> pd.DataFrame:
        """One row a horizon, output and configuration.

        Returns:
            horizon (samples), output, spec, weights (count), unit, rmsse (mean over seeds), rmsse_low, rmsse_high (95 %
            over seeds; NaN with one), first, whole, last (mean error of the first 5, all and the last 20 steps), seeds
            and diverged (runs). Errors in the unit named; NaN where no run is finite.
        """
        return study_table(self.records)

    def plot(self) -> "list[Axes]":
        """Mean error of every prediction step: matplotlib axes, one an output and horizon."""
        from matplotlib import pyplot

        from bench.reporting.figures import draw_per_step

        figure = pyplot.figure()
        draw_per_step(self.records, figure)
        return list(figure.axes)

    def write_report(self, path: str | Path) -> Path:
        """Write one HTML page that needs no network: tables, every step, worst windows, training, provenance.

        Raises:
            BenchError: it cannot be written.
        """
        from bench.reporting import study_page

        command = f"bench.run({self.asked.target!r})"
        study_page.write(Path(path), self.records, self.asked.title, self.asked.study, command)
        return Path(path)


def run(
    target: str | Study,
    dataset: str | Path | Dataset | None = None,
    *,
    preset: str = "laptop",
    seeds: int | None = None,
    horizon: int | None = None,
    outputs: str | None = None,
    physics: str | Path | None = None,
    options: Mapping[str, Any] | None = None,
    workers: int = 1,
    cluster: str | None = None,
    results: str | Path = "results",
) -> Results:
    """Train and test a study of the paper, or one configuration beside the baselines.

    Runs that are recorded in ``results`` already are not trained again. MLflow is left alone.

    Args:
        target: a study or its name (`bench list studies`), or a configuration such as "LSTM: 1x50 - MLP: 60x10".
        dataset: registered name, a folder with a dataset.toml, or a data set; default: the study's own.
        preset: size of a study: "smoke", "laptop" or "paper".
        seeds: how many; default: 1 of a configuration, of a study what its preset has.
        horizon: prediction length T [samples].
        outputs: what to predict, such as "body_rates,velocity".
        physics: a model.toml for `physics` and hybrids.
        options: any options of the run by path, such as {"training.updates": 3000, "dataset.size": "small"}.
        workers: processes; more than 1 wants the caller's module to be importable (``if __name__ == "__main__"``).
        cluster: address of a Dask scheduler whose workers do it instead.
        results: folder of the records.

    Raises:
        BenchError: an unknown name or option, data that are absent, or a folder that cannot be written.
    """
    model = None if physics is None else str(Path(physics).resolve())
    source = str(dataset) if isinstance(dataset, Path) else dataset
    asked = request(target, Options(source, preset, seeds, *by_owner(options or {}, horizon, outputs), model))
    runs = Path(results) / "runs"
    records = engine.execute(engine.plan(asked.configs, runs), runs, workers, cluster=cluster)
    return Results(asked, tuple(records))
