"""Finished records, mirrored as one MLflow run each.

Runs are flat: the chart page of MLflow stays empty for nested ones.
"""

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mlflow.entities import Dataset, DatasetInput, InputTag, Metric, Param, RunTag
from mlflow.tracking import MlflowClient

from bench.records.record import RunRecord
from bench.reporting import run_page
from bench.tracking.server import connected, experiment_of, find_run, plain, unit_name
from registry.atomic_io import scratch

CHARTED = ("mean", "median", "q95")
"""Statistics drawn on the chart page; all others are in the record's table, kept as an artifact."""

SECTIONS = {"error_mean": True, "error_median": False, "error_q95": False, "learning": True, "Model metrics": True}
"""Of a study's chart page, and whether they are open."""

_METRICS_PER_CALL, _PARAMS_PER_CALL = 850, 100
"""MLflow takes 1000 of both and of tags together."""
_LONGEST_PARAM = 6000
_LONGEST_TAG = 8000
_LONGEST_DIGEST = 36


@dataclass(frozen=True)
class MirrorResult:
    """Where the records are now: an experiment and one run a record, in the order of the folders."""

    experiment_id: str
    run_ids: tuple[str, ...]


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
    with connected(tracking_uri) as client:
        experiment_id = experiment_of(client, tracking_uri, experiment, SECTIONS)
        runs = tuple(mirror_one(client, experiment_id, RunRecord(Path(f)), study) for f in folders)
        return MirrorResult(experiment_id, runs)


def attach(tracking_uri: str, experiment: str, study: str, files: Iterable[Path]) -> str:
    """Put a study's figures and report into the run ``Report: <study>``, replacing those of the same name.

    Returns:
        The id of that run, which stands in the run list beside the study's own.

    Raises:
        TrackingError: the server or the database cannot be used.
    """
    with connected(tracking_uri) as client:
        experiment_id = experiment_of(client, tracking_uri, experiment, SECTIONS)
        run = find_run(client, experiment_id, "report_of", study)
        if run is None:
            tags = {"report_of": study, "study": study}
            run = client.create_run(experiment_id, tags=tags, run_name=f"Report: {study}")
        for file in files:
            client.log_artifact(run.info.run_id, str(file))
        client.set_terminated(run.info.run_id)
        return str(run.info.run_id)


def mirror_one(client: MlflowClient, experiment_id: str, record: RunRecord, study: str | None) -> str:
    """Log one finished record and give back its run's id; see `mirror`."""
    summary, provenance = record.summary, record.provenance
    run = find_run(client, experiment_id, "run_key", record.key)
    if run is None:
        started = int(provenance["started_ms"])
        name = " | ".join(
            [summary["spec"], ", ".join(summary["outputs"]), f"T={summary['horizon']}", f"seed {summary['seed']}"]
        )
        run = client.create_run(experiment_id, start_time=started, tags={"run_key": record.key}, run_name=name)
    run_id = str(run.info.run_id)
    if run.info.status != "RUNNING":  # the status is written last: this run is whole
        if study is not None and run.data.tags.get("study") != study:
            client.set_tag(run_id, "study", study)
        return run_id
    # Equal points at equal times are one point in MLflow: a half-logged run is completed without duplicates.
    time = int(run.info.start_time)
    points, missing = metrics(record)
    logged = [Metric(key, value, time, step) for key, step, value in points]
    params = [Param(plain(k), v) for k, v in flat(record.config) if len(v) <= _LONGEST_PARAM]
    tags = [RunTag(k, v[:_LONGEST_TAG]) for k, v in _tags(record, study, missing).items()]
    calls = max(math.ceil(len(logged) / _METRICS_PER_CALL), math.ceil(len(params) / _PARAMS_PER_CALL), 1)
    for i in range(calls):  # each is answered once, however slow the server
        client.log_batch(
            run_id,
            metrics=logged[i * _METRICS_PER_CALL : (i + 1) * _METRICS_PER_CALL],
            params=params[i * _PARAMS_PER_CALL : (i + 1) * _PARAMS_PER_CALL],
            tags=[] if i else tags,
        )
    client.log_inputs(run_id, datasets=[_dataset(summary)])
    with scratch() as folder:
        if not record.steps.empty:
            page = folder / "error_per_step.html"
            page.write_text(run_page.render(record), encoding="utf-8")
            client.log_artifact(run_id, str(page))
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
    steps = run_page.distinct(record.steps)
    for row in steps[steps.statistic.isin(CHARTED)].itertuples():
        what = row.quantity if row.norm == "axis" else f"{row.quantity} {row.norm} norm"
        name = f"error_{row.statistic}/{what} T{record.summary['horizon']} {unit_name(row.unit)}".rstrip()
        points.append((name, int(row.step), row.value))
    for row in record.curve.itertuples():
        points.append(("learning/train_loss", int(row.update), row.train_loss))
        points.append(("learning/validation_loss", int(row.update), row.validation_loss))
    kept, missing = [], dict[str, int]()
    for key, step, value in points:
        if value is not None and math.isfinite(value):
            kept.append((plain(key), step, float(value)))
        else:
            missing[plain(key)] = missing.get(plain(key), 0) + 1
    return kept, missing


def flat(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested configuration as (``training.updates``, text) pairs; text stays as it is, the rest is JSON."""
    for key, value in config.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


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
