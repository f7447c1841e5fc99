"""What is diagnosed: a physics model and measurements of the same system."""

import dataclasses
import importlib.util
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bench.diagnose.smoothing import Smoothing, stated
from registry.contracts import Dataset, Recording
from registry.core import DATASETS, PHYSICS
from registry.datasets.folder import Folder
from registry.dynamics import PhysicsModel
from registry.errors import BenchError
from registry.stated import refuse_unstated

_TOLD = ("state_channels", "input_signals", "equation")
"""What a physics model says of itself."""
HELD_OUT = 1 / 3
"""Share of the recordings that only test."""


@dataclass(frozen=True, eq=False)
class Log:
    """One recording as the model sees it. Everything float64, SI."""

    name: str
    rate: float
    """[Hz]."""
    states: Tensor
    """(N, s): the model's state channels; 0 where one was not measured."""
    measured: tuple[bool, ...]
    """(s,): whether a state channel was measured, and what it depends on was too."""
    inputs: Tensor
    """(N, m): the driving signal, then the model's extras."""
    valid: Tensor
    """(N,) bool."""
    recording: Recording
    estimated: tuple[bool, ...] = ()
    """(s,): channels that were not measured although all that was measured depends on them."""

    @property
    def dt(self) -> float:
        """Sampling period [s]."""
        return 1 / self.rate

    def __len__(self) -> int:
        return len(self.states)


@dataclass(frozen=True, eq=False)
class Subject:
    """A model and measurements to compare it with."""

    name: str
    model: PhysicsModel
    """With nominal constants."""
    logs: tuple[Log, ...]
    training: tuple[str, ...]
    """Names of the recordings that may be fitted."""
    held_out: tuple[str, ...]
    """Names of the recordings that only test."""
    smoothing: Smoothing | None = None
    """As stated; None: to be estimated."""
    noise: dict[str, float] = field(default_factory=dict)
    """1σ before smoothing, by signal, SI, as stated."""
    uncertainty: dict[str, float] = field(default_factory=dict)
    """Relative 1σ of the model's constants where it differs from the model's own."""
    signals: tuple[str, ...] = ()
    """Signals that were measured in every recording."""
    notes: tuple[str, ...] = ()
    """What was done to the measurements, in sentences."""

    def of(self, names: Sequence[str]) -> tuple[Log, ...]:
        """The logs of these names, in order."""
        by_name = {log.name: log for log in self.logs}
        return tuple(by_name[n] for n in names)

    @property
    def system(self) -> str:
        """Registered name of the model, or its class."""
        return type(self.model).system_name()


def load(source: str | Path | Dataset, system: str | None = None, model: PhysicsModel | None = None) -> Subject:
    """Read measurements and the physics model of their system.

    Args:
        source: a folder with a dataset.toml, the name of a registered data set, or a data set.
        system: a registered physics model, or "path/to/file.py:Class"; default: what the data name.
        model: the model itself, such as one read from a model.toml, in place of the nominal one.

    Raises:
        BenchError: data or model cannot be read, or do not fit each other.
    """
    dataset = source if isinstance(source, Dataset) else _dataset(source)
    constants, processing, uncertainty, drive = _described(dataset)
    kind = physics_class(system or dataset.system)
    nominal, acting = model is None, kind if model is None else type(model)
    if (drive or acting.input_signals) and drive not in acting.input_signals:
        raise BenchError(
            f"{dataset.label} is driven by {drive!r}, which {acting.__name__} does not accept: "
            f"it accepts {', '.join(acting.input_signals) or 'no input'}."
        )
    if nominal:
        refuse_unstated(dataset, kind)
    loaded = dataset.load()
    recordings = loaded.recordings
    signals = set.intersection(*({c.group for c in r.channels} for r in recordings))
    if model is None:
        known = {f.name for f in dataclasses.fields(kind)}
        given = {k: _tuples(v) for k, v in constants.items() if k in known}
        if "drive" in known and drive in kind.input_signals:
            given["drive"] = drive
        extras = ("battery",) if "battery" in signals - {drive} and _columns(recordings[0], "battery") == 1 else ()
        model = kind(**given, input_hold=dataset.input_hold, extras=(*extras, "time"))
    names = [r.name for r in recordings]
    training, held_out = partition(dataset, names)
    from bench.diagnose.differences import centred

    subject = Subject(
        dataset.label,
        model,
        tuple(log_of(r, model, drive) for r in recordings),
        training,
        held_out,
        stated(processing),
        {k: float(v) for k, v in dict(processing.get("noise", {})).items()},
        uncertainty,
        tuple(sorted(signals)),
        _taken(dataset, model) if nominal and isinstance(dataset, Folder) else (),
    )
    return centred(subject)


def partition(dataset: Dataset, names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Recordings to fit and recordings that only test: the published split where there is one.

    Raises:
        BenchError: fewer than two recordings.
    """
    if len(names) < 2:
        raise BenchError(
            f"{dataset.label} holds one recording, and what is learnt from one must be tested on another: "
            "add a recording, or cut this one into several files."
        )
    if not isinstance(dataset, Folder):
        split = dataset.split(names)
        return (*split.train, *split.validation), split.test
    ordered, n = sorted(names), max(1, round(len(names) * HELD_OUT))
    # Spread over the session, so that neither part is all of one kind of flight or of one state of the battery.
    test = {ordered[round((i + 0.5) * len(ordered) / n - 0.5)] for i in range(n)}
    return tuple(x for x in ordered if x not in test), tuple(x for x in ordered if x in test)


def log_of(recording: Recording, model: PhysicsModel, drive: str) -> Log:
    """A recording in the order of the model's states and inputs.

    Raises:
        BenchError: a signal that the model needs was not measured.
    """
    by_name = {c.name: i for i, c in enumerate(recording.channels)}
    columns = np.concatenate([recording.inputs, recording.outputs], axis=1).astype(np.float64)
    picks = [by_name.get(c.name) for c in model.state_channels]
    if all(p is None for p in picks):
        raise BenchError(
            f"Recording {recording.name} holds none of the states of the model: "
            f"{', '.join(dict.fromkeys(c.group for c in model.state_channels))}."
        )
    zeros = np.zeros(len(recording))
    states = np.stack([zeros if p is None else columns[:, p] for p in picks], axis=1)
    driving = recording.pick([drive])[0] if type(model).input_signals else columns[:, :0]
    extras = [
        np.arange(len(recording)) / recording.rate if name == "time" else recording.pick([name])[0][:, 0]
        for name in model.extras
    ]
    inputs = np.concatenate([driving, *(e[:, None] for e in extras)], axis=1)
    if "attitude" in {c.group for c in model.state_channels}:
        at = [i for i, c in enumerate(model.state_channels) if c.group == "attitude"]
        states[:, at] = _continuous(states[:, at])
        if not any(p is not None for p in (picks[i] for i in at)):
            states[:, at[-1]] = 1.0  # level
    measured = tuple(p is not None for p in picks)
    known = self_contained(model, measured)
    return Log(
        recording.name,
        recording.rate,
        torch.from_numpy(states),
        known if any(known) else measured,
        torch.from_numpy(np.ascontiguousarray(inputs, dtype=np.float64)),
        torch.from_numpy(recording.valid.copy()),
        recording,
        () if any(known) else tuple(not m for m in measured),
    )


def self_contained(model: PhysicsModel, measured: Sequence[bool]) -> tuple[bool, ...]:
    """Which measured states (s,) depend on measured ones only, by way of others too: what can be run free."""
    if all(measured):
        return tuple(measured)
    size, generator = len(measured), torch.Generator().manual_seed(0)
    rotors = len(getattr(model, "rotor_positions", ())) or 1
    width = (rotors if model.input_signals else 0) + len(model.extras)
    state = 0.5 + torch.rand(size + model.internal_size, generator=generator, dtype=torch.float64)
    given = torch.full((width,), 0.5, dtype=torch.float64)
    slopes = torch.autograd.functional.jacobian(lambda x: model.derivative(x, given)[:size], state)[:, :size]
    depends, known = (slopes != 0).numpy(), np.array(measured)
    for _ in range(size):
        known &= ~(depends & ~known).any(axis=1)
    return tuple(bool(k) for k in known)


def physics_class(system: str) -> Any:
    """A physics model's class by registered name, or from "path/to/file.py:Class" (which runs that file).

    Raises:
        BenchError: no such model, file or class.
    """
    path, colon, name = system.rpartition(":")
    if not colon or not path.endswith(".py"):
        return PHYSICS.get(system)
    file = Path(path)
    if not file.is_file():
        raise BenchError(f"--system {system}: the file {file} does not exist.")
    module_name = f"_system_{file.stem}"
    spec = importlib.util.spec_from_file_location(module_name, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise BenchError(f"--system {system}: {file} fails with {type(error).__name__}: {error}.") from error
    kind = getattr(module, name, None)
    if not (isinstance(kind, type) and issubclass(kind, PhysicsModel)):
        raise BenchError(f"--system {system}: {file} has no class {name} that derives from PhysicsModel.")
    missing = sorted(kind.__abstractmethods__) + [n for n in _TOLD if not hasattr(kind, n)]
    if missing:
        raise BenchError(f"--system {system}: {name} lacks {', '.join(missing)}.")
    return kind


def registered(source: str) -> bool:
    """Whether ``source`` means a registered data set: a folder of that name goes first if it describes data."""
    return source in DATASETS.names() and not (Path(source) / "dataset.toml").is_file()


def _dataset(source: str | Path) -> Dataset:
    if isinstance(source, str) and registered(source):
        made: Dataset = DATASETS.get(source)()
        return made
    if not Path(source).is_dir():
        raise BenchError(
            f"{source} is neither a folder nor a data set: give a folder with a dataset.toml, "
            f"or one of {', '.join(DATASETS.names())}."
        )
    return Folder(path=str(source))


def _taken(folder: Folder, model: PhysicsModel) -> tuple[str, ...]:
    """What was taken for granted because the description does not state it, in sentences."""
    own = [p for p in model.parameters() if p.source and p.uncertainty > 0 and p.name not in folder.physics]
    said = ", ".join(f"{p.name} = {p.value} {p.unit}".replace("_", " ") for p in own)
    assumed = (f"Not stated, and assumed where an effect looks at it: {said}.",) if said else ()
    return (*folder.description.notes, *assumed)


def _described(dataset: Dataset) -> tuple[dict[str, Any], dict[str, Any], dict[str, float], str]:
    """Nominal constants, processing, uncertainty and the driving signal that a data set states."""
    drive = dataset.inputs[0] if dataset.inputs else ""
    return dict(dataset.physics), dict(dataset.processing), dict(dataset.uncertainty), drive


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, (list, tuple)) else float(value)


def _columns(recording: Recording, signal: str) -> int:
    return sum(c.group == signal for c in recording.channels)


def _continuous(quaternions: np.ndarray) -> np.ndarray:
    """Unit quaternions (N, 4) without jumps between q and −q."""
    flips = np.cumprod(np.where((quaternions[1:] * quaternions[:-1]).sum(1) < 0, -1.0, 1.0))
    out: np.ndarray = quaternions * np.concatenate([[1.0], flips])[:, None]
    return out
