"""The vehicles of a fleet, as one MLflow run each: numbers and errors as metrics, page and model as artifacts."""

import math
from collections.abc import Collection
from pathlib import Path

from mlflow.entities import Metric, Param

from bench.fleet.members import Member
from bench.fleet.read_answers import answer_of
from bench.fleet.stored import Stored
from bench.tracking.server import connected, experiment_of, find_run, plain, unit_name

SECTIONS = {"number": True, "error": True, "Model metrics": False}
"""Of a fleet's chart page, and whether they are open."""


def mirror_vehicle(tracking_uri: str, experiment: str, folder: Path, known: Collection[str] = ()) -> None:
    """Log the kept answer on a vehicle; the run of a former answer is replaced, the same one is left as it is.

    Args:
        tracking_uri: ``sqlite:///…`` or ``http(s)://…``.
        experiment: of the fleet.
        folder: of the answer.
        known: keys of answers that are logged already, from `whole`.

    Raises:
        TrackingError: the server or the database cannot be used.
    """
    stored = Stored(folder)
    if stored.key in known:
        return
    who = {name: str(stored.told[name]) for name in ("vehicle", "date", "id")}
    member = Member(who["vehicle"], who["date"], who["id"], path="", source="")
    answer = answer_of(member, stored)
    with connected(tracking_uri) as client:
        experiment_id = experiment_of(client, tracking_uri, experiment, SECTIONS)
        run = find_run(client, experiment_id, "slug", folder.name)
        if run is not None:
            client.delete_run(run.info.run_id)
        tags = {**who, "slug": folder.name, "run_key": stored.key, "verdict": answer.verdict, "system": answer.system}
        run = client.create_run(experiment_id, tags={**tags, "effects": ", ".join(answer.effects)}, run_name=answer.id)
        run_id, now = str(run.info.run_id), int(run.info.start_time)
        values: dict[str, float] = {}
        for n in answer.numbers:
            name = f"number/{n.effect} {n.parameter} {unit_name(n.unit)}".rstrip()
            values |= {name: n.value, f"{name} low": n.low, f"{name} high": n.high}
        for e in answer.errors:
            name = f"error/{e.group} {unit_name(e.unit)}".rstrip()
            values |= {f"{name} nominal": e.nominal, f"{name} extended": e.extended, f"{name} floor": e.floor}
        metrics = [Metric(plain(k), v, now, 0) for k, v in values.items() if math.isfinite(v)]
        client.log_batch(run_id, metrics=metrics, params=[Param("system", answer.system)])
        for file in sorted(folder.iterdir()):
            client.log_artifact(run_id, str(file))
        client.set_terminated(run_id)
