"""The mirror of finished records in MLflow. A record is the truth: everything here can be rebuilt from records.

One MLflow run per record and experiment, found again by its run key, so that mirroring twice changes nothing. Runs
are flat: the chart page of MLflow stays empty for nested ones.
"""

import json
import logging
import math
import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "1")  # the default waits minutes for a dead server
os.environ.setdefault("MLFLOW_HTTP_REQUEST_TIMEOUT", "20")

import pandas as pd
import seaborn
from matplotlib.figure import Figure
from mlflow.entities import Dataset, DatasetInput, InputTag, Metric, Param, Run, RunTag
from mlflow.exceptions import MlflowException
from mlflow.tracking import MlflowClient
from sqlalchemy.exc import SQLAlchemyError

from bench.diagnose.diagnosis import ByGroup
from bench.record import RunRecord
from registry.errors import BenchError

CHARTED = ("mean", "median", "q95")
"""Statistics drawn on the chart page; all others are in the record's table, kept as an artifact."""

VIEW = "bench"
"""Name of the view that is stored with every experiment and that a chart link opens."""

SECTIONS = {"error_mean": True, "error_median": False, "error_q95": False, "learning": True, "Model metrics": True}
"""Of a study's chart page, and whether they are open."""

_METRICS_PER_CALL = 1000
_PARAMS_PER_CALL = 100
_LONGEST_PARAM = 6000
_LONGEST_TAG = 8000
_LONGEST_DIGEST = 36

for _name in ("mlflow", "alembic"):
    logging.getLogger(_name).setLevel(logging.ERROR)


class TrackingError(BenchError):
    """The tracking server or its database cannot be used; records are safe, and a study may go on without it."""


@dataclass(frozen=True)
class MirrorResult:
    """Where the records are now: an experiment and one run a record, in the order of the folders."""

    experiment_id: str
    run_ids: tuple[str, ...]


def default_uri(results: Path) -> str:
    """The sqlite database of a results folder; artifacts lie beside it in ``mlartifacts``."""
    return f"sqlite:///{results.resolve() / 'mlflow.db'}"


def artifact_root(uri: str) -> Path:
    """Where the artifacts of a sqlite database lie."""
    return Path(uri.removeprefix("sqlite:///")).resolve().parent / "mlartifacts"


def prepare(uri: str) -> None:
    """Create the database's tables. Call it once, in one process, before others use the database.

    Raises:
        TrackingError: the server or the database cannot be reached.
        BenchError: the address is a folder, which MLflow no longer takes.
    """
    with _tracking(uri) as client:
        client.search_experiments(max_results=1)


def mirror(folders: Iterable[Path], tracking_uri: str, experiment: str, study: str | None = None) -> MirrorResult:
    """Log finished records; those already there are left as they are, half-logged ones are completed.

    Args:
        folders: record folders, ``results/runs/<key>``.
        tracking_uri: ``sqlite:///…`` or ``http(s)://…``.
        experiment: MLflow experiment, made if new; one for each study keeps its chart page to its own runs.
        study: value of the ``study`` tag.

    Raises:
        TrackingError: the server or the database cannot be used.
    """
    with _tracking(tracking_uri) as client:
        experiment_id = _experiment(client, tracking_uri, experiment)
        runs = tuple(_mirror_one(client, experiment_id, RunRecord(Path(f)), study) for f in folders)
        return MirrorResult(experiment_id, runs)


def attach(tracking_uri: str, experiment: str, study: str, files: Iterable[Path]) -> str:
    """Put a study's figures and report into the run ``Report: <study>``, replacing those of the same name.

    Returns:
        The id of that run, which stands in the run list beside the study's own.

    Raises:
        TrackingError: the server or the database cannot be used.
    """
    with _tracking(tracking_uri) as client:
        experiment_id = _experiment(client, tracking_uri, experiment)
        run = _find(client, experiment_id, "report_of", study)
        if run is None:
            tags = {"report_of": study, "study": study}
            run = client.create_run(experiment_id, tags=tags, run_name=f"Report: {study}")
        for file in files:
            client.log_artifact(run.info.run_id, str(file))
        client.set_terminated(run.info.run_id)
        return str(run.info.run_id)


def diagnosis_experiment(dataset: str) -> str:
    """Name of the experiment that holds the extensions of a model of ``dataset``."""
    return f"diagnosis: {dataset}"


def log_extension(
    tracking_uri: str,
    dataset: str,
    effects: Sequence[str],
    errors: Mapping[int, ByGroup],
    floor: ByGroup,
    parameters: Mapping[str, float],
    files: Iterable[Path] = (),
) -> str:
    """Log a model with effects as a run that draws how the error fell; a run of the same effects is replaced.

    Args:
        tracking_uri: ``sqlite:///…`` or ``http(s)://…``.
        dataset: names the experiment.
        effects: ids, in the order in which they were added.
        errors: held-out errors by number of effects, those of fewer effects before it included.
        floor: errors that noise alone would give, drawn beside.
        parameters: fitted values, by "effect.parameter".
        files: kept as artifacts, such as the model.toml.

    Returns:
        The run's id.

    Raises:
        TrackingError: the server or the database cannot be used.
    """
    with _tracking(tracking_uri) as client:
        sections = {"falling_error": True, "Model metrics": True}
        experiment_id = _experiment(client, tracking_uri, diagnosis_experiment(dataset), sections)
        label = ", ".join(effects)
        earlier = _find(client, experiment_id, "effects", label)
        if earlier is not None:
            client.delete_run(earlier.info.run_id)
        tags = {"effects": label, "dataset": dataset, "added": effects[-1] if effects else ""}
        run = client.create_run(experiment_id, tags=tags, run_name=f"{len(effects)}: {label or 'no effect'}")
        run_id, now = str(run.info.run_id), int(run.info.start_time)
        logged = []
        for step, by_group in errors.items():
            for group, error in by_group.items():
                name = _plain(f"falling_error/{group} {_unit(error.unit)}").rstrip()
                values = {name: error.rmse, f"{name} floor": floor[group].rmse}
                logged += [Metric(k, v, now, step) for k, v in values.items() if math.isfinite(v)]
        last = errors[max(errors)]
        for group, error in last.items():
            if math.isfinite(error.rmse) and floor[group].rmse > 0:
                logged.append(Metric(_plain(f"{group} over floor"), error.rmse / floor[group].rmse, now, 0))
        logged.append(Metric("effects", len(effects), now, 0))
        client.log_batch(run_id, metrics=logged, params=[Param(_plain(k), f"{v:.9g}") for k, v in parameters.items()])
        for file in files:
            client.log_artifact(run_id, str(file))
        client.set_terminated(run_id)
        return run_id


def find_experiment(tracking_uri: str, name: str | None = None) -> str | None:
    """The id of the experiment of that name, or of the one last written to; None if there is none.

    Raises:
        TrackingError: the server or the database cannot be used.
    """
    with _tracking(tracking_uri) as client:
        if name is not None:
            found = client.get_experiment_by_name(name)
            return None if found is None else str(found.experiment_id)
        used = [e for e in client.search_experiments(order_by=["last_update_time DESC"]) if e.name != "Default"]
        return str(used[0].experiment_id) if used else None


@contextmanager
def _tracking(uri: str) -> Iterator[MlflowClient]:
    """A client whose failures are one sentence."""
    if "://" not in uri or uri.startswith("file:"):
        raise BenchError(f"{uri!r} cannot hold MLflow runs: give sqlite:///FILE or http://HOST:PORT.")
    try:
        if uri.startswith("sqlite:///"):
            Path(uri.removeprefix("sqlite:///")).parent.mkdir(parents=True, exist_ok=True)
        yield MlflowClient(tracking_uri=uri)
    except (MlflowException, SQLAlchemyError, OSError) as error:
        reason = str(error).strip().splitlines()[0][:160]
        raise TrackingError(
            f"MLflow at {uri} cannot be used ({reason}); the records are safe, run `bench sync` later."
        ) from error


def _experiment(client: MlflowClient, uri: str, name: str, sections: Mapping[str, bool] = SECTIONS) -> str:
    found = client.get_experiment_by_name(name)
    if found is not None and found.lifecycle_stage == "deleted":
        client.restore_experiment(found.experiment_id)
    if found is not None:
        return str(found.experiment_id)
    # A database has no server in front of it that would place artifacts.
    location = (artifact_root(uri) / _plain(name)).as_uri() if uri.startswith("sqlite:///") else None
    tags = {f"mlflow.sharedViewState.{VIEW}": json.dumps(_view(sections))}
    return str(client.create_experiment(name, artifact_location=location, tags=tags))


def _view(sections: Mapping[str, bool]) -> dict[str, Any]:
    """How the chart page opens: all runs (MLflow draws ten), mean errors first, charts wide enough to be read."""
    fixed = {"isReordered": False, "isGenerated": True, "deleted": False, "columns": 2, "cardHeight": 360}
    return {
        "runsHiddenMode": "SHOW_ALL",
        "compareRunCharts": [],  # MLflow fills each section with the metrics of that prefix
        "compareRunSections": [
            {"uuid": name, "name": name, "display": shown, **fixed} for name, shown in sections.items()
        ],
        "isAccordionReordered": False,
        "orderByKey": "attributes.start_time",
        "orderByAsc": True,
    }


def _find(client: MlflowClient, experiment_id: str, tag: str, value: str) -> Run | None:
    found = client.search_runs([experiment_id], filter_string=f"tags.{tag} = '{value}'", max_results=1)
    return found[0] if found else None


def _mirror_one(client: MlflowClient, experiment_id: str, record: RunRecord, study: str | None) -> str:
    summary, provenance = record.summary, record.provenance
    run = _find(client, experiment_id, "run_key", record.key)
    if run is None:
        started = int(provenance["started_ms"])
        name = " | ".join(
            [summary["spec"], ", ".join(summary["outputs"]), f"T={summary['horizon']}", f"seed {summary['seed']}"]
        )
        tags = {"run_key": record.key}
        run = client.create_run(experiment_id, start_time=started, tags=tags, run_name=name)
    run_id = str(run.info.run_id)
    if run.info.status != "RUNNING":  # the status is written last: this run is whole
        if study is not None and run.data.tags.get("study") != study:
            client.set_tag(run_id, "study", study)
        return run_id
    # Equal points at equal times are one point in MLflow: a half-logged run is completed without duplicates.
    time = int(run.info.start_time)
    points, missing = metrics(record)
    logged = [Metric(key, value, time, step) for key, step, value in points]
    for i in range(0, len(logged), _METRICS_PER_CALL):
        client.log_batch(run_id, metrics=logged[i : i + _METRICS_PER_CALL])
    params = [Param(_plain(k), v) for k, v in flat(record.config) if len(v) <= _LONGEST_PARAM]
    for i in range(0, len(params), _PARAMS_PER_CALL):
        client.log_batch(run_id, params=params[i : i + _PARAMS_PER_CALL])
    client.log_batch(run_id, tags=[RunTag(k, v[:_LONGEST_TAG]) for k, v in _tags(record, study, missing).items()])
    client.log_inputs(run_id, datasets=[_dataset(summary)])
    with tempfile.TemporaryDirectory() as scratch:
        if not record.steps.empty:
            step_figure(record).savefig(Path(scratch) / "error_per_step.png")
            client.log_artifacts(run_id, scratch)
    client.log_artifacts(run_id, str(record.folder), "record")
    status = "FINISHED" if record.finished else "FAILED"
    client.set_terminated(run_id, status=status, end_time=int(provenance["finished_ms"]))
    return run_id


def metrics(record: RunRecord) -> tuple[list[tuple[str, int, float]], dict[str, int]]:
    """A record as MLflow points (name, step, value), and how many points of each name are not finite.

    Per-step errors, ``error_mean/body_rates.p T40 deg per s``, have the prediction step as their step, learning
    curves the update. The horizon is in the name, so that each has its own chart. Values that are missing, NaN or
    infinite are left out: MLflow would draw infinity as 1.8e308.
    """
    points: list[tuple[str, int, float | None]] = [(k, 0, v) for k, v in record.summary["metrics"].items()]
    steps = _distinct(record.steps)
    for row in steps[steps.statistic.isin(CHARTED)].itertuples():
        what = row.quantity if row.norm == "axis" else f"{row.quantity} {row.norm} norm"
        name = f"error_{row.statistic}/{what} T{record.summary['horizon']} {_unit(row.unit)}".rstrip()
        points.append((name, int(row.step), row.value))
    for row in record.curve.itertuples():
        points.append(("learning/train_loss", int(row.update), row.train_loss))
        points.append(("learning/validation_loss", int(row.update), row.validation_loss))
    kept, missing = [], dict[str, int]()
    for key, step, value in points:
        if value is not None and math.isfinite(value):
            kept.append((_plain(key), step, float(value)))
        else:
            missing[_plain(key)] = missing.get(_plain(key), 0) + 1
    return kept, missing


def flat(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested configuration as (``training.updates``, text) pairs; text stays as it is, the rest is JSON."""
    for key, value in config.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def step_figure(record: RunRecord) -> Figure:
    """Error against prediction time, one panel a quantity: mean, quartile band and 95 % quantile."""
    steps = _distinct(record.steps)
    panels = [group for _, group in steps.groupby(["quantity", "norm"], sort=False)]
    with seaborn.axes_style("whitegrid"):
        figure = Figure(figsize=(4.8 * min(len(panels), 3), 3.4 * math.ceil(len(panels) / 3)), layout="constrained")
        axes = figure.subplots(math.ceil(len(panels) / 3), min(len(panels), 3), squeeze=False)
    for ax in axes.flat[len(panels) :]:
        ax.remove()
    for ax, panel in zip(axes.flat, panels, strict=False):
        by = panel.pivot_table(index="time_s", columns="statistic", values="value")
        first = panel.iloc[0]
        ax.fill_between(by.index, by["q25"], by["q75"], alpha=0.25, label="25 % to 75 %")
        seaborn.lineplot(x=by.index, y=by["mean"], ax=ax, label="mean", errorbar=None)
        seaborn.lineplot(x=by.index, y=by["q95"], ax=ax, label="95 %", errorbar=None, linestyle="--")
        norm = "" if first.norm == "axis" else f" ({first.norm} norm)"
        ax.set(
            title=f"{first.quantity}{norm}",
            xlabel="prediction time [s]",
            ylabel=f"error [{first.unit}]",
            ylim=(0, None),
        )
    figure.suptitle(f"{record.summary['spec']}, {record.summary['dataset']}")
    return figure


def _distinct(steps: pd.DataFrame) -> pd.DataFrame:
    """Without the norms of groups of which one axis is predicted: they equal that axis."""
    groups = steps.quantity[steps.norm == "axis"].drop_duplicates().str.rpartition(".")[0]
    single = groups[~groups.duplicated(keep=False)]
    return steps[(steps.norm == "axis") | ~steps.quantity.isin(single)]


def _tags(record: RunRecord, study: str | None, missing: Mapping[str, int]) -> dict[str, str]:
    summary = record.summary
    tags = {
        "spec": summary["spec"],
        "status": summary["status"],
        "dataset": summary["dataset"],
        "dataset_digest": summary["dataset_digest"],
        "inputs": ", ".join(summary["inputs"]),
        "outputs": ", ".join(summary["outputs"]),
        "horizon": str(summary["horizon"]),
        "seed": str(summary["seed"]),
        "git": str(record.provenance.get("git") or "unknown"),
    }
    if study is not None:
        tags["study"] = study
    if summary.get("diverged_at") is not None:
        tags["diverged_at"] = f"update {summary['diverged_at']}"
    if missing:
        tags["not_finite"] = ", ".join(f"{key}: {count} points" for key, count in missing.items())
    return tags


def _dataset(summary: Mapping[str, Any]) -> DatasetInput:
    digest = summary["dataset_digest"][:_LONGEST_DIGEST]
    source = json.dumps({"dataset": summary["dataset"], "sha256": summary["dataset_digest"]})
    dataset = Dataset(name=summary["dataset"], digest=digest, source_type="bench", source=source)
    return DatasetInput(dataset, [InputTag("mlflow.data.context", "training and test")])


def _unit(unit: str) -> str:
    """A unit without the slash, which MLflow reads as a chart section: deg/s → deg per s."""
    return "" if unit == "1" else unit.replace("/", " per ")


def _plain(name: str) -> str:
    """A name of the characters that MLflow takes on every system."""
    return re.sub(r"[^/\w.\- ]", "", name)
