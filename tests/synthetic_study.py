"""Records of a study with known effects, written as runs write them."""

import hashlib
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from bench.record import RunRecord, write

MLP, WASHOUT = "LSTM: 1x50 - MLP: 60x10", "LSTM: 1x50 - Washout: 10"
SPECS = ("MLFC: 1x50 - MLP: 60x10", "MLFC: 1x50 - Washout: 10", MLP, WASHOUT)
PAIRS = ((SPECS[0], SPECS[1]), (MLP, WASHOUT))
RATE = 100.0


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
        curves = level(spec, step) * np.exp(shared + noise)[:, None]
        values = {"mean": curves.mean(0)} | {f"mean@{n}": c for n, c in zip(names, curves, strict=True)}
        for name, factor in dict(median=0.8, q05=0.08, q25=0.4, q75=1.4, q95=2.5, q99=3.5).items():
            values[name] = factor * curves.mean(0)
        for statistic, value in values.items():
            columns = {"quantity": output, "norm": "axis", "unit": "deg/s", "step": step, "time_s": step / RATE}
            steps.append(pd.DataFrame({**columns, "statistic": statistic, "value": value}))
    if len(outputs) == 3 and steps:
        paper = (
            pd.concat(steps).groupby(["norm", "unit", "step", "time_s", "statistic"], as_index=False)["value"].mean()
        )
        steps.append(paper.assign(quantity=outputs[0].partition(".")[0], norm="paper"))
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
        "weights": 12345,
        "rate_hz": RATE,
        "metrics": {
            f"rmsse.{q}": float(np.deg2rad(1.3 * rows[rows.statistic == "mean"].value.mean()))
            for q, rows in table.groupby("quantity")
        },
        "recordings": {"test": names},
    }
    tables = {"steps": table, "curve": pd.DataFrame({"update": [1]}), "windows": pd.DataFrame({"window": [0]})}
    return write(runs, summary, {}, tables, {"w": torch.zeros(1)}, {})


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
