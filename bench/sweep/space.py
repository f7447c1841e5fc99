"""What a sweep varies: options of a run, each with a range or choices. The registry entries' fields are the default."""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import Field
from typing import Any

from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution

from bench.experiment.config import RunConfig, changed
from registry.errors import BenchError

Space = dict[str, BaseDistribution]
"""Option path, as in ``--set``, or `SPEC` → what it may be."""
SPEC = "spec"
"""The parameter that chooses one of several configurations."""
PARTS = ("predictor", "initializer", "training")
"""What may be varied, and the history τ; anything else would change what is measured."""
KEPT = ("training.validation_windows", "training.evaluate_every")
"""What would change when and on what a trial is looked at."""


def default_space(configs: Sequence[RunConfig], fixed: Iterable[str] = ()) -> Space:
    """The choice between several configurations, or the options of one; and the training options of both.

    A range is widened until it holds the value that a configuration has already.

    Args:
        configs: the default first.
        fixed: options that keep their value.
    """
    space: Space = {}
    if len(configs) > 1:
        space[SPEC] = CategoricalDistribution([c.spec for c in configs])
    for path, field, value in options(configs[0]):
        search = field.metadata.get("search")
        varied = len(configs) == 1 or path.startswith("training.")
        if search and varied and path not in fixed:
            if search is True:
                space[path] = CategoricalDistribution(field.metadata["choices"] or (False, True))
            else:
                low, high = search
                space[path] = _range(field, min(low, value), max(high, value), field.metadata["log"])
    return space


def options(config: RunConfig) -> Iterator[tuple[str, Field[Any], Any]]:
    """Path, field and value of every option that may be varied."""
    for part in PARTS:
        entry = getattr(config, part)
        if entry is None or (part == "training" and config.predictor.training != "gradient"):
            continue
        for field in dataclasses.fields(entry):
            path, value = f"{part}.{field.name}", getattr(entry, field.name)
            if isinstance(value, int | float | str) and path not in KEPT:
                yield path, field, value
    if config.initializer is None:
        yield "history", next(f for f in dataclasses.fields(config) if f.name == "history"), config.history


def _range(field: Field[Any], low: float, high: float, log: bool) -> BaseDistribution:
    if isinstance(field.default, int):
        return IntDistribution(int(low), int(high), log=log)
    return FloatDistribution(float(low), float(high), log=log)


def parse_search(text: str, configs: Sequence[RunConfig]) -> tuple[str, BaseDistribution]:
    """ "predictor.hidden=10:200:log", "predictor.layers=1:3" or "training.batch=32,64" as an option and its values.

    Raises:
        BenchError: no such option, one that must not be varied, or values that it cannot have.
    """
    example = "write OPTION=LOW:HIGH, OPTION=LOW:HIGH:log or OPTION=A,B,C, such as predictor.hidden=10:200:log"
    path, equals, values = (part.strip() for part in text.partition("="))
    if not equals or not values:
        raise BenchError(f"--search {text!r} is not understood: {example}.")
    config = configs[0]
    known = {name: (field, value) for name, field, value in options(config)}
    bounds = values.split(":")
    ends = [v.strip() for v in (values.split(",") if len(bounds) == 1 else bounds[:2])]
    for each in configs:
        for end in ends:  # says which option is unknown, or which value it cannot have
            changed(each, {path: end})
    if path not in known:
        raise BenchError(f"--search {path} would change what is measured: choose from {', '.join(sorted(known))}.")
    field, value = known[path]
    if len(bounds) == 1:
        return path, CategoricalDistribution([_typed(v, value) for v in dict.fromkeys(ends)])
    if isinstance(value, bool | str) or bounds[2:] not in ([], ["log"]):
        raise BenchError(f"--search {text!r} is not understood: {example}.")
    low, high = (float(v) for v in ends)
    log = bounds[2:] == ["log"] or (bool(field.metadata.get("log")) and low > 0)
    if not low < high or (log and low <= 0):
        raise BenchError(f"--search {text!r}: give the smaller value first" + (", above 0." if log else "."))
    return path, _range(field, low, high, log)


def _typed(text: str, old: Any) -> Any:
    if isinstance(old, bool):
        return text.lower() == "true"
    return type(old)(text)


def default_params(space: Space, configs: Sequence[RunConfig]) -> dict[str, Any] | None:
    """The parameters that give the first configuration as it is; None where they are outside the space."""
    have = {path: value for path, _, value in options(configs[0])} | {SPEC: configs[0].spec}
    inside = all(_holds(distribution, have[path]) for path, distribution in space.items())
    return {path: have[path] for path in space} if inside else None


def _holds(distribution: BaseDistribution, value: Any) -> bool:
    if isinstance(distribution, CategoricalDistribution):
        return value in distribution.choices
    assert isinstance(distribution, IntDistribution | FloatDistribution)
    return bool(distribution.low <= value <= distribution.high)


def configured(configs: Sequence[RunConfig], params: Mapping[str, Any]) -> RunConfig:
    """The configuration that parameters stand for.

    Raises:
        BenchError: options that do not go together.
    """
    by_spec = {c.spec: c for c in configs}
    base = by_spec[params[SPEC]] if SPEC in params else configs[0]
    return changed(base, {path: str(value) for path, value in params.items() if path != SPEC})


def described(path: str, distribution: BaseDistribution) -> str:
    """Such as "predictor.hidden 10 to 100 (log)"."""
    if isinstance(distribution, CategoricalDistribution):
        return f"{path} {' | '.join(map(str, distribution.choices))}"
    assert isinstance(distribution, IntDistribution | FloatDistribution)
    return f"{path} {distribution.low:g} to {distribution.high:g}{' (log)' if distribution.log else ''}"
