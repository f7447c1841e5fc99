"""What a user wants searched, a configuration or a study with options as text, as a sweep."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from bench.experiment import study
from bench.experiment.config import RunConfig
from bench.experiment.datasets import choose
from bench.experiment.notation import parse
from bench.experiment.request import DEFAULT_DATASET, Options, apply
from bench.experiment.study import Study
from bench.sweep import journal as sweeps
from bench.sweep.space import default_space, parse_search
from registry.contracts import Dataset
from registry.errors import BenchError

LOOKS = 20
"""At the validation part in a trial, where the user sets the updates alone; each is a chance to stop it."""


def request(
    target: str,
    asked: Options,
    searches: Sequence[str] = (),
    objectives: Sequence[str] = (),
    seed: int = 0,
    command: str = "",
) -> sweeps.Sweep:
    """The sweep of a configuration, or of those of a study that are trained.

    Args:
        target: name of a study, or a configuration in the paper's notation.
        asked: data set, preset and options, which are then not searched.
        searches: ranges as text, such as "predictor.hidden=10:200:log".
        objectives: beside the error, "weights" or "latency".
        seed: of the proposals.
        command: that makes it again.

    Raises:
        BenchError: an unknown name or option, or nothing that could be searched.
    """
    found = study.studies().get(target)
    source = asked.dataset or (found.default_dataset if found else DEFAULT_DATASET)
    chosen = source if isinstance(source, Dataset) else choose(source, dict(asked.data or {}))
    run_options = dict(asked.run or {})
    configs = _choices(found, asked.preset, chosen, run_options) if found else [RunConfig(*parse(target), chosen)]
    configs = list({c.spec: c for c in apply(configs, _with_looks(run_options))}.values())
    space = default_space(configs, run_options)
    for text in searches:
        path, values = parse_search(text, configs)
        if path in run_options:
            raise BenchError(f"{path} is given with --set and with --search: leave one of them out.")
        space[path] = values
    words = [f"{k} {v}" for k, v in sorted((run_options | dict(asked.data or {})).items()) if k != "path"]
    words += [f"search {s}" for s in searches]
    wanted = tuple(o for o in sweeps.OBJECTIVES if o == "rmsse" or o in objectives)
    title = f"sweep of {target} on {chosen.label}" + (f" ({asked.preset})" if found else "")
    title += "".join(f", {w}" for w in words) + "".join(f", and {o}" for o in wanted[1:])
    sweep = sweeps.Sweep(title, tuple(configs), space, wanted, seed, command)
    sweep.check()
    return sweep


def _choices(found: Study, preset: str, dataset: Dataset, asked: Mapping[str, str]) -> list[RunConfig]:
    """One run of every configuration of a study that is trained, of one problem and horizon."""
    runs = [c for c in found.runs(preset, dataset) if c.predictor.training == "gradient"]
    if not runs:
        raise BenchError(f"Nothing in {found.name} is trained: choose a configuration.")
    first = runs[0]
    horizon = int(asked["horizon"]) if asked.get("horizon", "").isdecimal() else first.horizon
    nearest = min((c.horizon for c in runs), key=lambda h: abs(h - horizon))
    alike = [c for c in runs if c.horizon == nearest]
    outputs = alike[0].outputs
    return list({c.spec: replace(c, seed=0, outputs=outputs) for c in reversed(alike)}.values())[::-1]


def _with_looks(asked: Mapping[str, str]) -> Mapping[str, str]:
    """With as many validations as usual where only the number of updates is changed."""
    updates = asked.get("training.updates", "")
    if updates.isdecimal() and "training.evaluate_every" not in asked:
        return {**asked, "training.evaluate_every": str(max(1, int(updates) // LOOKS))}
    return asked
