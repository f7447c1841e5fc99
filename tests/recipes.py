"""What gets most out of an update: `python tests/recipes.py cascade|hybrid|table [--longer] [--write FILE.md]`.

Each row trains one network at T = 190 on `pelican_twin` (full size) for the CPU seconds that today's laptop recipe
takes, with something changed; with --longer the first, the best one and those of `LONGER` are trained four times as
long too. Errors are those of the validation part: nothing is chosen on test recordings. One seed. Rows are kept in the
folder --kept, so that a second call goes on.
"""

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from bench.claims.manifest import entered
from bench.experiment.config import RunConfig, Training, changed
from bench.experiment.grid import horizons
from bench.experiment.notation import parse
from bench.training.data import prepare
from bench.training.model import build_scaled
from bench.training.train import Group, RunState, horizon_at, train
from registry.datasets.twins import PelicanTwin

SPECS = {"cascade": "Cascade: 1x50 - MLP: 100x10", "hybrid": "Hybrid: 1x50 - MLP: 100x10"}
GROWN = {"training.first_horizon": "20", "training.stages": "3", "training.grown_at": "0.6"}
"""20, 42, 90 steps for a fifth of the updates each, then 190."""
GROWN_EARLY = GROWN | {"training.grown_at": "0.4"}
GROWN_LATE = GROWN | {"training.grown_at": "0.85"}
WARM = {"training.first_horizon": "40", "training.stages": "1", "training.grown_at": "0.7"}
SMALL = {"training.batch": "32", "training.learning_rate": "0.01"}
ATTITUDE = {"context": "attitude"}
INCREMENTS = {"predictor.increments": "true"}
INGREDIENTS: dict[str, dict[str, Mapping[str, str]]] = {
    "cascade": {
        "today (laptop)": {},
        "attitude in the history": ATTITUDE,
        "no state cost (β = 0)": {"training.beta": "0"},
        "batches of 32, rate .01": SMALL,
        "horizon grows 20, 42, 90, 190": GROWN,
        "warm start at T = 40": WARM,
        "increments": INCREMENTS,
        "attitude, increments": ATTITUDE | INCREMENTS,
        "attitude, increments, horizon grows": ATTITUDE | INCREMENTS | GROWN,
        "attitude, increments, horizon grows, batches of 32": ATTITUDE | INCREMENTS | GROWN | SMALL,
        "attitude, increments, horizon grows for .85 of the updates": ATTITUDE | INCREMENTS | GROWN_LATE,
    },
    "hybrid": {
        "today (laptop)": {},
        "no state cost (β = 0)": {"training.beta": "0"},
        "batches of 32, rate .01": SMALL,
        "horizon grows 20, 42, 90, 190": GROWN,
        "warm start at T = 40": WARM,
        "horizon grows for .4 of the updates": GROWN_EARLY,
        "horizon grows for .85 of the updates": GROWN_LATE,
        "horizon grows, β = 0": GROWN | {"training.beta": "0"},
        "horizon grows, β = 0, batches of 32": GROWN | SMALL | {"training.beta": "0"},
    },
}
LONGER = {"cascade": (), "hybrid": ("horizon grows 20, 42, 90, 190", "horizon grows for .4 of the updates")}
"""Rows that are trained four times as long beside the first and the best one: when growing ends decides how long whole
windows are seen."""
LOOKS = 20
"""Validations of a training, as the presets have them."""
LONG = ", four times as long"
OF_TODAY = 0.5
"""What was wanted: at most so many times the error of today's recipe, in the same seconds."""
OF_THE_LINE = {"cascade": 4.0, "hybrid": 1.5}
"""And at most so many times what can be had."""


def asked(model: str, changes: Mapping[str, str]) -> RunConfig:
    """A run at T = 190 as the laptop preset has it, but for the changes."""
    predictor, initializer = parse(SPECS[model])
    config = RunConfig(
        predictor, initializer, PelicanTwin(size="full"), outputs=("velocity", "body_rates"), horizon=190,
        training=horizons("laptop")[190].training,
    )  # fmt: skip
    return changed(config, changes)


def price(config: RunConfig) -> dict[int, float]:
    """CPU seconds of an update at each length that its windows have."""
    data = prepare(config)
    found, plain = {}, config.training
    lengths = {horizon_at(plain, u, config.horizon) for u in range(plain.updates)}
    for steps in sorted(lengths):
        short = replace(plain, first_horizon=0 if steps == config.horizon else steps, stages=1, grown_at=1.0)
        group = Group([build_scaled(config, data)], [RunState(replace(config, training=short), data)])
        group.step()
        begun = time.process_time()
        for _ in range(8):
            group.step()
        found[steps] = (time.process_time() - begun) / 8
    return found


def planned(config: RunConfig, budget: float, validation: float) -> Training:
    """As many updates as the CPU seconds allow, `LOOKS` validations among them."""
    costs, o = price(config), config.training
    marks = [horizon_at(o, u, config.horizon) for u in range(o.updates)]
    mean = sum(costs[m] for m in marks) / len(marks)
    updates = max(LOOKS, int((budget - LOOKS * validation) / mean))
    return replace(o, updates=updates, evaluate_every=max(1, updates // LOOKS), patience=10 * LOOKS)


def errors(model: Any, config: RunConfig) -> dict[str, list[float]]:
    """Root mean square over axes and validation windows: at the first step, over the horizon, at the last, SI."""
    data = prepare(config)
    u_history, y_history, u, y = data.gather(data.validation.every(1024).starts)
    e = (model.predict(u_history, y_history, u) - y).double()
    rms = lambda x: float(x.square().sum(-1).mean().sqrt())  # noqa: E731
    return {g: [rms(e[:, :1, c]), rms(e[..., c]), rms(e[:, -1:, c])]
            for g, c in (("velocity", slice(0, 3)), ("body_rates", slice(3, 6)))}  # fmt: skip


def row(model: str, name: str, changes: Mapping[str, str], budget: float | None) -> dict[str, Any]:
    """Train it and measure; without a budget as the preset says."""
    config = asked(model, changes).resolved()
    data = prepare(config)
    if budget is not None:
        with torch.no_grad():
            group = Group([build_scaled(config, data)], [RunState(config, data)])
            begun = time.process_time()
            group._validate(1)
            validation = time.process_time() - begun
        config = replace(config, training=planned(config, budget, validation))
    else:
        config = replace(config, training=replace(config.training, patience=10 * LOOKS))
    begun = time.process_time()
    (trained,) = train([config], [data])
    spent = time.process_time() - begun
    return {"name": name, "seconds": spent, "updates": trained.updates, "status": trained.status,
            "weights": trained.model.weight_count(), "best_update": trained.best_update,
            "curve": trained.curve, "errors": errors(trained.model, config)}  # fmt: skip


def rows(model: str, kept: Path, more: bool) -> list[dict[str, Any]]:
    """All rows of a model, those that were made before read from their files."""
    kept.mkdir(parents=True, exist_ok=True)
    made: list[dict[str, Any]] = []
    for name, changes in INGREDIENTS[model].items():
        made.append(kept_row(kept, model, name, changes, made[0]["seconds"] if made else None))
    if more:
        best = min(made, key=lambda r: total(r, made[0]))["name"]
        for name in dict.fromkeys((made[0]["name"], best, *LONGER[model])):
            longer = f"{name}{LONG}"
            made.append(kept_row(kept, model, longer, INGREDIENTS[model][name], 4 * made[0]["seconds"]))
    return made


def total(of: Mapping[str, Any], beside: Mapping[str, Any]) -> float:
    """Its errors over the whole horizon over another's, geometric mean of velocity and rates."""
    ratios = [of["errors"][g][1] / beside["errors"][g][1] for g in ("velocity", "body_rates")]
    return float((ratios[0] * ratios[1]) ** 0.5)


def kept_row(kept: Path, model: str, name: str, changes: Mapping[str, str], budget: float | None) -> dict[str, Any]:
    """`row`, made once."""
    file = kept / f"{model} - {name}.json"
    if not file.exists():
        file.write_text(json.dumps(row(model, name, changes, budget)))
    found: dict[str, Any] = json.loads(file.read_text())
    v, w = (found["errors"][g] for g in ("velocity", "body_rates"))
    print(f"{model}: {name}: {found['seconds']:.1f} s, {found['updates']} updates, {v} {w}", flush=True)
    return found


def kept_line(kept: Path, model: str) -> dict[str, Any]:
    """The errors of the true simulator from a smoothed start, on the same windows."""
    file = kept / "attainable.json"
    if not file.exists():
        predictor, _ = parse("attainable")
        config = replace(asked(model, {}), predictor=predictor, initializer=None, context=()).resolved()
        line = errors(build_scaled(config, prepare(config)).eval(), config)
        file.write_text(json.dumps({"name": "*attainable*", "seconds": 0.0, "updates": 0, "errors": line}))
    found: dict[str, Any] = json.loads(file.read_text())
    return found


def table(kept: Path) -> str:
    """The tables, as Markdown."""
    lines = [
        "# What gets most out of an update", "",
        "`python tests/recipes.py cascade --longer`, the same with `hybrid`, then `table --write FILE`:",
        "networks of the laptop preset at T = 190 on `pelican_twin`, one seed, each row for the CPU seconds",
        "of the first one, those at the end for four times as many. Errors of the validation part, Euclidean",
        "over axes, root mean square over windows: at the first step, over the whole horizon, at the last",
        "step; in brackets the whole over that of the first row. *attainable* is the simulator itself from a",
        "smoothed start.",
        "",
    ]  # fmt: skip
    by_model = {}
    for model in SPECS:
        found = rows(model, kept, more=False)
        found += [json.loads(file.read_text()) | {"name": file.stem.partition(" - ")[2]}
                  for file in sorted(kept.glob(f"{model} - *{LONG}.json"), reverse=True)]  # fmt: skip
        by_model[model] = found = [*found, kept_line(kept, model)]
        head = ["recipe", "CPU s", "updates", "velocity [m/s]", "body rates [deg/s]"]
        lines += [f"## {SPECS[model]}", "", f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
        for r in found:
            cells = [r["name"], f"{r['seconds']:.0f}", str(r["updates"])] if r["updates"] else [r["name"], "", ""]
            for group, factor in (("velocity", 1.0), ("body_rates", 57.29578)):
                first, whole, last = (factor * x for x in r["errors"][group])
                ratio = r["errors"][group][1] / found[0]["errors"][group][1]
                cells.append(f"{first:.3g}, {whole:.3g}, {last:.3g} ({ratio:.2f})")
            lines.append(f"| {' | '.join(cells)} |")
        lines.append("")
    return "\n".join([*lines, *goals(by_model), ""])


def goals(by_model: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[str]:
    """What was wanted beside the best recipe, and what limits it; the last row of each model is the line."""
    head = ["wanted: at most", "output", "same seconds", "four times the seconds", "what limits"]
    lines = ["## What was wanted, and what limits it", "", f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for title, limits, beside in (
        ("{:.2g} times today's error", dict.fromkeys(by_model, OF_TODAY), 0),
        ("{:.2g} times what can be had", OF_THE_LINE, -1),
    ):
        for model, found in by_model.items():
            line, same = found[-1], [r for r in found[:-1] if not r["name"].endswith(LONG)]
            long = [r for r in found[:-1] if r["name"].endswith(LONG)]
            best = [min(made, key=lambda r: total(r, found[0])) for made in (same, long)]
            for group in ("velocity", "body_rates"):
                least, short, longer, unit = (r["errors"][group][1] for r in (line, *best, found[beside]))
                limit = limits[model]
                cells = [
                    f"{model}: {title.format(limit)}",
                    group.replace("_", " "),
                    f"{short / unit:.2f}",
                    f"{longer / unit:.2f}",
                ]
                lines.append(f"| {' | '.join([*cells, _limits(limit, least / unit, short / unit, longer / unit)])} |")
    return lines


def _limits(limit: float, least: float, short: float, longer: float) -> str:
    """Why an error, in times what it is to be measured by, is above the limit."""
    if least > limit:
        return f"cannot be had: the line itself is {least:.2f}"
    if short <= limit:
        return "reached"
    gained = 100 * (short - longer) / (short - least)
    said = f"training: four times the seconds take away {gained:.0f} % of the distance to the line"
    return said + (", which is enough" if longer <= limit else "")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=(*SPECS, "table"))
    parser.add_argument("--kept", type=Path, default=Path("results/recipes"))
    parser.add_argument("--longer", action="store_true", help="the last two rows too")
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    if given.what != "table":
        rows(given.what, given.kept, given.longer)
    else:
        text = table(given.kept)
        print(text)
        if given.write:
            given.write.write_text(text, encoding="utf-8")
            entered(given.write)
