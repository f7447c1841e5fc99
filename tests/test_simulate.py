"""Whole recordings simulated in pieces, against one long run and against a recurrence written out."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch
from conftest import Toy

from bench.execution import engine
from bench.experiment.config import RunConfig, Training, from_json, to_json
from bench.experiment.notation import parse
from bench.experiment.study import Reference
from bench.reporting import simulations
from bench.training.data import prepare
from bench.training.model import build_scaled
from bench.training.simulate import simulated, simulation_errors
from bench.training.split import load
from bench.training.train import train
from registry.datasets.benchmarks.silverbox import OFFICIAL
from registry.errors import BenchError
from studies.nonlinear_benchmarks import references

TAU, T = 10, 6


def config(spec: str) -> RunConfig:
    training = Training(updates=20, evaluate_every=10, batch=16)
    return RunConfig(*parse(spec), Toy(), horizon=T, training=training, simulate=True).resolved()


@pytest.mark.parametrize(
    "spec", ["LSTM: 1x4 - MLP: 4x10", "GRU: 1x4 - Washout: 10", "NARX: 1x4", "LRU: 1x4 - MLP: 4x10", "constant"]
)
def test_pieces_are_one_long_run_of_each_recording_alone(spec: str) -> None:
    run = config(spec)
    model = build_scaled(run, prepare(run)).eval()
    recordings = list(load(run.dataset).recordings)
    errors = simulation_errors(model, run, tuple(r.name for r in recordings))
    for r, (measured, predicted) in zip(recordings, simulated(model, run, recordings), strict=True):
        u, y = (torch.from_numpy(r.pick(s)[0].astype(np.float32))[None] for s in (run.inputs, run.outputs))
        want = model.predict(u[:, :TAU], y[:, :TAU], u[:, TAU:])[0].numpy()
        np.testing.assert_allclose(predicted, want, rtol=2e-4, atol=2e-4)
        np.testing.assert_array_equal(measured, y[0, TAU:].numpy())
        for i, channel in enumerate(model.predictor.problem.outputs):
            rmse = np.sqrt(np.mean((r.pick([channel.name])[0][TAU:, 0] - want[:, i]) ** 2))
            assert errors[f"simulation.{channel.name}@{r.name}"] == pytest.approx(rmse, rel=1e-3)


@pytest.mark.parametrize("spec", ["LSTM: 1x4 - MLP: 4x10", "LRU: 1x4 - MLP: 4x10"])
@pytest.mark.parametrize("longest", [10**6, 25])
def test_validation_by_long_free_runs_is_the_simulation_error(spec: str, longest: int) -> None:
    """The best of the curve is the cost of the kept weights, of runs simulated whole or from piece to piece."""
    run = config(spec)
    run = replace(run, training=replace(run.training, validation_horizon=longest))
    data = prepare(run)
    (trained,) = train([run], [data])
    p, costs = trained.model.predictor, []
    for name in data.split.validation:
        (r,) = (r for r in load(run.dataset).recordings if r.name == name)
        u, y = (torch.from_numpy(r.pick(s)[0].astype(np.float32)) for s in (run.inputs, run.outputs))
        size = min(longest, len(u) - TAU)
        pieces = [slice(k, k + TAU + size) for k in range(0, len(u) - TAU - size + 1, size)]
        u, y = torch.stack([u[s] for s in pieces]), torch.stack([y[s] for s in pieces])
        predicted = trained.model.predict(u[:, :TAU], y[:, :TAU], u[:, TAU:])
        costs.append(float(p.cost(p.output_scaler(predicted), p.output_scaler(y[:, TAU:]))))
    assert min(v for _, _, v in trained.curve) == pytest.approx(np.mean(costs), rel=1e-3)


def test_untrained_weights_stay_where_training_makes_long_runs_worse() -> None:
    run = config("LSTM: 1x4 - MLP: 4x10")
    ruinous = replace(run.training, validation_horizon=10**6, learning_rate=1.0, final_rate=1.0, clip=1e3)
    run = replace(run, training=ruinous)
    fresh = build_scaled(run, prepare(run))
    (trained,) = train([run], [prepare(run)])
    assert trained.status == "finished" and trained.best_update == 0
    for name, weight in fresh.named_parameters():
        torch.testing.assert_close(trained.model.get_parameter(name), weight)


def test_the_linear_baseline_goes_on_from_what_it_predicted() -> None:
    """The history of the next piece is the end of the last one: measured inputs, its own outputs."""
    run = config("linear")
    data = prepare(run)
    model = build_scaled(run, data)
    u_past, y_past, u, y = data.gather(data.train.starts[:500])
    p = model.predictor
    p.fit(p.input_scaler(u_past), p.output_scaler(y_past), p.input_scaler(u), p.output_scaler(y))
    recording = load(run.dataset).recordings[0]
    ((_, predicted),) = simulated(model, run, [recording])
    inputs = recording.pick(run.inputs)[0].astype(np.float32)
    known = recording.pick(run.outputs)[0].astype(np.float32)[:TAU]
    for start in range(TAU, TAU + 3 * T, T):
        past = (torch.from_numpy(x[None, start - TAU : start]) for x in (inputs, known))
        step = model.predict(*past, torch.from_numpy(inputs[None, start : start + T]))[0].numpy()
        np.testing.assert_allclose(predicted[start - TAU : start - TAU + T], step, rtol=1e-4, atol=1e-4)
        known = np.concatenate([known, step])


def test_a_stretch_shorter_than_the_history_is_refused() -> None:
    run = config("constant")
    recording = load(run.dataset).recordings[0]
    gap = recording.valid.copy()
    gap[TAU:] = False
    model = build_scaled(run, prepare(run))
    with pytest.raises(BenchError, match="nothing to simulate"):
        simulated(model, run, [replace(recording, valid=gap)])


def test_records_keep_it_and_runs_without_it_keep_their_keys(tmp_path: Path) -> None:
    run = config("LSTM: 1x4 - MLP: 4x10")
    plain = replace(run, simulate=False)
    assert "simulate" not in to_json(plain, defaults=False) and engine.key_of(plain) != engine.key_of(run)
    assert from_json(to_json(run)) == run
    (record,) = engine.execute(engine.plan([run], tmp_path), tmp_path)
    (without,) = engine.execute(engine.plan([plain], tmp_path), tmp_path)
    more = {k: v for k, v in record.summary["metrics"].items() if k.startswith("simulation.")}
    assert {k: v for k, v in record.summary["metrics"].items() if k not in more} == without.summary["metrics"]
    pd.testing.assert_frame_equal(record.steps, without.steps)
    name = next(iter(more))
    output, _, recording = name.removeprefix("simulation.").partition("@")
    known = Reference("toy", f"{output}@{recording}", "theirs", 1e-6, "a paper")
    other = replace(known, dataset="another", model="elsewhere")
    table = simulations.table([record], [known, other])
    rows = table[(table.recording == recording) & (table.output == output)]
    assert list(rows.model) == ["theirs", record.summary["spec"]] and rows.rmse.is_monotonic_increasing
    assert simulations.lines([without], None) == []


def test_what_only_some_models_predict_is_told_of_these_in_its_own_unit() -> None:
    """Of a helicopter networks predict Euler rates, and physics the velocity and body rates."""

    class Ran(SimpleNamespace):
        __hash__ = object.__hash__  # type: ignore[assignment]

    def ran(spec: str, unit: str, quantity: str, error: float) -> Any:
        metrics = {f"simulation.{quantity}@flight": error}
        summary = {"spec": spec, "units": {quantity: unit}, "metrics": metrics, "weights": 3, "dataset": "twin"}
        return Ran(summary=summary, finished=True, steps=pd.DataFrame({"value": [error]}))

    made = simulations.table(
        [ran("GRU", "rad/s", "euler_rates.roll", 0.1), ran("physics", "m/s", "velocity.x", 2.0)], []
    )
    rows = [(r.output, r.unit, r.model, round(r.rmse, 3)) for r in made.itertuples()]
    assert rows == [("euler_rates.roll", "deg/s", "GRU", 5.73), ("velocity.x", "m/s", "physics", 2.0)]


def test_published_figures_are_of_recordings_that_the_loaders_know() -> None:
    known = {("cascaded_tanks", "level.h@validation"), ("emps", "displacement.q@DATA_EMPS_PULSES")}
    known |= {("silverbox", f"displacement.q@{part}") for part in OFFICIAL if part != "multisine"}
    assert {(r.dataset, r.quantity) for r in references()} == known
    assert all(0 < r.rmse < 3 and len(r.source) > 40 for r in references())
