"""The benchmarks of nonlinear system identification: every model's simulation of whole test recordings."""

import dataclasses
import tomllib
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from bench.experiment.config import RunConfig
from bench.experiment.grid import effort, grid
from bench.experiment.study import Reference, Study
from registry.contracts import Dataset
from registry.predictors.baselines.physics import Physics
from registry.predictors.hybrid import Hybrid

SIZES = {"smoke": (8, 4, 8), "laptop": (32, 8, 32), "paper": (64, 16, 64)}
"""Width of networks, of convolutions, and of what initializes them."""
WINDOW = 100
"""Prediction length T [samples] that networks are trained on; on the test recordings they run on."""
SLOW = ("TCN", "Neural ODE", "Hybrid")
"""An update of theirs takes some ten times as long as one of the others: they get a third of the updates."""
VALIDATION = 1000
"""Longest free run [samples] by which the best weights are chosen: windows tell nothing of drift."""
HISTORY = 10
"""Samples that a simulation starts from where the data set is no benchmark with a rule of its own."""


def runs(preset: str, dataset: Dataset) -> list[RunConfig]:
    """Every black box, baselines, and what others would take (PySINDy where it is installed).

    A data set with a physics model has that, and hybrids around it.
    """
    if any(f.name == "official" for f in dataclasses.fields(dataset)):  # type: ignore[arg-type]
        benchmark: Any = dataset
        dataset = replace(benchmark, official=True)
    tau, (width, narrow, start) = dataset.initial_window or HISTORY, SIZES[preset]
    mlp = f"MLP: {start}x{tau}"
    specs = [f"{name}: 1x{width} - {mlp}" for name in ("LSTM", "LSTM TDL", "GRU", "MLFC", "Neural ODE")]
    specs += [f"LRU: 2x{width} - {mlp}", f"SUBNET: 2x{width} - Encoder: {start}x{tau}"]
    specs += [f"NARX: 1x{width}", f"TCN: 3x{narrow}", f"torch LSTM: 1x{width} - Washout: {tau}", "linear", "constant"]
    specs += ["PySINDy"] if find_spec("pysindy") else []
    if dataset.system:
        specs += [f"Hybrid residual: 1x{narrow} - {mlp}", "physics"]
    seeds, updates = {"smoke": (2, 40), "laptop": (1, 1000), "paper": (3, 20_000)}[preset]
    made: list[RunConfig] = []
    for spec in specs:
        given = updates // 3 if spec.startswith(SLOW) else updates
        spent = effort(seeds, given, every=given // 10)
        training = replace(spent.training, batch=32, beta=0.0, validation_horizon=VALIDATION)
        spent = replace(spent, test_stride=50, training=training)
        made += grid((spec,), dataset, {5 if preset == "smoke" else WINDOW: spent})
    return [_as_judged(run, tau) for run in made]


def _as_judged(run: RunConfig, tau: int) -> RunConfig:
    """With the benchmark's history, which physics uses to seek the states that nobody measured."""
    predictor = replace(run.predictor, start="sought") if isinstance(run.predictor, Physics | Hybrid) else run.predictor
    return replace(run, predictor=predictor, history=tau, simulate=True)


def references() -> tuple[Reference, ...]:
    """What others published, from the file beside this one."""
    said = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    return tuple(
        Reference(
            block["dataset"], f"{block['channel']}@{recording}", row["model"], rmse, said["sources"][row["source"]]
        )
        for block in said["published"]
        for row in block["rows"]
        for recording, rmse in zip(block["recordings"], row["rmse"], strict=True)
    )


STUDY = Study(
    name="nonlinear_benchmarks",
    title="benchmarks of nonlinear system identification: simulation of whole test recordings",
    question=(
        "Silverbox, Cascaded Tanks and EMPS by the protocol of nonlinearbenchmark.org: from the first samples of a "
        "test recording and its inputs a model simulates all the rest. How far are recurrent networks, state-space "
        "models and physics from what others published?"
    ),
    source="not in the paper: nonlinearbenchmark.org and the package nonlinear_benchmarks",
    default_dataset="cascaded_tanks",
    runs=runs,
    pairs=(("SUBNET: *", "LSTM: *"), ("LRU: *", "LSTM: *"), ("Neural ODE: *", "SUBNET: *")),
    references=references,
    presets={
        "smoke": "tiny networks, 40 updates, T = 5: seconds, for tests",
        "laptop": "width 32, 1,000 updates of 32 windows of 100 samples, one seed: a quarter of an hour on a core",
        "paper": "width 64, 20,000 updates, three seeds: hours on two cores; not in the paper",
    },
)
