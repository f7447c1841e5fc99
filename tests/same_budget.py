"""Every model trained for the same CPU seconds: `python tests/same_budget.py SECONDS [--write FILE.md]`.

Rows of the study `nonlinear_benchmarks` (preset laptop) train in one thread until a processor time is spent, whatever
their number of updates; of these the one with the least error on the validation part is kept, and whole test recordings
are simulated once, by the benchmark's protocol. Looks at the validation part count, so they are at windows, not at long
free runs. Closed forms take what they take. Below them stand the libraries of `tests/other_libraries.py` that are
installed, trained their own way on the same data.
"""

import argparse
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import torch
from other_libraries import ENOUGH, EVERY, LIBRARIES

from bench.claims.manifest import entered
from bench.experiment.config import RunConfig
from bench.experiment.seeds import derive
from bench.records.record import SIMULATION
from bench.training.data import prepare
from bench.training.simulate import simulation_errors
from bench.training.train import train
from registry.core import DATASETS
from studies.nonlinear_benchmarks import runs

DATA = "silverbox", "cascaded_tanks", "emps"
ROWS = "LSTM", "GRU", "SUBNET", "torch LSTM", "PySINDy", "linear"
"""Predictors, each as the study sets it up."""


def row(config: RunConfig, budget: float) -> tuple[str, float, int, dict[str, float | None]]:
    """Name, CPU seconds of training, updates, and the simulation error of each test recording [SI]."""
    often = {"updates": ENOUGH, "evaluate_every": EVERY, "patience": ENOUGH, "validation_horizon": 0}
    patient = replace(config.training, **often)
    config = replace(config, training=patient).resolved()
    data = prepare(config)
    begun = time.process_time()
    (trained,) = train(
        [config], [data], on_validation=lambda curves: [0] if time.process_time() - begun > budget else []
    )
    spent = time.process_time() - begun
    torch.manual_seed(derive(config.seed, "test"))
    errors = simulation_errors(trained.model, config, data.split.test)
    return config.spec, spent, trained.updates, {k.removeprefix(SIMULATION): e for k, e in errors.items()}


def table(budget: float) -> str:
    """The tables, as Markdown."""
    lines = [
        "# The same CPU seconds for every model",
        "",
        f"`python tests/same_budget.py {budget:g} --write results/published/nonlinear_benchmarks/same_budget.md`",
        "",
    ]
    lines += [
        f"{budget:g} s of one core for training each, one seed, nothing tuned; RMSE of whole test recordings, SI.",
        "deepSI and tsfast train their own way with their own defaults, but for windows of 100 samples and the",
        "benchmark's samples before a simulation (`tests/other_libraries.py`).",
        "",
    ]
    for name in DATA:
        wanted = {}
        for config in runs("laptop", DATASETS.get(name)()):
            wanted.setdefault(config.spec.partition(":")[0], config)
        found = [row(wanted[r], budget) for r in ROWS]
        for library, (module, trained) in LIBRARIES.items():
            if find_spec(module):
                found.append((library, *trained(wanted["LSTM"].resolved(), budget)))
        recordings = list(found[0][3])
        head = ["model", "CPU s", "updates", *recordings]
        lines += [f"## {name}", "", f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
        for spec, spent, updates, errors in found:
            cells = ["–" if errors[r] is None else f"{errors[r]:.3g}" for r in recordings]
            lines.append(f"| {' | '.join([spec, f'{spent:.1f}', str(updates) if updates else '', *cells])} |")
            print(lines[-1], flush=True)
        lines.append("")
    return "\n".join(lines)


if __name__ == "__main__":
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("seconds", type=float)
    asked.add_argument("--write", type=Path)
    given = asked.parse_args()
    torch.set_num_threads(1)
    text = table(given.seconds)
    if given.write:
        given.write.write_text(text, encoding="utf-8")
        entered(given.write)
