"""Every model trained for the same CPU seconds: `python tests/same_budget.py SECONDS [--write FILE.md]`.

Rows of the study `nonlinear_benchmarks` (preset laptop) train in one thread until a processor time is spent, whatever
their number of updates; of these the one with the least error on the validation part is kept, and whole test recordings
are simulated once, by the benchmark's protocol. Closed forms take what they take.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import torch

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
EVERY = 25
"""Updates between two looks at the clock and at the validation part, which count."""
ENOUGH = 10_000_000
"""Updates that no budget allows."""


def row(config: RunConfig, budget: float) -> tuple[str, float, int, dict[str, float | None]]:
    """Name, CPU seconds of training, updates, and the simulation error of each test recording [SI]."""
    patient = replace(config.training, updates=ENOUGH, evaluate_every=EVERY, patience=ENOUGH)
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
        "",
    ]
    for name in DATA:
        wanted = {}
        for config in runs("laptop", DATASETS.get(name)()):
            wanted.setdefault(config.spec.partition(":")[0], config)
        found = [row(wanted[r], budget) for r in ROWS]
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
