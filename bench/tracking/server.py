"""An MLflow server or database as a client sees it: where it lies, its experiments; failures are one sentence."""

import json
import logging
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "1")  # the default waits minutes for a dead server
os.environ.setdefault("MLFLOW_HTTP_REQUEST_TIMEOUT", "20")
os.environ.setdefault("MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT", "true")

from mlflow.entities import Run
from mlflow.exceptions import MlflowException
from mlflow.tracking import MlflowClient
from sqlalchemy.exc import SQLAlchemyError

from registry import atomic_io
from registry.errors import BenchError

VIEW = "bench"
"""Name of the view that is stored with every experiment and that a chart link opens."""

for _name in ("mlflow", "alembic"):
    logging.getLogger(_name).setLevel(logging.ERROR)


class TrackingError(BenchError):
    """The tracking server or its database cannot be used; records are safe, and a study may go on without it."""


def default_uri(results: Path) -> str:
    """The sqlite database of a results folder; artifacts lie beside it in ``mlartifacts``."""
    return f"sqlite:///{results.resolve() / 'mlflow.db'}"


def artifact_root(uri: str) -> Path:
    """Where the artifacts of a sqlite database lie."""
    return Path(uri.removeprefix("sqlite:///")).resolve().parent / "mlartifacts"


def prepare(uri: str) -> None:
    """Create the database's tables, where there are none.

    Raises:
        TrackingError: the server or the database cannot be reached.
        BenchError: the address is a folder, which MLflow no longer takes.
    """
    with connected(uri) as client:
        client.search_experiments(max_results=1)


def find_experiment(tracking_uri: str, name: str | None = None) -> str | None:
    """The id of the experiment of that name, or of the one last written to; None if there is none.

    Raises:
        TrackingError: the server or the database cannot be used.
    """
    with connected(tracking_uri) as client:
        if name is not None:
            found = client.get_experiment_by_name(name)
            return None if found is None else str(found.experiment_id)
        used = [e for e in client.search_experiments(order_by=["last_update_time DESC"]) if e.name != "Default"]
        return str(used[0].experiment_id) if used else None


@contextmanager
def connected(uri: str) -> Iterator[MlflowClient]:
    """A client whose failures are one sentence."""
    if "://" not in uri or uri.startswith("file:"):
        raise BenchError(f"{uri!r} cannot hold MLflow runs: give sqlite:///FILE or http://HOST:PORT.")
    try:
        if uri.startswith("sqlite:///"):
            _create(Path(uri.removeprefix("sqlite:///")))
        yield MlflowClient(tracking_uri=uri)
    except ImportError as error:
        raise BenchError(f"{uri!r:.300} needs a driver that is not installed ({error}): install it.") from error
    except (MlflowException, SQLAlchemyError, OSError, ValueError) as error:
        reason = str(error).strip().splitlines()[0][:160]
        raise TrackingError(
            f"MLflow at {uri} cannot be used ({reason}); the records are safe, run `bench sync` later."
        ) from error


def _create(database: Path) -> None:
    """Make a database elsewhere and put it in its place whole, where there is none.

    MLflow makes its tables in dozens of steps; what a kill or a full disk leaves of them it can neither use nor mend.
    """
    if database.exists():
        return
    database.parent.mkdir(parents=True, exist_ok=True)
    with atomic_io.scratch() as elsewhere, atomic_io.drafting(database.parent, f".{database.name}.") as beside:
        made, draft = elsewhere / database.name, beside / database.name
        MlflowClient(tracking_uri=f"sqlite:///{made}").search_experiments(max_results=1)
        shutil.copyfile(made, draft)
        atomic_io.flush(draft)
        if not database.exists():  # another process may have been quicker
            atomic_io.move(draft, database)


def experiment_of(client: MlflowClient, uri: str, name: str, sections: Mapping[str, bool]) -> str:
    """The id of an experiment, made if new; ``sections`` of its chart page, and whether they are open."""
    found = client.get_experiment_by_name(name)
    if found is not None and found.lifecycle_stage == "deleted":
        client.restore_experiment(found.experiment_id)
    if found is not None:
        return str(found.experiment_id)
    # A database has no server in front of it that would place artifacts.
    location = (artifact_root(uri) / plain(name)).as_uri() if uri.startswith("sqlite:///") else None
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
        "isAccordionReordered": True,  # otherwise MLflow sorts the sections by name
        "orderByKey": "attributes.start_time",
        "orderByAsc": True,
    }


def find_run(client: MlflowClient, experiment_id: str, tag: str, value: str) -> Run | None:
    """The run of an experiment with that tag."""
    found = client.search_runs([experiment_id], filter_string=f"tags.{tag} = '{value}'", max_results=1)
    return found[0] if found else None


def unit_name(unit: str) -> str:
    """A unit without the slash, which MLflow reads as a chart section: deg/s → deg per s."""
    return "" if unit == "1" else unit.replace("/", " per ")


def plain(name: str) -> str:
    """A name of the characters that MLflow takes on every system."""
    return re.sub(r"[^/\w.\- ]", "", name)
