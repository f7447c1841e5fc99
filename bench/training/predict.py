"""Use a recorded model on new inputs."""

from pathlib import Path

import numpy as np
import pandas as pd
import torch

from bench.experiment.config import from_json
from bench.records.record import RunRecord
from bench.training.model import Model, build
from registry.contracts import Channel
from registry.datasets.reading import tables
from registry.errors import BenchError


def load_model(record: RunRecord) -> Model:
    """The trained model of a record, ready for `Model.predict` (SI in, SI out).

    Raises:
        BenchError: the run diverged, so there is no model to use.
    """
    if not record.finished:
        raise BenchError(
            f"Run {record.key[:12]} diverged and has no model to use: choose another with `bench runs list`."
        )
    config = from_json(record.config)
    inputs, outputs, context = (
        tuple(Channel(name, record.summary["units"][name]) for name in names) for names in signals(record)
    )
    model = build(config, inputs, outputs, context, record.summary["rate_hz"])
    model.load_state_dict(record.weights())
    return model.eval()


def signals(record: RunRecord) -> tuple[list[str], list[str], list[str]]:
    """Names of the inputs, the predicted outputs and the context of a run."""
    s = record.summary
    return s["inputs"], s["outputs"][: s.get("predicted")], s.get("context", [])


def read_table(path: Path) -> pd.DataFrame:
    """A CSV (also .csv.gz) or Parquet file.

    Raises:
        BenchError: absent, unreadable, or a column stands twice or has no name.
    """
    return tables.read(path, any_ending=True)


def predict_table(record: RunRecord, table: pd.DataFrame, source: str) -> pd.DataFrame:
    """Free run over a table of signals.

    Args:
        record: a finished run.
        table: one row a sample at the run's rate, one column a channel (SI, named as in the record). The first τ
            rows need inputs, measured outputs and context, the others inputs only.
        source: name of the table in error messages.

    Returns:
        time_s (0 at the last history sample), then one column for each predicted channel; one row a predicted step.

    Raises:
        BenchError: a missing column, a missing or non-numeric value, or too few rows.
    """
    summary = record.summary
    tau, (inputs, outputs, context) = summary["history"], signals(record)
    absent = [c for c in (*inputs, *outputs, *context) if c not in table.columns]
    if absent:
        raise BenchError(
            f"{source} has no column {absent[0]!r}; the run needs {', '.join([*inputs, *outputs, *context])}, SI units."
        )
    if len(table) <= tau:
        raise BenchError(f"{source} has {len(table)} rows; {tau} of history and at least one more are needed.")
    u = _numbers(table[inputs], source)
    y = _numbers(table[[*outputs, *context]].iloc[:tau], source)
    predicted = load_model(record).predict(u[None, :tau], y[None], u[None, tau:])[0].numpy()
    times = np.arange(1, len(predicted) + 1) / summary["rate_hz"]
    return pd.DataFrame({"time_s": times, **{c: predicted[:, i] for i, c in enumerate(outputs)}})


def _numbers(table: pd.DataFrame, source: str) -> torch.Tensor:
    for column in table.columns:
        numbers = pd.to_numeric(table[column], errors="coerce")
        bad = np.flatnonzero(~np.isfinite(numbers.to_numpy(dtype=float)))
        if len(bad):
            value = table[column].iloc[bad[0]]
            raise BenchError(f"{source}, column {column!r}, row {bad[0] + 1}: {str(value)!r} is not a number.")
    return torch.tensor(table.to_numpy(dtype=np.float32))
