"""Trials of a sweep: configurations trained, and judged on the validation part alone."""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bench.execution.engine import refuse_others, shared
from bench.execution.executor import send_progress
from bench.experiment.config import RunConfig, from_json
from bench.experiment.seeds import derive
from bench.training import evaluate
from bench.training.data import WindowedData, prepare
from bench.training.model import Model
from bench.training.train import Curve, Trained, train
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
    """`bench.training.evaluate.metrics` of the validation part, SI."""
    curve: list[tuple[int, float]] = field(default_factory=list)
    """(update, RMSSE of the free run on the validation windows of early stopping)."""
    problem: str = ""
    """Why it was impossible."""


def scaled_rmsse(errors: np.ndarray, scale: np.ndarray) -> float:
    """√ of the mean of (e / σ)² over windows, steps and outputs: 1 for a predictor as bad as the mean.

    Args:
        errors: (W, T, n) measured − predicted, SI.
        scale: (n,) standard deviations σ of the outputs over the training part, SI.
    """
    return float(np.sqrt(np.square(errors / scale, dtype=np.float64).mean()))


def run(
    configs: Sequence[RunConfig],
    checkpoint: Path | None = None,
    on_validation: Callable[[list[list[tuple[int, float]]]], Iterable[int]] = lambda curves: (),
) -> list[Outcome]:
    """Train side by side and judge each on the validation part; the test part is not looked at.

    Args:
        configs: as `bench.training.train.train` takes them.
        checkpoint: file to go on from; it is the caller's to remove.
        on_validation: called with each one's `Outcome.curve` as it grows; gives those, by place, that need not go on.
    """
    torch.set_num_threads(1)  # one thread is bit-repeatable, and the run key names it
    started = time.monotonic()
    try:
        data = [prepare(c) for c in configs]
    except BenchError as error:
        return [Outcome("impossible", problem=str(error)) for _ in configs]
    outputs = len(data[0].output_channels)

    def seen(curve: Curve) -> list[tuple[int, float]]:
        # The cost is a mean over windows and steps of the sum over outputs of squared scaled errors.
        return [(update, math.sqrt(cost / outputs)) for update, _, cost in curve]

    def validated(curves: list[Curve]) -> Iterable[int]:
        return on_validation([seen(c) for c in curves])

    trained = train(configs, data, checkpoint=checkpoint, on_validation=validated)
    share = (time.monotonic() - started) / len(configs)
    return [_judged(*each, share, seen(each[-1].curve)) for each in zip(configs, data, trained, strict=True)]


def _judged(
    config: RunConfig, data: WindowedData, trained: Trained, seconds: float, curve: list[tuple[int, float]]
) -> Outcome:
    made = Outcome(trained.status, math.nan, trained.model.weight_count(), math.nan, trained.updates)
    made.best_update, made.seconds, made.curve = trained.best_update, seconds, curve
    if trained.status == "finished":
        torch.manual_seed(derive(config.seed, "validation"))  # a random washout start
        errors = validation_errors(trained.model, data)
        made.rmsse = scaled_rmsse(errors, data.output_scale[1].numpy())
        made.metrics = evaluate.metrics(errors, data.output_channels)
        made.latency = latency(trained.model, data)
    return made


def validation_errors(model: Model, data: WindowedData) -> np.ndarray:
    """(W, T, n) measured − predicted on all validation windows, SI."""
    measured, predicted = evaluate.predict(model, data, data.validation.starts.numpy())
    return (measured - predicted)[..., : len(data.output_channels)]


def latency(model: Model, data: WindowedData) -> float:
    """Median time of one prediction of one window [ms]."""
    u_history, y_history, u, _ = data.gather(data.validation.starts[:1])
    times = []
    for _ in range(TIMED):
        begun = time.perf_counter()
        model.predict(u_history, y_history, u)
        times.append(time.perf_counter() - begun)
    return 1000 * float(np.median(times))


def work(
    plain: Sequence[dict[str, Any]], keys: Sequence[str], numbers: Sequence[int], checkpoint: str, stops: str
) -> list[Outcome]:
    """In a worker: run trials, send the driver every validation, end those whose file it has put into ``stops``.

    Where the sweep's folder is not there, as on another machine, trials run to their ends.
    """
    torch.set_num_threads(1)  # the run key names the thread count
    configs = [from_json(p) for p in plain]
    refuse_others(configs, keys)

    def on_validation(curves: list[list[tuple[int, float]]]) -> list[int]:
        for number, curve in zip(numbers, curves, strict=True):
            send_progress((number, curve))
        return [i for i, number in enumerate(numbers) if (Path(stops) / str(number)).exists()]

    return run(configs, shared(checkpoint), on_validation)
