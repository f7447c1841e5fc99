"""Records of a study with known effects, written as runs write them."""

import hashlib
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from bench.records.record import RunRecord, write

MLP, WASHOUT = "LSTM: 1x50 - MLP: 60x10", "LSTM: 1x50 - Washout: 10"
SPECS = ("MLFC: 1x50 - MLP: 60x10", "MLFC: 1x50 - Washout: 10", MLP, WASHOUT)
PAIRS = ((SPECS[0], SPECS[1]), (MLP, WASHOUT))
RATE = 100.0
VIEWS = {"velocity_forced": 0.1, "body_rates_uncompensated": 3.0}
"""Views of a predictor, and their errors as multiples of those of the free run."""


def level(spec: str, step: np.ndarray) -> np.ndarray:
    """Mean error [deg/s]: washout twice as large at first (LSTM), decaying within .1 s to the MLP's own error."""
    if spec == "constant":
        return 40 + 300 * (1 - np.exp(-step / 30))
    if spec == "linear":
        return 18 + 10 * (1 - np.exp(-step / 15))
    own = 8 + 8 * (1 - np.exp(-step / 12)) + (3 if spec.startswith("MLFC") else 0)
    return own * (1 + (1.0 if "Washout" in spec else 0.0) * np.exp(-(((step - 1) / 8) ** 2)))


def record(
    runs: Path,
    spec: str,
    outputs: tuple[str, ...],
    horizon: int,
    seed: int,
    recordings: int = 10,
    diverged: bool = False,
    weights: int = 12345,
) -> RunRecord:
    """One run: log-normal spread over recordings (shared by all specs), seeds and both."""
    step = np.arange(1, horizon + 1)
    names = [f"flight{i}" for i in range(recordings)]
    steps = []
    for output in () if diverged else outputs:
        code = [ord(c) for c in output]
        shared = np.random.default_rng([1, *code]).normal(0, 0.3, recordings)
        rng = np.random.default_rng([2, seed, horizon, *code, *(ord(c) for c in spec)])
        noise = rng.normal(0, 0.03, recordings) + rng.normal(0, 0.03)
        curves = VIEWS.get(output.partition(".")[0], 1.0) * level(spec, step) * np.exp(shared + noise)[:, None]
        values = {"mean": curves.mean(0)} | {f"mean@{n}": c for n, c in zip(names, curves, strict=True)}
        for name, factor in dict(median=0.8, q05=0.08, q25=0.4, q75=1.4, q95=2.5, q99=3.5).items():
            values[name] = factor * curves.mean(0)
        for statistic, value in values.items():
            columns = {"quantity": output, "norm": "axis", "unit": "deg/s", "step": step, "time_s": step / RATE}
            steps.append(pd.DataFrame({**columns, "statistic": statistic, "value": value}))
    for group in dict.fromkeys(o.partition(".")[0] for o in outputs) if steps else ():
        axes = [t for t in steps if t.quantity.iloc[0].startswith(f"{group}.")]
        if len({t.quantity.iloc[0] for t in axes}) == 3:
            columns = ["norm", "unit", "step", "time_s", "statistic"]
            paper = pd.concat(axes).groupby(columns, as_index=False)["value"].mean()
            steps.append(paper.assign(quantity=group, norm="paper"))
    table = pd.concat(steps) if steps else pd.DataFrame(columns=["quantity", "norm", "unit", "statistic", "value"])
    summary = {
        "key": hashlib.sha256(repr((spec, outputs, horizon, seed)).encode()).hexdigest()[:32],
        "spec": spec,
        "status": "diverged" if diverged else "finished",
        "dataset": "twin",
        "dataset_digest": "0" * 64,
        "inputs": ["pilot.aileron"],
        "outputs": list(outputs),
        "units": {name: "rad/s" for name in outputs},
        "horizon": horizon,
        "history": 10,
        "seed": seed,
        "weights": weights,
        "updates": 100,
        "best_update": None if diverged else 80,
        "diverged_at": 100 if diverged else None,
        "windows": {"train": 900, "validation": 60, "test": 10 * recordings},
        "environment": {"kernel": "pytorch", "threads": 1},
        "rate_hz": RATE,
        "metrics": {
            f"rmsse.{q}": float(np.deg2rad(1.3 * rows[rows.statistic == "mean"].value.mean()))
            for q, rows in table.groupby("quantity")
        },
        "recordings": {"train": ["flight90", "flight91"], "test": names},
    }
    update = np.arange(20, 101, 20)
    loss = np.exp(-update / 60) + 0.1 * (1 + seed)
    tables = {
        "steps": table,
        "curve": pd.DataFrame({"update": update, "train_loss": 0.9 * loss, "validation_loss": loss}),
        "windows": example_windows(spec, () if diverged else outputs, step, seed),
    }
    provenance = {
        "started_ms": 1_700_000_000_000,
        "seconds": 12.5,
        "git": "0123456789ab",
        "host": {"machine": "x86_64", "system": "Linux"},
        "versions": {"torch": "2.13.0"},
    }
    return write(runs, summary, {}, tables, {"w": torch.zeros(1)}, provenance)


def example_windows(spec: str, outputs: tuple[str, ...], step: np.ndarray, seed: int) -> pd.DataFrame:
    """Two windows: measured a sine [rad/s], predicted off by an error that grows, ten times as fast in the second."""
    measured = np.sin(2 * np.pi * step / 40)
    columns = ["window", "recording", "step", "time_s", "channel", "unit", "measured", "predicted"]
    made = [pd.DataFrame(columns=columns)]
    for window, growth in ((7, 0.001), (3, 0.01)):
        for i, channel in enumerate(outputs):
            predicted = measured + growth * (1 + i) * (1 + seed) * step * (2 if "Washout" in spec else 1)
            values = (window, f"flight{window}", step, step / RATE, channel, "rad/s", measured, predicted)
            made.append(pd.DataFrame(dict(zip(columns, values, strict=True))))
    return pd.concat(made[1:] or made, ignore_index=True)


def study(
    runs: Path,
    horizons: dict[int, int],
    axes: str = "pqr",
    lost: tuple[tuple[str, int], ...] = (),
    recordings: int = 10,
) -> list[RunRecord]:
    """Horizon → seeds; ``lost`` (spec, seed) diverge on axis p."""
    return [
        record(runs, spec, (f"body_rates.{axis}",), horizon, seed, recordings, axis == "p" and (spec, seed) in lost)
        for horizon, seeds in horizons.items()
        for axis in axes
        for spec in (*SPECS, "constant", "linear")
        for seed in range(seeds if ":" in spec else 1)
    ]
