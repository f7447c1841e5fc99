"""One group of runs from configuration to records' content: prepare, train, evaluate. Touches no tracker."""

import platform
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from bench.experiment.config import RunConfig, to_json
from bench.experiment.run_key import environment, run_key
from bench.experiment.seeds import derive
from bench.records.record import STEP_COLUMNS, WINDOW_COLUMNS
from bench.training import evaluate
from bench.training.data import WindowedData, prepare
from bench.training.simulate import simulation_errors
from bench.training.split import digest
from bench.training.train import Trained, train


@dataclass(frozen=True)
class Outcome:
    """Everything that `bench.records.record.write` needs of one run."""

    summary: dict[str, Any]
    config: dict[str, Any]
    tables: dict[str, pd.DataFrame]
    weights: Any
    """Tensors by name; on the way between processes the bytes of a safetensors file."""
    provenance: dict[str, Any]


def run_group(
    configs: Sequence[RunConfig],
    progress: Callable[[int], None] = lambda updates: None,
    checkpoint: Path | None = None,
) -> list[Outcome]:
    """Train models of one shape side by side on one thread and judge each on its test part."""
    torch.set_num_threads(1)  # one thread is bit-repeatable, and two processes beat two threads
    started, begun = time.time(), time.monotonic()  # the clock on the wall may be set back meanwhile
    data = [prepare(c) for c in configs]
    trained = train(configs, data, progress, checkpoint)
    share = (time.monotonic() - begun) / len(configs)
    return [_outcome(c, d, t, started, share, begun) for c, d, t in zip(configs, data, trained, strict=True)]


def _outcome(
    config: RunConfig, data: WindowedData, trained: Trained, started: float, train_seconds: float, from_start: float
) -> Outcome:
    begun = time.monotonic()
    config = config.resolved()
    steps, windows = pd.DataFrame(columns=STEP_COLUMNS), pd.DataFrame(columns=WINDOW_COLUMNS)
    metrics: dict[str, float | None] = {}
    channels = tuple(c for c, _ in trained.model.judged())
    if trained.status == "finished":
        torch.manual_seed(derive(config.seed, "test"))  # a random washout start
        measured, predicted = evaluate.predict(trained.model, data, data.test.starts.numpy())
        errors = measured - predicted
        metrics = evaluate.metrics(errors, channels)
        if config.simulate:
            metrics |= simulation_errors(trained.model, config, data.split.test)
        steps = evaluate.per_step(errors, channels, data, data.test.recording)
        windows = evaluate.example_windows(measured, predicted, channels, data)
    summary = {
        "key": run_key(config, digest(config.dataset), data.split),
        "spec": config.spec,
        "status": trained.status,
        "dataset": config.dataset.label,
        "dataset_digest": digest(config.dataset),
        "inputs": [c.name for c in data.input_channels],
        "outputs": [c.name for c in channels],
        "predicted": len(data.output_channels),
        "context": [c.name for c in data.context_channels],
        "units": {c.name: c.unit for c in (*data.input_channels, *channels, *data.context_channels)},
        "rate_hz": data.rate,
        "horizon": config.horizon,
        "history": config.tau,
        "seed": config.seed,
        "weights": trained.model.weight_count(),
        "updates": trained.updates,
        "best_update": trained.best_update,
        "diverged_at": trained.diverged_at,
        "metrics": metrics,
        "windows": {"train": len(data.train), "validation": len(data.validation), "test": len(data.test)},
        "recordings": {p: list(getattr(data.split, p)) for p in ("train", "validation", "test")},
        "environment": environment(config),
    }
    curve = pd.DataFrame(trained.curve, columns=["update", "train_loss", "validation_loss"]).astype(
        {"update": "int64", "train_loss": "float64", "validation_loss": "float64"}
    )
    finished = time.monotonic()
    provenance = {
        "started_ms": int(started * 1000),
        "finished_ms": int((started + finished - from_start) * 1000),
        "seconds": train_seconds + finished - begun,
        "device": "cpu",
        "host": {"machine": platform.machine(), "python": platform.python_version(), "system": platform.system()},
        "versions": {p: version(p) for p in ("multistep-bench", "torch", "numpy", "pandas", "pyarrow")},
        "git": git_commit(),
    }
    weights = {k: v.detach().contiguous().clone() for k, v in trained.model.state_dict().items()}
    return Outcome(summary, to_json(config), {"steps": steps, "curve": curve, "windows": windows}, weights, provenance)


@cache
def git_commit() -> str:
    """The commit of the code that runs, with "+" where it was changed; empty outside a checkout."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():  # an environment within some other repository, whose settings may name programs
        return ""
    try:
        asked = subprocess.run(
            ["git", "describe", "--always", "--dirty=+", "--abbrev=12"], cwd=root, capture_output=True, text=True
        )
    except OSError:
        return ""
    return asked.stdout.strip() if asked.returncode == 0 else ""
