"""Trials of a sweep, as one MLflow run each, beside the records of its finalists."""

import math
from collections.abc import Iterable, Sequence
from datetime import datetime
from typing import Any

from mlflow.entities import Metric, Param, RunTag
from optuna.trial import FrozenTrial, TrialState

from bench.experiment.config import RunConfig, to_json
from bench.sweep.space import configured
from bench.tracking.records import flat
from bench.tracking.server import connected, experiment_of, find_run, plain

SECTIONS = {"validation": True, "learning": True, "error_mean": True, "trial": False, "Model metrics": False}
"""Of a sweep's chart page, and whether they are open."""
STATUS = {TrialState.COMPLETE: "FINISHED", TrialState.PRUNED: "KILLED"}
"""In MLflow; any other is FAILED."""
NUMBERS = ("weights", "latency", "updates", "best_update", "seconds")
"""Attributes of a trial that are metrics."""


def mirror_trials(
    tracking_uri: str, experiment: str, study: str, configs: Sequence[RunConfig], trials: Iterable[FrozenTrial]
) -> None:
    """Log trials that are finished; those already there are left as they are, half-logged ones are completed.

    Args:
        tracking_uri: ``sqlite:///…`` or ``http(s)://…``.
        experiment: title of the sweep.
        study: value of the ``study`` tag.
        configs: of the sweep, the default first.
        trials: in any order.

    Raises:
        TrackingError: the server or the database cannot be used.
    """
    with connected(tracking_uri) as client:
        experiment_id = experiment_of(client, tracking_uri, experiment, SECTIONS)
        for t in trials:
            begun, ended = _ms(t.datetime_start), _ms(t.datetime_complete)
            status = t.user_attrs.get("status", "impossible")
            run = find_run(client, experiment_id, "trial", str(t.number))
            if run is None:
                name = f"trial {t.number}: {t.user_attrs.get('spec', status)}"
                tags = {"trial": str(t.number), "study": study}
                run = client.create_run(experiment_id, start_time=begun, tags=tags, run_name=name)
            elif run.info.status != "RUNNING":
                continue
            time = int(run.info.start_time)  # equal points at equal times are one point in MLflow
            params = {**t.params} if status == "impossible" else to_json(configured(configs, t.params))
            client.log_batch(
                run.info.run_id,
                metrics=[Metric(plain(k), v, time, step) for k, step, v in _points(t)],
                params=[Param(plain(k), v) for k, v in flat(params)],
                tags=[RunTag("status", status), RunTag("spec", str(t.user_attrs.get("spec", "")))],
            )
            client.set_terminated(run.info.run_id, status=STATUS.get(t.state, "FAILED"), end_time=ended)


def _points(t: FrozenTrial) -> list[tuple[str, int, float]]:
    """(name, step, value), the finite ones."""
    points: list[tuple[str, int, Any]] = [
        ("learning/validation_rmsse", update, value) for update, value in t.user_attrs.get("curve", [])
    ]
    if t.state == TrialState.COMPLETE:
        points.append(("validation/rmsse", 0, t.values[0]))
    points += [(f"trial/{name}", 0, t.user_attrs.get(name)) for name in NUMBERS]
    points += [(f"validation/{k}", 0, v) for k, v in t.user_attrs.get("metrics", {}).items()]
    return [(name, step, float(v)) for name, step, v in points if v is not None and math.isfinite(v)]


def _ms(time: datetime | None) -> int:
    return int(1000 * time.timestamp()) if time else 0
