"""Metrics against the paper's formulas, written out as loops."""

import math

import numpy as np
import pytest
from conftest import Toy

from bench.experiment.config import RunConfig
from bench.experiment.notation import parse
from bench.training import evaluate
from bench.training.data import prepare
from registry.contracts import Channel

DATA = prepare(RunConfig(*parse("LSTM: 1x5 - MLP: 6x10"), Toy(), horizon=4))
CHANNELS = (*(Channel(f"body_rates.{a}", "rad/s") for a in "pqr"), Channel("velocity.x", "m/s"))
WINDOWS, STEPS = 37, 4
ERRORS = np.random.default_rng(0).normal(size=(WINDOWS, STEPS, 4))
RECORDING = np.arange(WINDOWS) % 3
DEG = 180 / math.pi


def value(quantity: str, norm: str, step: int, statistic: str) -> float:
    t = evaluate.per_step(ERRORS, CHANNELS, DATA, RECORDING)
    row = t[(t.quantity == quantity) & (t.norm == norm) & (t.step == step) & (t.statistic == statistic)]
    assert len(row) == 1
    return float(row["value"].iloc[0])


def test_rmsse_is_the_papers_sum() -> None:
    found = evaluate.metrics(ERRORS, CHANNELS)
    total = alone = 0.0
    for window in ERRORS:
        for e in window:
            total += float(e[:3] @ e[:3])
            alone += float(e[1] ** 2)
    assert found["rmsse.body_rates"] == pytest.approx(math.sqrt(total / (STEPS * WINDOWS)), rel=1e-12)
    assert found["rmsse.body_rates.q"] == pytest.approx(math.sqrt(alone / (STEPS * WINDOWS)), rel=1e-12)
    assert set(found) == {"rmsse.body_rates", *(f"rmsse.{c.name}" for c in CHANNELS)}


def test_norms_are_the_papers_in_its_units() -> None:
    paper = [sum(abs(x) for x in ERRORS[w, 2, :3]) / 3 * DEG for w in range(WINDOWS)]
    euclidean = [math.sqrt(sum(x * x for x in ERRORS[w, 2, :3])) * DEG for w in range(WINDOWS)]
    assert value("body_rates", "paper", 3, "mean") == pytest.approx(sum(paper) / WINDOWS)
    assert value("body_rates", "euclidean", 3, "mean") == pytest.approx(sum(euclidean) / WINDOWS)
    assert value("velocity.x", "axis", 1, "mean") == pytest.approx(np.abs(ERRORS[:, 0, 3]).mean())
    units = evaluate.per_step(ERRORS, CHANNELS, DATA, RECORDING).groupby("quantity")["unit"].unique()
    assert list(units["body_rates"]) == ["deg/s"] and list(units["velocity.x"]) == ["m/s"]


def test_quantiles_and_recordings_are_taken_from_the_windows() -> None:
    ranked = sorted(abs(x) for x in ERRORS[:, 1, 3])
    assert value("velocity.x", "axis", 2, "median") == pytest.approx(ranked[18])
    for statistic, share in (("q05", 0.05), ("q25", 0.25), ("q75", 0.75), ("q95", 0.95), ("q99", 0.99)):
        low, part = divmod(share * (WINDOWS - 1), 1)
        between = ranked[int(low)] * (1 - part) + ranked[int(low) + 1] * part
        assert value("velocity.x", "axis", 2, statistic) == pytest.approx(between)
    for i in range(3):
        own = [abs(ERRORS[w, 1, 3]) for w in range(WINDOWS) if w % 3 == i]
        assert value("velocity.x", "axis", 2, f"mean@{DATA.names[i]}") == pytest.approx(sum(own) / len(own))


def test_time_counts_from_k0() -> None:
    t = evaluate.per_step(ERRORS, CHANNELS, DATA, RECORDING)
    assert sorted(set(t.step)) == [1, 2, 3, 4]
    np.testing.assert_allclose(t.time_s, t.step / 100)


def test_examples_run_from_the_best_window_to_the_worst() -> None:
    measured = np.zeros((len(DATA.test), STEPS, 4), dtype=np.float32)
    predicted = np.random.default_rng(1).normal(size=measured.shape).astype(np.float32)
    size = [float((p.astype(float) ** 2).sum()) for p in predicted]
    shown = evaluate.example_windows(measured, predicted, CHANNELS, DATA)
    order = list(dict.fromkeys(shown.window))
    assert order[0] == int(np.argmin(size)) and order[-1] == int(np.argmax(size)) and len(order) == 6
    row = shown[(shown.window == order[2]) & (shown.channel == "body_rates.r") & (shown.step == 2)]
    assert float(row.predicted.iloc[0]) == predicted[order[2], 1, 2]
