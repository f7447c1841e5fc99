"""What a user asks for, a study or one configuration with options as text, as the runs that it consists of."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from bench.experiment import study
from bench.experiment.config import RunConfig, UnknownOption, changed
from bench.experiment.datasets import choose
from bench.experiment.notation import parse
from registry.contracts import Dataset
from registry.errors import BenchError, near
from registry.predictors.baselines.physics import digest

BASELINES = ("constant", "linear")
DEFAULT_DATASET = "pelican_twin"
"""Of a configuration; a study has its own."""


@dataclass(frozen=True)
class Request:
    """Runs under one title."""

    title: str
    target: str
    """Name of the study, or the configuration."""
    study: study.Study | None
    configs: list[RunConfig]


@dataclass(frozen=True)
class Options:
    """What is asked beside the study or configuration."""

    dataset: str | Dataset | None = None
    """A name, a folder or a data set; None: the study's own, or `DEFAULT_DATASET`."""
    preset: str = "laptop"
    seeds: int | None = None
    """How many; None: one of a configuration, as many as its preset has of a study."""
    run: Mapping[str, str] | None = None
    """Options of a run by path, such as {"training.updates": "3000", "horizon": "190"}."""
    data: Mapping[str, str] | None = None
    """Options of the data set."""
    physics: str | None = None
    """A model.toml, for what has physics in it."""
    only: tuple[str, ...] = ()
    """Patterns of those of a study's configurations that are wanted; empty: all."""

    @property
    def said(self) -> str:
        """The options as a title says them."""
        said = {**(self.run or {}), **(self.data or {})}
        if self.physics:  # its name alone would make one study of two models
            said["predictor.model"] = self.physics
        if file := said.get("predictor.model"):
            said["predictor.model"] = f"{Path(file).name} {digest(file)[:8]}"
        return ", ".join(f"{k} {v}" for k, v in sorted(said.items()) if k != "path")


def by_owner(
    changes: Mapping[str, Any], horizon: int | None = None, outputs: str | None = None
) -> tuple[dict[str, str], dict[str, str]]:
    """Options of the run and options of the data set as text, from options by path, the horizon and the outputs."""
    of_run = {k: str(v) for k, v in changes.items() if not k.startswith("dataset.")}
    if horizon is not None:
        of_run["horizon"] = str(horizon)
    if outputs is not None:
        of_run["outputs"] = outputs
    return of_run, {k.removeprefix("dataset."): str(v) for k, v in changes.items() if k.startswith("dataset.")}


def request(target: str | study.Study, asked: Options) -> Request:
    """The runs of a study, or of one configuration and of the baselines that it is judged beside.

    Args:
        target: a study or its name, or a configuration in the paper's notation.
        asked: everything else.

    Raises:
        BenchError: an unknown name or option, data that are absent, or an option that nothing here has.
    """
    found = target if isinstance(target, study.Study) else study.studies().get(target)
    target = found.name if isinstance(target, study.Study) and found else str(target)
    source = asked.dataset or (found.default_dataset if found else DEFAULT_DATASET)
    full = found is not None and asked.preset != "smoke"
    chosen = source if isinstance(source, Dataset) else choose(source, dict(asked.data or {}), full)
    run_options = dict(asked.run or {}) | ({"predictor.model": asked.physics} if asked.physics else {})
    if asked.only and found is None:
        raise BenchError(f"{target} is one configuration: --only belongs to a study.")
    configs = _declared(found, asked, chosen) if found else _one(target, chosen, asked.seeds or 1)
    if asked.physics and not any(hasattr(c.predictor, "model") for c in configs):
        raise BenchError(f"{target} has no physics: --physics belongs to `physics` and to hybrids.")
    configs = apply(configs, run_options)
    if found is None:
        configs += apply(_baselines(configs[0]), run_options, strict=False)
    title = f"{target} on {chosen.label}" + (f" ({asked.preset})" if found else "")
    if found and asked.seeds is not None:  # in a folder of its own: a run of fewer must not take its place
        title += f", {asked.seeds} seed{'s' if asked.seeds > 1 else ''}"
    title += f", only {' and '.join(asked.only)}" if asked.only else ""
    return Request(title + (f", {asked.said}" if asked.said else ""), target, found, configs)


def _declared(found: study.Study, asked: Options, dataset: Dataset) -> list[RunConfig]:
    """The runs of a study, each configuration that is trained by gradient with as many seeds as were asked for."""
    if found.presets and asked.preset not in found.presets:
        raise BenchError(f"{found.name} has no preset {asked.preset!r}: {near(asked.preset, found.presets)}")
    configs = _wanted(found.runs(asked.preset, dataset), asked.only)
    if asked.seeds is None:
        return configs
    first = dict.fromkeys(replace(c, seed=0) for c in configs)
    return [
        replace(c, seed=seed) for c in first for seed in range(asked.seeds if c.predictor.training == "gradient" else 1)
    ]


def _wanted(configs: list[RunConfig], only: tuple[str, ...]) -> list[RunConfig]:
    """Those whose configuration matches one of the patterns, and the baselines that they are judged beside."""
    trained = dict.fromkeys(c.spec for c in configs if c.predictor.training == "gradient")
    for pattern in only:
        if not any(fnmatchcase(spec, pattern) for spec in trained):
            raise BenchError(f"The study has no configuration like {pattern!r}: {near(pattern, trained)}")
    wanted = {spec for spec in trained if not only or any(fnmatchcase(spec, pattern) for pattern in only)}
    return [c for c in configs if c.spec in wanted or c.predictor.training != "gradient"]


def _one(spec: str, dataset: Dataset, seeds: int) -> list[RunConfig]:
    """One configuration, as many times as there are seeds."""
    predictor, initializer = parse(spec)
    count = seeds if predictor.training == "gradient" else 1
    return [replace(RunConfig(predictor, initializer, dataset), seed=s) for s in range(count)]


def _baselines(beside: RunConfig) -> list[RunConfig]:
    """The honest baselines, with the history of the run that they are judged beside."""
    b = beside.resolved()
    made = [
        RunConfig(parse(name)[0], None, b.dataset, b.inputs, b.outputs, b.context, history=b.tau) for name in BASELINES
    ]
    return [b for b in made if type(b.predictor) is not type(beside.predictor)]


def apply(configs: list[RunConfig], assignments: Mapping[str, str], strict: bool = True) -> list[RunConfig]:
    """Set options on every run that has them; if ``strict``, one that no run has is an error."""
    for name, value in assignments.items():
        applied, problem, any_fits = [], None, False
        for config in configs:
            try:
                applied.append(changed(config, {name: value}))
                any_fits = True
            except UnknownOption as error:
                applied.append(config)
                problem = problem or error
        if strict and not any_fits and problem:
            raise problem
        configs = applied
    return configs
