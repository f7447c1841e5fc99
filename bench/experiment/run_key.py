"""What a run's numbers are a function of, as a key that finds its record again."""

import hashlib
import json
from typing import Any

import torch

from bench.experiment.config import RunConfig, to_json
from bench.experiment.device import kernel
from registry.contracts import Split

NUMERICS = 3
"""Raised whenever a change alters the numbers of a run: old records keep their keys, new runs get new ones."""


def environment(config: RunConfig) -> dict[str, Any]:
    """What the bits of a run depend on besides its configuration and data."""
    return {
        "kernel": kernel(config),
        "torch": torch.__version__.partition("+")[0],
        "threads": torch.get_num_threads(),
        "cpu": torch.backends.cpu.get_cpu_capability(),
        "numerics": NUMERICS,
    }


def run_key(config: RunConfig, data_digest: str, split: Split) -> str:
    """SHA-256 over everything a run's numbers are a function of, shortened to 32 hex digits."""
    content = {
        "config": to_json(config.resolved(), defaults=False),
        "data": data_digest,
        "split": [split.train, split.validation, split.test],
        "env": environment(config),
    }
    if files := config.predictor.content():
        content["files"] = files
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


FREE = ("seed", "outputs", "training.learning_rate")
"""Options in which runs that train side by side may differ."""


def shape_key(config: RunConfig) -> str:
    """Runs of one shape key differ only in `FREE`, predict as many signals, and may train side by side."""
    plain = to_json(config.resolved())
    for path in FREE:
        part, _, name = path.rpartition(".")
        (plain[part] if part else plain).pop(name)
    return json.dumps([plain, len(config.outputs)], sort_keys=True)
