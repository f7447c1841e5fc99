"""Finished records with made-up numbers, in the layout of `bench.records.record`."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from bench.records import stamp
from bench.records.record import RunRecord, sha256, write


def resealed(folder: Path) -> RunRecord:
    """A record whose files a test has rewritten, its hashes made to fit."""
    summary = json.loads((folder / "record.json").read_text())
    summary["files"] = {name: sha256(folder / name) for name in summary["files"]}
    (folder / "record.json").write_text(stamp.canonical(summary))
    told = stamp.plain(json.loads((folder / "provenance.json").read_text()))
    (folder / "provenance.json").write_text(stamp.canonical(stamp.stamped(told, (folder / "record.json").read_bytes())))
    return RunRecord(folder)


STATISTICS = {"mean": 1.0, "median": 0.9, "q25": 0.5, "q75": 1.4, "q05": 0.1, "q95": 2.2, "q99": 3.0}


def synthetic_record(
    runs: Path,
    spec: str = "LSTM: 1x50 - MLP: 60x10",
    output: str = "body_rates.p",
    seed: int = 0,
    growth: float = 0.5,
    horizon: int = 40,
    diverged: bool = False,
) -> RunRecord:
    """A record whose mean error is ``growth`` · √step [deg/s]; a diverged one turns infinite at its last step."""
    key = hashlib.sha256(f"{spec}{output}{seed}{horizon}".encode()).hexdigest()
    group = output.split(".")[0]
    step = np.arange(1, horizon + 1)
    rows = []
    for quantity, norm in [(group, "paper"), (group, "euclidean"), (output, "axis")]:
        for statistic, factor in STATISTICS.items():
            value = growth * factor * np.sqrt(step)
            if diverged:
                value[-1] = np.inf
            columns = {"quantity": quantity, "norm": norm, "unit": "deg/s", "step": step, "time_s": step / 100}
            rows.append(pd.DataFrame({**columns, "statistic": statistic, "value": value}))
    update = np.arange(100, 1600, 100)
    train_loss = np.exp(-update / 500)
    tables = {
        "steps": pd.concat(rows, ignore_index=True),
        "curve": pd.DataFrame({"update": update, "train_loss": train_loss, "validation_loss": 1.1 * train_loss}),
        "windows": pd.DataFrame({"window": [0], "predicted": [0.0]}),
    }
    summary = {
        "key": key,
        "spec": spec,
        "status": "diverged" if diverged else "finished",
        "dataset": "nanodrone",
        "dataset_digest": hashlib.sha256(b"data").hexdigest(),
        "inputs": ["rotor_speed.1", "rotor_speed.2"],
        "outputs": [output],
        "horizon": horizon,
        "history": 10,
        "seed": seed,
        "diverged_at": 700 if diverged else None,
        "metrics": {"rmsse": None if diverged else growth, f"rmsse.{group}": None if diverged else growth},
        "windows": {"train": 1000, "validation": 100, "test": 100},
    }
    config = {
        "predictor": {"name": spec.split(":")[0], "hidden": 50},
        "outputs": [output],
        "horizon": horizon,
        "training": {"updates": 1500, "learning_rate": 5e-3},
        "seed": seed,
    }
    provenance = {"started_ms": 1_700_000_000_000 + 1000 * seed, "finished_ms": 1_700_000_060_000, "git": "0" * 40}
    return write(runs, summary, config, tables, {"weight": torch.zeros(1000)}, provenance)
