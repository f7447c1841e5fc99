"""Read measurements and the physics model of their system, by name, from a folder or from a file of one's own."""

import dataclasses
from collections.abc import Callable, Sequence, Set
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from bench.diagnose.logs.differences import centred
from bench.diagnose.logs.impacts import before_impacts
from bench.diagnose.logs.meant import as_meant
from bench.diagnose.logs.own_system import own_class, where_told
from bench.diagnose.logs.parts import least_stretch, thirds, too_short
from bench.diagnose.logs.sample import shared
from bench.diagnose.logs.slopes import with_missed, with_slopes
from bench.diagnose.logs.smoothing import Smoothing, stated
from bench.diagnose.logs.subject import Subject, drives_of, log_of, named_drive
from bench.diagnose.settings import READING
from bench.experiment.datasets import registered
from registry.contracts import Dataset, Recording
from registry.core import DATASETS, PHYSICS
from registry.datasets.folder.dataset import Folder, in_parts, refuse_unknown
from registry.datasets.folder.signals import known
from registry.dynamics import PhysicsModel
from registry.errors import BenchError, meant, near
from registry.model_file import constants_of, read
from registry.stated import refuse_unstated


def load(source: str | Path | Dataset, system: str | None = None, model: PhysicsModel | None = None) -> Subject:
    """Read measurements and the physics model of their system; short recordings beside long ones are left out.

    Args:
        source: a folder with a dataset.toml, the name of a registered data set, or a data set.
        system: a registered physics model, or "path/to/file.py:Class"; default: what the data name.
        model: the model itself, such as one read from a model.toml, in place of the nominal one.

    Raises:
        BenchError: data or model cannot be read, or do not fit each other.
    """
    dataset = source if isinstance(source, Dataset) else _dataset(source)
    if isinstance(dataset, Folder):
        _refuse_several(dataset)
    if not (system or dataset.system):
        raise BenchError(
            f"{dataset.label} has no physics model to compare with: name one with --system, registered "
            "(`bench list physics`) or of your own, mine.py:Class."
        )
    kind = physics_class(system or dataset.system)
    drive = dataset.inputs[0] if dataset.inputs else ""
    _check_driven(dataset, kind if model is None else type(model), drive)
    nominal = model is None
    if nominal:
        refuse_unstated(dataset, kind)
    constants = _constants(dataset, kind)
    measured = in_parts(dataset.load(), READING.part_of_one) if isinstance(dataset, Folder) else dataset.load()
    recordings = tuple(as_meant(r, kind) for r in measured.recordings)
    signals = set.intersection(*({c.group for c in r.channels} for r in recordings))
    _check_signals(dataset, kind, signals)
    if model is None:
        model = _nominal(dataset, kind, constants, drive, _extras(recordings[0], signals - {drive}))
    training, held_out = partition(dataset, [r.name for r in recordings])
    many = sum(map(len, recordings)) > READING.enough  # most of them are checked only
    smoothing = _smoothing(dataset, min(map(len, recordings)))
    sloped = with_slopes(recordings, model, smoothing)
    longest = max(len(r) / r.rate for r in recordings)
    logs = (with_missed(log_of(r, model, drive, longest), model, sloped.slopes) for r in sloped.recordings)
    subject = Subject(
        name=dataset.label,
        model=model,
        logs=tuple(shared(log) if many else log for log in logs),
        training=training,
        held_out=held_out,
        smoothing=smoothing,
        slopes=sloped.slopes,
        noise=sloped.noise | {k: float(v) for k, v in dict(dataset.processing.get("noise", {})).items()},
        uncertainty=dict(dataset.uncertainty),
        signals=tuple(sorted(signals | {model.state_channels[i].group for i in sloped.slopes})),
        notes=(
            *measured.made,
            *sloped.notes,
            *(_taken(dataset, model) if nominal and isinstance(dataset, Folder) else ()),
        ),
        resampled=measured.made,
        folder=dataset if isinstance(dataset, Folder) else None,
        finer=dataset.finer_signals,
    )
    subject = _warned(before_impacts(centred(_with_commands(subject))))
    return _without_short(subject, lambda rest: load(rest, system, None if nominal else model))


def _with_commands(subject: Subject) -> Subject:
    """The subject with the signal that asked for its drive, where a description states one."""
    return subject if subject.folder is None else replace(subject, commands=subject.folder.description.commands)


def _without_short(subject: Subject, read_again: Callable[[Folder], Subject]) -> Subject:
    """The subject without recordings that are too short to judge a model by, where others suffice, with a note.

    Of a folder the others are parted anew, and one alone is read again, which cuts it in parts.
    """
    least, folder = least_stretch(subject), subject.folder
    short = too_short(subject, least)
    logs = tuple(log for log in subject.logs if log.name not in short)
    if not short or not logs:
        return subject
    training, held_out = (tuple(n for n in part if n not in short) for part in (subject.training, subject.held_out))
    one_file_each = folder is not None and set(short) <= set(folder.names)
    if folder is not None and one_file_each:
        folder = folder.without(short)
        training, held_out = thirds([log.name for log in logs])
    if training and held_out:
        rest = replace(subject, logs=logs, training=training, held_out=held_out, folder=folder)
    elif folder is not None and one_file_each:
        try:
            rest = read_again(folder)
        except BenchError:  # it is too short to be cut
            return subject
    else:
        return subject
    some = "One recording is" if len(short) == 1 else f"{len(short)} recordings are"
    note = (
        f"{some} left out, without the {least * logs[0].dt:.2g} s of valid samples in a row that a free run and the "
        f"filters beside it need: {', '.join(short)}."
    )
    return replace(
        rest,
        left_out=(*short, *rest.left_out),
        notes=(*rest.notes, note),
        resampled=(*rest.resampled, note),
        warned=(*rest.warned, note),
    )


def _warned(subject: Subject) -> Subject:
    """With what recordings of a machine cannot tell among the notes; a vehicle's as they are.

    Raises:
        BenchError: its model gives no finite rate at too many of the samples.
    """
    if subject.model.vehicle:
        return subject
    subject, lacking = where_told(subject)
    warned = (*lacking, *_unmoved(subject))
    notes, told = (*subject.notes, *warned), (*subject.resampled, *warned)
    return replace(subject, warned=warned, notes=notes, resampled=told)


def _unmoved(subject: Subject) -> list[str]:
    """Drives that stand still in all recordings, in sentences."""
    first, out = subject.logs[0], []
    for j in range(drives_of(subject.model, first)):
        values = torch.cat([log.inputs[log.valid, j] for log in subject.logs])
        if len(values) and bool((values == values[0]).all()):
            unit = first.recording.input_channels[j].unit
            out.append(
                f"{named_drive(first, j)} is {float(values[0]) + 0.0:g} {unit} in every sample: what it does, and "
                "whether it does it as the model says, cannot be judged."
            )
    return out


def subject_of(source: str | Path | Dataset | Subject) -> Subject:
    """Measurements with the nominal model of their system, read where a name or a folder is given.

    Raises:
        BenchError: it is none of these, or cannot be read.
    """
    if isinstance(source, Subject):
        return source
    if not isinstance(source, (str, Path, Dataset)):
        raise BenchError(f"Give a folder, the name of a data set or what bench.load reads, not {source!r:.80}.")
    return load(source)


def starting_from(subject: Subject, path: Path) -> PhysicsModel:
    """The model in a model.toml, in place of the nominal one of what was loaded.

    Raises:
        BenchError: it cannot be read, or needs constants that the data do not state.
    """
    model = read(path, type(subject.model))
    if subject.folder is not None:
        refuse_unstated(subject.folder, type(model), str(path))
    # How inputs are given is a matter of the data, not of the file.
    known = {f.name for f in dataclasses.fields(model)}
    given = {n: getattr(subject.model, n) for n in ("extras", "input_hold", "drive") if n in known}
    return replace(model, **given)


def _refuse_several(folder: Folder) -> None:
    """Raise `BenchError` where recordings of several vehicles would be taken for those of one."""
    told = folder.description.vehicle
    if told.column and not folder.only:
        raise BenchError(
            f"{folder.path} holds the vehicles that column {told.column!r} names: `bench diagnose {folder.path}` "
            "takes each by itself; put the recordings of one into a folder of their own for this."
        )


def _check_driven(dataset: Dataset, kind: type[PhysicsModel], drive: str) -> None:
    """Raise `BenchError` where a model does not accept the signal that drives the recordings."""
    if (drive or kind.input_signals) and drive not in kind.input_signals:
        raise BenchError(
            f"{dataset.label} is driven by {drive!r}, which {kind.__name__} does not accept: "
            f"it accepts {', '.join(kind.input_signals) or 'no input'}."
        )


def _check_signals(dataset: Dataset, kind: type[PhysicsModel], signals: Set[str]) -> None:
    """Raise `BenchError` where what acts beside a drive was not measured, or the name of a signal is misspelt."""
    own = {*kind.signals, *(c.group for c in kind.state_channels)}
    for name in sorted(signals - own):
        if other := meant(name, own - signals):
            raise BenchError(f"{dataset.label} has a signal {name!r}, which {kind.__name__} has not: {other} is meant?")
    if lacking := [name for name in kind.disturbances if name not in signals]:
        raise BenchError(
            f"{dataset.label} has no {' and no '.join(lacking)}, which acts on {kind.__name__} beside what drives it: "
            "add it to [signals], or leave it out of the class's disturbances."
        )


def _constants(dataset: Dataset, kind: type[PhysicsModel]) -> dict[str, Any]:
    """Nominal constants by name, as the data state them."""
    constants = dict(dataset.physics)
    if isinstance(dataset, Folder) and not dataset.system:  # nobody has checked them yet
        parameters, where = kind().parameters(), f"{dataset.described} [physics"
        known(dataset.uncertainty, [p.name for p in parameters], f"{where}.uncertainty]")
        return constants_of(f"{where}]", parameters, constants)
    return constants


def _nominal(
    dataset: Dataset, kind: type[PhysicsModel], constants: dict[str, Any], drive: str, extras: Sequence[str]
) -> PhysicsModel:
    """The model with nominal constants, driven as the recordings are."""
    known = {f.name for f in dataclasses.fields(kind)}
    given = {k: _tuples(v) for k, v in constants.items() if k in known}
    if "drive" in known and drive in kind.input_signals:
        given["drive"] = drive
    return kind(**given, input_hold=dataset.input_hold, extras=(*extras, "time"))


def _extras(recording: Recording, signals: Set[str]) -> tuple[str, ...]:
    """Signals of one column that effects look at, beside the driving one."""
    return ("battery",) if "battery" in signals and _columns(recording, "battery") == 1 else ()


def _smoothing(dataset: Dataset, shortest: int) -> Smoothing | None:
    """The filter that the data are said to have gone through; None: it is to be estimated.

    Raises:
        BenchError: it is longer than the ``shortest`` recording [samples].
    """
    smoothing = stated(dataset.processing)
    if smoothing is not None and smoothing.window > shortest:
        raise BenchError(
            f"{dataset.label}: [processing] smoothing over {smoothing.window} samples is longer than a recording of "
            f"{shortest}: give the window of the filter that the data went through."
        )
    return smoothing


def excluding(subject: Subject, names: Sequence[str]) -> Subject:
    """A subject without some of its recordings.

    Raises:
        BenchError: no recording has such a name, or too few are left to fit and to test.
    """
    refuse_unknown(names, [*(log.name for log in subject.logs), *subject.left_out])
    names = [n for n in names if n not in subject.left_out]
    if not names:
        return subject
    training, held_out = (tuple(n for n in part if n not in names) for part in (subject.training, subject.held_out))
    if not training or not held_out:
        raise BenchError(
            f"--exclude {', '.join(names)} leaves nothing to {'test on' if training else 'learn from'}: "
            f"{', '.join(training or held_out) or 'none'} would be all."
        )
    logs, folder = tuple(log for log in subject.logs if log.name not in names), subject.folder
    if folder is not None and set(names) <= set(folder.names):  # or they are parts of the only file
        folder = folder.without(names)
    return replace(subject, logs=logs, training=training, held_out=held_out, folder=folder)


def partition(dataset: Dataset, names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Recordings to fit and recordings that only test: the published split where there is one.

    Raises:
        BenchError: there is one recording, too short to be cut.
    """
    if len(names) < 2 or not isinstance(dataset, Folder):
        split = dataset.split(names)  # of a folder it says why there is none
        if len(names) < 2:
            raise BenchError(f"{dataset.label} holds one recording, and what is learnt must be tested on another.")
        return (*split.train, *split.validation), split.test
    return thirds(names)


def physics_class(system: str) -> Any:
    """A physics model's class by registered name, or from "path/to/file.py:Class" (which runs that file).

    Raises:
        BenchError: no such model, file or class, or a class that cannot be used.
    """
    path, colon, _ = system.rpartition(":")
    return own_class(system) if colon and path.endswith(".py") else PHYSICS.get(system)


def _dataset(source: str | Path) -> Dataset:
    if isinstance(source, str) and registered(source):
        made: Dataset = DATASETS.get(source)()
        return made
    if not Path(source).is_dir():
        raise BenchError(
            f"{source} is neither a folder with a dataset.toml nor a data set: {near(str(source), DATASETS.names())}"
        )
    return Folder(path=str(source))


def _taken(folder: Folder, model: PhysicsModel) -> tuple[str, ...]:
    """What was taken for granted because the description does not state it, in sentences."""
    own = [p for p in model.parameters() if p.source and p.uncertainty > 0 and p.name not in folder.physics]
    said = ", ".join(f"{p.name} = {p.value} {p.unit}".replace("_", " ") for p in own)
    assumed = (f"Not stated, and assumed where an effect looks at it: {said}.",) if said else ()
    return (*folder.description.notes, *assumed)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, (list, tuple)) else float(value)


def _columns(recording: Recording, signal: str) -> int:
    return sum(c.group == signal for c in recording.channels)
