"""When a measured input acts: the shift between its clock and that of the motion, estimated before any effect is.

Between two samples an input does not move in a straight line (a motor follows held commands along an exponential),
a log files it late, a filter delays the states. To first order all of these are one thing: the input acts as it is read
a fraction of a sample earlier or later. A term that follows the input's rate fits them all, so the shift is settled
first: in the weak form, beside the model's constants and every effect of the catalogue, with the noise of the
inputs taken off. Inputs are then read at the shifted times by all that follows.
"""

from collections.abc import Callable
from dataclasses import replace

import torch

from bench.diagnose.logs.noise import Noise, noise_of
from bench.diagnose.logs.parts import in_parts, least_stretch, too_short
from bench.diagnose.logs.rate_timing import pose_read_later, rates_in_time
from bench.diagnose.logs.subject import Subject, drives_of
from bench.diagnose.regression.parameters import entries
from bench.diagnose.select.step import remembers, without
from bench.diagnose.select.timing.commanded import as_commanded
from bench.diagnose.select.timing.disturbances import disturbances_read
from bench.diagnose.select.timing.estimate import shifts_of
from bench.diagnose.select.timing.regression import is_held, read_at, reading_weights
from bench.diagnose.select.timing.sentences import force_said, input_said, motion_said, sensor_said
from bench.diagnose.settings import TIMING
from bench.diagnose.simulate.unmeasured import hidden
from registry.dynamics import PhysicsModel


def prepared(
    subject: Subject, noise: Noise | None = None, tick: Callable[[str], None] = lambda what: None
) -> tuple[Subject, Noise]:
    """The subject with its inputs read when they act, with a note that says so, and the noise of it; once only.

    A measured drive is read with its commands first, where the description names them (`timing.commanded`).
    Rates are read when they were what they say (`logs.rate_timing`), position and velocity of a vehicle when its
    attitude tilts the forces. Disturbances hold between samples where they are seen to (`timing.disturbances`). No
    input is shifted where some state is not measured, or where no shift can be told.
    Commands act when they are given, or later, which a lag or a delay says; earlier by a fraction of a sample where all
    else is filed late, as by a simulator that files the state before a step beside the rate after half of it.

    Args:
        subject: model and measurements.
        noise: default `noise_of`.
        tick: called with what is being done.
    """
    noise = noise or noise_of(subject)
    if subject.timed:
        return subject, noise
    subject = in_parts(subject)
    known = as_commanded(subject)
    if known.logs is not subject.logs:
        noise = noise_of(known)
    subject = known
    filed = subject.logs
    subject = rates_in_time(replace(subject, timed=True))
    if not _tells_time(subject):
        return subject, noise
    if subject.model.disturbances:
        subject = disturbances_read(subject, noise)
    tick("input timing")
    inputs, sensed, moving, forced = shifts_of(subject, noise)
    logs, notes = subject.logs, list(subject.notes)
    reading: tuple[float, ...] = (1.0,)
    if abs(inputs.value) >= TIMING.negligible:
        drives, held = drives_of(subject.model, subject.logs[0]), is_held(subject)
        logs = tuple(replace(log, inputs=read_at(log.inputs, drives, inputs.value, held)) for log in logs)
        reading = reading_weights(inputs.value, held)[1]
        notes.append(input_said(subject, inputs))
    if abs(sensed.value) >= TIMING.negligible:
        paths = (log.sensed for log in logs)
        read = [None if path is None else read_at(path, path.shape[1], sensed.value) for path in paths]
        logs = tuple(replace(log, sensed=path) for log, path in zip(logs, read, strict=True))
        notes.append(sensor_said(subject, sensed))
    if abs(moving.value) >= TIMING.negligible:
        # The forces are read when they act by moving all that they move and the attitude that tilts them together.
        logs = pose_read_later(subject.model, logs, moving.value - forced.value, -forced.value)
        notes.append(motion_said(subject, moving))
        if forced.value:
            notes.append(force_said(subject, forced))
    if logs is subject.logs:
        return subject, noise
    subject = replace(subject, logs=logs, notes=tuple(notes))
    # What is read between its samples is smoother than what was measured, but slow noise is in it as before.
    measured = noise_of(replace(subject, logs=filed))
    return subject, replace(measured, input_reading=reading)


def retimed(filed: Subject, model: PhysicsModel, noise: Noise) -> Subject:
    """Measurements whose inputs are as filed, with these read when they act beside all that ``model`` has."""
    read, _ = prepared(replace(filed, model=model), noise)
    return replace(read, model=replace(filed.model, held_extras=read.model.held_extras))


def reread(filed: Subject, read: Subject, model: PhysicsModel, noise: Noise) -> Subject | None:
    """Measurements read anew, where inputs act at another time than they are ``read`` beside all that ``model`` has.

    None: they act then. A command is never read later than it was given, so that one which was read too early shows no
    other way than in a lag that was found and undoes that: it is read anew beside what was found without lags.

    Args:
        filed: with inputs as they were filed.
        read: with inputs as they are read.
        model: what was found.
        noise: of these.
    """
    if not is_held(filed):
        beside = replace(read, model=model)
        late = _tells_time(beside) and abs(shifts_of(beside, noise)[0].value) >= TIMING.negligible
        return retimed(filed, model, noise) if late else None
    if _alike(filed, read):
        return None
    lags = [i for i, e in enumerate(model.effects) if remembers(e, filed.logs[0].dt)]
    again = retimed(filed, without(model, lags), noise)
    return None if _alike(again, read) else again


def _alike(one: Subject, other: Subject) -> bool:
    """Whether the same inputs act at the same times."""
    return len(one.logs) == len(other.logs) and all(
        torch.equal(a.inputs, b.inputs) for a, b in zip(one.logs, other.logs, strict=True)
    )


def _tells_time(subject: Subject) -> bool:
    """Whether recordings could tell when their inputs act, and it is for the clock to say."""
    known, drives = entries(subject.model, subject.uncertainty), drives_of(subject.model, subject.logs[0])
    enough = set(subject.training) - set(too_short(subject, least_stretch(subject)))
    return bool(known and drives and enough) and not hidden(subject.logs)
