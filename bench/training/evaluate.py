"""Errors of every prediction step on the test part, in the norms of the paper."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
import torch

from bench.training.data import WindowedData
from bench.training.model import Model
from registry.contracts import Channel
from registry.units import display

CHUNK = 1024
"""Windows predicted at once."""
QUANTILES = {"median": 0.5, "q05": 0.05, "q25": 0.25, "q75": 0.75, "q95": 0.95, "q99": 0.99}


def predict(model: Model, data: WindowedData, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Measured and predicted outputs (W, T, n') of the windows at ``starts``, SI, in the order of `Model.judged`."""
    measured, predicted = [], []
    columns = [i for _, i in model.judged()]
    for chunk in torch.as_tensor(starts).split(CHUNK):
        u_history, y_history, u, y = data.gather(chunk)
        predicted.append(model.judge(u_history, y_history, u, y).numpy())
        measured.append(y[..., columns].numpy())
    return np.concatenate(measured), np.concatenate(predicted)


def groups(channels: tuple[Channel, ...]) -> dict[str, list[int]]:
    """Columns of each predicted signal."""
    found: dict[str, list[int]] = {}
    for i, channel in enumerate(channels):
        found.setdefault(channel.group, []).append(i)
    return found


def rmsse(errors: np.ndarray) -> float:
    """√(1/(T n_G) Σ_i Σ_k eᵀe) over all T prediction steps of (W, T, n) errors, SI.

    The paper's sum starts at τ+1 but divides by T_pred; all T steps are our reading.
    """
    return float(np.sqrt(np.square(errors, dtype=np.float64).sum(-1).mean()))


def metrics(errors: np.ndarray, channels: tuple[Channel, ...]) -> dict[str, float | None]:
    """RMSSE of every predicted signal and axis, SI; None where it is not finite."""
    out = {}
    for group, columns in groups(channels).items():
        if len(columns) > 1:
            out[f"rmsse.{group}"] = rmsse(errors[..., columns])
        for i in columns:
            out[f"rmsse.{channels[i].name}"] = rmsse(errors[..., i : i + 1])
    return {name: value if np.isfinite(value) else None for name, value in out.items()}


def norms(errors: np.ndarray, channels: tuple[Channel, ...]) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """(quantity, norm, unit, |e| (W, T) in that unit) of every signal and axis.

    "paper" is the mean of the axes' absolute errors (section "Evaluation Metrics"), "euclidean" their 2-norm,
    both only where all three axes of a signal are predicted; "axis" is the absolute error of one channel.
    """
    for group, columns in groups(channels).items():
        unit, factor = display(channels[columns[0]].unit, group)
        e = np.abs(errors[..., columns]) * factor
        if len(columns) == 3:
            yield group, "paper", unit, e.mean(-1)
            yield group, "euclidean", unit, np.sqrt(np.square(e).sum(-1))
        for j, i in enumerate(columns):
            yield channels[i].name, "axis", unit, e[..., j]


def per_step(
    errors: np.ndarray, channels: tuple[Channel, ...], data: WindowedData, recording: np.ndarray
) -> pd.DataFrame:
    """Long table of the error distribution at every step.

    Args:
        errors: (W, T, n') measured − predicted, SI.
        channels: the n' that were predicted.
        data: for rate and names.
        recording: (W,) index of each window's recording; "mean@NAME" rows hold the mean within one recording.

    Returns:
        quantity, norm, unit, step (1 .. T), time_s, statistic, value.
    """
    steps = np.arange(1, errors.shape[1] + 1)
    rows = []
    for quantity, norm, unit, e in norms(errors, channels):
        values = {"mean": e.mean(0, dtype=np.float64)}
        values |= dict(zip(QUANTILES, np.quantile(e, list(QUANTILES.values()), axis=0), strict=True))
        for i in np.unique(recording):
            values[f"mean@{data.names[i]}"] = e[recording == i].mean(0, dtype=np.float64)
        rows += [(quantity, norm, unit, statistic, value) for statistic, value in values.items()]
    quantities, norm_names, units, statistics, curves = zip(*rows, strict=True)
    return pd.DataFrame(
        {
            "quantity": np.repeat(quantities, len(steps)),
            "norm": np.repeat(norm_names, len(steps)),
            "unit": np.repeat(units, len(steps)),
            "step": np.tile(steps, len(rows)),
            "time_s": np.tile(steps / data.rate, len(rows)),
            "statistic": np.repeat(statistics, len(steps)),
            "value": np.concatenate(curves),
        }
    )


def example_windows(
    measured: np.ndarray, predicted: np.ndarray, channels: tuple[Channel, ...], data: WindowedData, count: int = 6
) -> pd.DataFrame:
    """Measured and predicted outputs of a few windows: evenly spread over the ranking by error, best to worst.

    Returns:
        window, recording, step, time_s, channel, unit (SI), measured, predicted.
    """
    size = np.square(measured - predicted, dtype=np.float64).mean((1, 2))
    order = np.argsort(np.nan_to_num(size, nan=np.inf), kind="stable")
    picks = order[np.unique(np.linspace(0, len(order) - 1, count).round().astype(int))]
    steps, names = np.arange(1, measured.shape[1] + 1), [c.name for c in channels]
    parts = len(picks) * len(channels)  # curves, window by window
    return pd.DataFrame(
        {
            "window": np.repeat(picks, len(channels) * len(steps)),
            "recording": np.repeat([data.names[i] for i in data.test.recording[picks]], len(channels) * len(steps)),
            "step": np.tile(steps, parts),
            "time_s": np.tile(steps / data.rate, parts),
            "channel": np.tile(np.repeat(names, len(steps)), len(picks)),
            "unit": np.tile(np.repeat([c.unit for c in channels], len(steps)), len(picks)),
            "measured": measured[picks].swapaxes(1, 2).ravel(),
            "predicted": predicted[picks].swapaxes(1, 2).ravel(),
        }
    )
