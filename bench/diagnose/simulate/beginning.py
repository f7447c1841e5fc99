"""The first moments of a recording, in which a lag or a delay remembers what was given before it began.

Where the input was steady until then nothing is lost. A log that begins in the middle of a manoeuvre begins with a
memory that nobody recorded: its first time constants are neither learnt from nor tested on.
"""

from dataclasses import replace

import torch

from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Log, LogBatch, Subject, drives_of
from bench.diagnose.regression.driving import acting
from bench.diagnose.settings import MATTERING, READING
from bench.diagnose.simulate.teacher_forced import equations, increments
from registry.dynamics import PhysicsModel


def after_beginning(subject: Subject, model: PhysicsModel, noise: Noise) -> Subject:
    """The subject without what its recordings begin with, where ``model``, which remembers it, errs more there.

    Args:
        subject: measurements whose inputs are read when they act.
        model: with the lags and delays found.
        noise: of the measurements.
    """
    count = min(remembered(model, subject.logs[0]), min(map(len, subject.logs)) // READING.beginning)
    if count < 1 or not _errs(subject, model, noise, count):
        return subject
    note = (
        f"The first {count / subject.logs[0].rate:.2g} s of each recording are not judged: what acts there follows "
        "from inputs before it began, and they were not steady."
    )
    logs = tuple(without_beginning(log, count) for log in subject.logs)
    return replace(subject, logs=logs, notes=(*subject.notes, note))


def remembered(model: PhysicsModel, log: Log) -> int:
    """Samples for which what acts follows from inputs before a log began, to a hundredth of what differed then."""
    drives = drives_of(model, log)
    if not model.input_effects():
        return 0
    other = log.inputs.clone()
    other[0, :drives] += log.inputs[:, :drives].std(0)
    gap = (acting(model, replace(log, inputs=other)) - acting(model, log)).abs()
    late = torch.nonzero((gap > READING.faded * (other[0] - log.inputs[0])).any(-1))
    return int(late[-1]) if len(late) else 0


def without_beginning(log: Log, count: int) -> Log:
    """The log with its first samples marked as not valid."""
    return replace(log, valid=log.valid & (torch.arange(len(log)) >= count))


def _errs(subject: Subject, model: PhysicsModel, noise: Noise, count: int) -> bool:
    """Whether an equation errs far more over the first samples of the training recordings than later."""
    logs = LogBatch.of(subject.of(subject.training))
    errors, _, first = increments(model, logs, noise).over(count, 1)
    begins = first <= noise.half_width
    for equation in equations(model, logs.measured):
        squared = (errors[:, list(equation.group.at)] ** 2).sum(1)
        early, late = squared[begins], squared[~begins]
        if len(early) and len(late) and early.mean() > MATTERING.lost**2 * late.mean():
            return True
    return False
