"""The models that `bench extend` makes, as MLflow runs that draw how the error falls."""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from mlflow.entities import Metric, Param

from bench.diagnose.result import ByGroup
from bench.tracking.server import connected, experiment_of, find_run, plain, unit_name


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
    with connected(tracking_uri) as client:
        sections = {"falling_error": True, "Model metrics": True}
        experiment_id = experiment_of(client, tracking_uri, diagnosis_experiment(dataset), sections)
        label = ", ".join(effects)
        earlier = find_run(client, experiment_id, "effects", label)
        if earlier is not None:
            client.delete_run(earlier.info.run_id)
        tags = {"effects": label, "dataset": dataset, "added": effects[-1] if effects else ""}
        run = client.create_run(experiment_id, tags=tags, run_name=f"{len(effects)}: {label or 'no effect'}")
        run_id, now = str(run.info.run_id), int(run.info.start_time)
        logged = []
        for step, by_group in errors.items():
            for group, error in by_group.items():
                name = plain(f"falling_error/{group} {unit_name(error.unit)}").rstrip()
                values = {name: error.rmse, f"{name} floor": floor[group].rmse}
                logged += [Metric(k, v, now, step) for k, v in values.items() if math.isfinite(v)]
        last = errors[max(errors)]
        for group, error in last.items():
            if math.isfinite(error.rmse) and floor[group].rmse > 0:
                logged.append(Metric(plain(f"{group} over floor"), error.rmse / floor[group].rmse, now, 0))
        logged.append(Metric("effects", len(effects), now, 0))
        client.log_batch(run_id, metrics=logged, params=[Param(plain(k), f"{v:.9g}") for k, v in parameters.items()])
        for file in files:
            client.log_artifact(run_id, str(file))
        client.set_terminated(run_id)
        return run_id
