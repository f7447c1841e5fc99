"""The configuration of one run: frozen, canonical JSON."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from bench.experiment.notation import write
from registry.contracts import Dataset, InitializerEntry, PredictorEntry, places
from registry.core import DATASETS, INITIALIZERS, PREDICTORS, Registry, check_options, option
from registry.errors import BenchError, near


@dataclass(frozen=True)
class Training:
    """How weights are found."""

    updates: int = option(2000, "weight updates, unless early stopping ends the run before", low=1)
    batch: int = option(64, "windows in a batch", low=1, high=100000)
    learning_rate: float = option(5e-3, "Adam's step at the start", low=1e-7, high=1.0, log=True, search=(1e-3, 3e-2))
    final_rate: float = option(0.05, "step at the end, as a fraction of the start (cosine between)", low=0.0, high=1.0)
    weight_decay: float = option(0.0, "decoupled weight decay", low=0.0, high=1.0)
    clip: float = option(1.0, "largest norm of a gradient", low=1e-6)
    alpha: float = option(1.0, "weight α of the prediction cost", low=0.0)
    beta: float = option(1.0, "weight β of the state-initialization cost (neural initializers)", low=0.0)
    evaluate_every: int = option(100, "updates between two validations", low=1)
    patience: int = option(10, "validations without improvement before the run stops early", low=1)
    validation_windows: int = option(512, "validation windows, evenly spread", low=1)
    first_horizon: int = option(
        0, "prediction length at the start of training; 0: the whole one", unit="samples", low=0, high=100000
    )
    stages: int = option(1, "lengths before the whole one, growing by equal factors", low=1, high=100)
    grown_at: float = option(0.5, "fraction of the updates with shorter lengths", low=1e-3, high=1.0)
    validation_horizon: int = option(
        0,
        "longest free run of validation, on recordings whole or in pieces of this length, as a simulation is judged; "
        "untrained weights may then be the best. 0: windows of the horizon's length",
        unit="samples",
        low=0,
    )


@dataclass(frozen=True)
class RunConfig:
    """One run: a predictor and its initializer on one data set, from one seed."""

    predictor: PredictorEntry
    initializer: InitializerEntry | None
    dataset: Dataset
    inputs: tuple[str, ...] = option((), "signals that drive the predictor; empty: the data set's own")
    outputs: tuple[str, ...] = option((), "signals or channels to predict; empty: what the predictor is for")
    context: tuple[str, ...] = option(
        (), "signals that are measured until the prediction starts and set initial states, such as attitude"
    )
    horizon: int = option(40, "prediction length T", unit="samples", low=1, high=100000)
    history: int = option(10, "history τ of predictors without an initializer", unit="samples", low=1, high=10000)
    train_stride: int = option(1, "samples between the starts of training windows", low=1)
    test_stride: int = option(10, "samples between the starts of test windows", low=1)
    train: tuple[str, ...] = option((), "recordings to train on (names or patterns); empty: the data set's split")
    validation: tuple[str, ...] = option((), "recordings for early stopping; empty: the data set's split")
    test: tuple[str, ...] = option((), "recordings to test on; empty: the data set's split")
    simulate: bool = option(
        False, "whether each test recording is also predicted as a whole, from its first samples and the inputs alone"
    )
    training: Training = field(default_factory=Training)
    seed: int = option(0, "seed of weights and batches; the same for all models compared", low=0)

    def __post_init__(self) -> None:
        check_options(self, "run")
        check_options(self.training, "training")

    @property
    def tau(self) -> int:
        """Samples of history that the run reads."""
        return self.initializer.history if self.initializer else self.history

    @property
    def spec(self) -> str:
        """Predictor and initializer in the paper's notation."""
        return write(self.predictor, self.initializer)

    def resolved(self) -> "RunConfig":
        """With the data set's own signals where none are named.

        Raises:
            BenchError: one is named that the data set is known not to have.
        """
        if self.dataset.recorded:
            named = (*self.inputs, *self.outputs, *self.context)
            places(self.dataset.recorded, named, f"The data set {self.dataset.label}")
        inputs, outputs, context = self.predictor.signals(self.dataset)
        return replace(
            self,
            inputs=self.inputs or inputs,
            outputs=self.outputs or outputs,
            context=self.context or self._beside(context, self.outputs or outputs),
        )

    def _beside(self, context: tuple[str, ...], outputs: tuple[str, ...]) -> tuple[str, ...]:
        """What of a predictor's own context is not predicted: the history has that anyway."""
        if not context or not self.dataset.recorded:
            return context
        owner, channels = f"The data set {self.dataset.label}", self.dataset.recorded
        told = set(places(channels, outputs, owner))
        kept: list[str] = []
        for selector in context:
            found = places(channels, [selector], owner)
            left = [channels[i].name for i in found if i not in told]
            kept += [selector] if len(left) == len(found) else left
        return tuple(kept)


_PARTS: dict[str, Registry] = {"predictor": PREDICTORS, "initializer": INITIALIZERS, "dataset": DATASETS}


def to_json(config: RunConfig, defaults: bool = True) -> dict[str, Any]:
    """Plain data. Without ``defaults``, fields at their default are left out, so that new options keep old keys."""

    def plain(item: Any, name: str | None) -> dict[str, Any]:
        out: dict[str, Any] = {} if name is None else {"name": name}
        for f in dataclasses.fields(item):
            value = getattr(item, f.name)
            if f.name in _PARTS:
                out[f.name] = None if value is None else plain(value, _PARTS[f.name].name_of(type(value)))
            elif dataclasses.is_dataclass(value):
                nested = plain(value, None)
                if nested or defaults:
                    out[f.name] = nested
            elif defaults or value != f.default:
                out[f.name] = list(value) if isinstance(value, tuple) else value
        return out

    return plain(config, None)


def from_json(data: Mapping[str, Any]) -> RunConfig:
    """The configuration that `to_json` wrote.

    Raises:
        BenchError: an unknown name or option, or a value of the wrong type.
    """

    def build(kind: type, values: Mapping[str, Any], label: str) -> Any:
        known = {f.name: f for f in dataclasses.fields(kind)}
        given = {}
        if not isinstance(values, Mapping):
            raise BenchError(f"{label} must be options by name, not {values!r:.60}.")
        for key, value in values.items():
            if key not in known:
                raise BenchError(f"{label} has no option {key!r}: {near(key, known)}")
            if isinstance(value, list) and not all(isinstance(item, str) for item in value):
                raise BenchError(f"{label}.{key} must be a list of texts, not {value!r:.60}.")
            given[key] = tuple(value) if isinstance(value, list) else value
        made = kind(**given)
        check_options(made, label)
        return made

    values = dict(data)
    for part, registry in _PARTS.items():
        entry = values.get(part)
        if not isinstance(entry, Mapping | None) or (entry is None and part != "initializer"):
            raise BenchError(f"{part} must be options by name, not {entry!r:.60}.")
        if entry is not None:
            if not isinstance(entry.get("name"), str):
                raise BenchError(f"{part} has no name: known are {', '.join(registry.names())}.")
            options = {k: v for k, v in entry.items() if k != "name"}
            values[part] = build(registry.get(entry["name"]), options, entry["name"])
    values["training"] = build(Training, values.get("training", {}), "training")
    config: RunConfig = build(RunConfig, values, "run")
    return config


class UnknownOption(BenchError):
    """A run has no such option; others may have it."""


def changed(config: RunConfig, assignments: Mapping[str, str]) -> RunConfig:
    """The configuration with options set by path: {"predictor.dropout": "0.1", "horizon": "190"}.

    Raises:
        UnknownOption: no such option.
        BenchError: a value that is not of its type.
    """
    plain = to_json(config)
    for path, text in assignments.items():
        part, _, name = path.rpartition(".")
        holder = plain if not part else plain.get(part)
        if holder is None or not isinstance(holder, dict) or isinstance(holder.get(name), dict | None):
            paths = [k for k, v in plain.items() if not isinstance(v, dict)]
            paths += [f"{k}.{o}" for k, v in plain.items() if isinstance(v, dict) for o in v if o != "name"]
            raise UnknownOption(f"There is no option {path!r}: {near(path, paths)}")
        holder[name] = _typed(text, holder[name], path)
    return from_json(plain)


def build_entry(registry: Registry, name: str, options: Mapping[str, str]) -> Any:
    """An entry of the registry with options given as text.

    Raises:
        BenchError: an unknown name or option, or a value that is not of the option's type.
    """
    kind = registry.get(name)
    fields = {f.name: f for f in dataclasses.fields(kind)}
    values = {}
    for option_name, text in options.items():
        if option_name not in fields:
            raise BenchError(f"{registry.kind} {name} has no option {option_name!r}: {near(option_name, fields)}")
        values[option_name] = _typed(text, fields[option_name].default, f"{registry.kind}.{option_name}")
    made = kind(**values)
    check_options(made, name)
    return made


def _typed(text: str, old: Any, path: str) -> Any:
    """``text`` as a value of the type of ``old``."""
    if isinstance(old, bool):
        if text.lower() not in ("true", "false"):
            raise BenchError(f"{path} = {text!r} must be true or false.")
        return text.lower() == "true"
    if isinstance(old, list):
        return [item.strip() for item in text.split(",") if item.strip()]
    if isinstance(old, int | float):
        try:
            return type(old)(text)
        except ValueError:
            raise BenchError(
                f"{path} = {text!r} must be a{'n integer' if isinstance(old, int) else ' number'}."
            ) from None
    return text
