"""One trial of a sweep: a configuration trained, and judged on the validation part alone."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bench import evaluate
from bench.config import RunConfig, from_json
from bench.data import Prepared, prepare
from bench.engine import refuse_others, shared
from bench.executor import tell
from bench.model import Model
from bench.seeds import derive
from bench.train import Curve, train
from registry.errors import BenchError

TIMED = 25
"""Predictions of one window of which the median time is the latency."""


@dataclass
class Outcome:
    """What came of a trial."""

    status: str
    """"finished", "pruned", "diverged" or "impossible" (the configuration does not fit the data)."""
    rmsse: float = math.nan
    """Of the validation part, all outputs: see `scaled_rmsse`."""
    weights: int = 0
    latency: float = math.nan
    """Milliseconds that one prediction of one window takes on one thread."""
    updates: int = 0
    best_update: int = 0
    seconds: float = 0.0
    metrics: dict[str, float | None] = field(default_factory=dict)
    """`bench.evaluate.metrics` of the validation part, SI."""
    curve: list[tuple[int, float]] = field(default_factory=list)
    """(update, RMSSE of the free run on the validation windows of early stopping)."""
    problem: str = ""
    """Why it was impossible."""


class Pruned(Exception):
    """The driver has seen enough of this trial."""


def scaled_rmsse(errors: np.ndarray, scale: np.ndarray) -> float:
    """√ of the mean of (e / σ)² over windows, steps and outputs: 1 for a predictor as bad as the mean.

    Args:
        errors: (W, T, n) measured − predicted, SI.
        scale: (n,) standard deviations σ of the outputs over the training part, SI.
    """
    return float(np.sqrt(np.square(errors / scale, dtype=np.float64).mean()))


def run(
    config: RunConfig,
    checkpoint: Path | None = None,
    looked: Callable[[list[tuple[int, float]]], None] = lambda curve: None,
) -> Outcome:
    """Train and judge on the validation part; the test part is not looked at.

    Args:
        config: of the run.
        checkpoint: file to go on from; it is the caller's to remove.
        looked: called with `Outcome.curve` as it grows; it may raise `Pruned`.
    """
    torch.set_num_threads(1)  # one thread is bit-repeatable, and the run key names it
    started = time.monotonic()
    try:
        data = prepare(config)
    except BenchError as error:
        return Outcome("impossible", problem=str(error))
    outputs = len(data.output_channels)
    seen: list[tuple[int, float]] = []

    def look(curves: list[Curve]) -> None:
        # The cost is a mean over windows and steps of the sum over outputs of squared scaled errors.
        seen[:] = [(update, math.sqrt(cost / outputs)) for update, _, cost in curves[0]]
        looked(seen)

    try:
        (trained,) = train([config], [data], checkpoint=checkpoint, looked=look)
    except Pruned:
        return Outcome("pruned", updates=seen[-1][0], curve=seen, seconds=time.monotonic() - started)
    spent = time.monotonic() - started
    made = Outcome(trained.status, math.nan, trained.model.weight_count(), math.nan, trained.updates)
    made.best_update, made.seconds, made.curve = trained.best_update, spent, seen
    if trained.status == "finished":
        torch.manual_seed(derive(config.seed, "validation"))  # a random washout start
        errors = validation_errors(trained.model, data)
        made.rmsse = scaled_rmsse(errors, data.output_scale[1].numpy())
        made.metrics = evaluate.metrics(errors, data.output_channels)
        made.latency = latency(trained.model, data)
    return made


def validation_errors(model: Model, data: Prepared) -> np.ndarray:
    """(W, T, n) measured − predicted on all validation windows, SI."""
    measured, predicted = evaluate.predict(model, data, data.validation.starts.numpy())
    return (measured - predicted)[..., : len(data.output_channels)]


def latency(model: Model, data: Prepared) -> float:
    """Median time of one prediction of one window [ms]."""
    u_history, y_history, u, _ = data.gather(data.validation.starts[:1])
    times = []
    for _ in range(TIMED):
        begun = time.perf_counter()
        model.predict(u_history, y_history, u)
        times.append(time.perf_counter() - begun)
    return 1000 * float(np.median(times))


def work(plain: dict[str, Any], key: str, number: int, checkpoint: str, stop: str) -> Outcome:
    """In a worker: run a trial, tell the driver about every look, end when the driver has put the file ``stop``.

    Where the sweep's folder is not there, as on another machine, a trial runs to its end.
    """
    torch.set_num_threads(1)  # the run key names the thread count
    config = from_json(plain)
    refuse_others([config], [key])

    def looked(curve: Sequence[tuple[int, float]]) -> None:
        tell((number, list(curve)))
        if Path(stop).exists():
            raise Pruned

    return run(config, shared(checkpoint), looked)
