"""The runs of a study: every configuration on every problem, at every horizon, with paired seeds."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from typing import Any

from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse
from registry.contracts import Dataset


@dataclass(frozen=True)
class Effort:
    """What one horizon is worth in a preset."""

    seeds: int
    training: Training
    test_stride: int = 10
    """Samples between the starts of test windows."""


def effort(seeds: int, updates: int, every: int = 0) -> Effort:
    """``updates`` weight updates, validated about twenty times, or every ``every``."""
    return Effort(seeds, Training(updates=updates, evaluate_every=every or max(1, updates // 20)))


def horizons(preset: str, paper_seeds: int = 3) -> dict[int, Effort]:
    """What the studies of the paper spend on 0.4 s and 1.9 s: prediction length T [samples] → effort."""
    return {
        "smoke": {5: replace(effort(2, 40), test_stride=50)},
        "laptop": {40: effort(3, 2000), 190: effort(3, 1000)},
        "evening": {40: effort(3, 12_000), 190: _growing(effort(3, 8000))},
        "paper": {t: effort(paper_seeds, 30_000) for t in (40, 190)},
    }[preset]


def _growing(spent: Effort) -> Effort:
    """With windows of 20, 42 and 90 steps for the first .85 of the updates, then whole ones: what
    results/published/recipes.md found to get most out of an update."""
    return replace(spent, training=replace(spent.training, first_horizon=20, stages=3, grown_at=0.85))


def grid(
    specs: Sequence[str],
    dataset: Dataset,
    efforts: Mapping[int, Effort],
    problems: Sequence[tuple[str, ...]] = ((),),
) -> list[RunConfig]:
    """One run for each configuration, problem, horizon and seed; what is not trained by gradient runs once.

    Args:
        specs: in the paper's notation.
        dataset: on which.
        efforts: T → seeds, training and test windows.
        problems: the outputs of each problem; () is what the predictor is for.
    """
    made = []
    for horizon, spent in efforts.items():
        for outputs in problems:
            for spec in specs:
                predictor, initializer = parse(spec)
                run = RunConfig(
                    predictor,
                    initializer,
                    dataset,
                    outputs=outputs,
                    horizon=horizon,
                    training=spent.training,
                    test_stride=spent.test_stride,
                )
                count = spent.seeds if predictor.training == "gradient" else 1
                made += [replace(run, seed=seed) for seed in range(count)]
    return made


def attainable(dataset: Dataset) -> tuple[str, ...]:
    """The line that no model is below, where the data were simulated by a model that is known."""
    return ("attainable",) if dataset.truth is not None else ()


def regularized(runs: Sequence[RunConfig]) -> list[RunConfig]:
    """Networks with tiny initial weights, weight decay and dropout, as the paper's large ones had them.

    It gives no numbers (section "MLP vs RNN Initializers"): these are our choice.
    """
    return [
        replace(
            run,
            predictor=_with(run.predictor, weight_scale=0.1, dropout=0.1),
            initializer=_with(run.initializer, weight_scale=0.1),
            training=replace(run.training, weight_decay=0.01),
        )
        if run.predictor.training == "gradient"
        else run
        for run in runs
    ]


def measures_attitude(dataset: Dataset) -> bool:
    """Whether the attitude is among the channels of the data."""
    return any(c.group == "attitude" for c in dataset.channels())


def with_increments(runs: Sequence[RunConfig]) -> list[RunConfig]:
    """Black boxes whose read-out gives changes of the outputs; hybrids, whose physics starts from what was measured, as
    they are."""
    return [replace(run, predictor=_with(run.predictor, increments=True)) for run in runs]


def _with(entry: Any, **options: Any) -> Any:
    """An entry with those of the options that it has."""
    own = {f.name for f in fields(entry)} if entry is not None else set()
    return replace(entry, **chosen) if (chosen := {k: v for k, v in options.items() if k in own}) else entry


def matched(pairs: Sequence[tuple[str, str]], specs: Sequence[str]) -> Iterator[tuple[str, str]]:
    """The pairs of present configurations that the patterns name ("LSTM: * - MLP: *"), each once."""
    seen = set()
    for a, b in pairs:
        for x in specs:
            for y in specs:
                if x != y and fnmatchcase(x, a) and fnmatchcase(y, b) and (x, y) not in seen:
                    seen.add((x, y))
                    yield x, y
