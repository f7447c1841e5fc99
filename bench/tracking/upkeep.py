"""What is in MLflow already, and what a killed driver has left there half logged."""

from collections.abc import Iterator
from pathlib import Path

from mlflow.entities import Run
from mlflow.tracking import MlflowClient

from bench.records import record
from bench.records.record import RunRecord
from bench.tracking.records import mirror_one
from bench.tracking.server import connected

_PAGE = 1000


def whole(tracking_uri: str, experiment: str, study: str | None = None) -> set[str]:
    """Keys of the records that an experiment has in full, with that ``study`` tag: one request for a thousand.

    Raises:
        TrackingError: the server or the database cannot be used.
    """
    with connected(tracking_uri) as client:
        found = client.get_experiment_by_name(experiment)
        if found is None or found.lifecycle_stage == "deleted":
            return set()
        runs = _runs(client, [found.experiment_id], "attributes.status != 'RUNNING'")
        return {r.data.tags["run_key"] for r in runs if "run_key" in r.data.tags and r.data.tags.get("study") == study}


def repair(tracking_uri: str, runs: Path, own: bool) -> int:
    """Complete the runs that killed drivers have left RUNNING, in all experiments.

    Args:
        tracking_uri: ``sqlite:///…`` or ``http(s)://…``.
        runs: folder of the records.
        own: nobody else logs there, so that a run without a record here is one that was pruned: it is deleted.

    Returns:
        How many were completed or deleted.

    Raises:
        TrackingError: the server or the database cannot be used.
    """
    repaired = 0
    with connected(tracking_uri) as client:
        experiments = [e.experiment_id for e in client.search_experiments(max_results=_PAGE)]
        for run in list(_runs(client, experiments, "attributes.status = 'RUNNING'")):
            key = run.data.tags.get("run_key")
            if key is not None and record.exists(runs, key):
                mirror_one(client, run.info.experiment_id, RunRecord(runs / key), run.data.tags.get("study"))
                repaired += 1
            elif key is not None and own:
                client.delete_run(run.info.run_id)
                repaired += 1
    return repaired


def _runs(client: MlflowClient, experiments: list[str], condition: str) -> Iterator[Run]:
    token = None
    while experiments:
        page = client.search_runs(experiments, condition, max_results=_PAGE, page_token=token)
        yield from page
        token = page.token
        if not token:
            return
