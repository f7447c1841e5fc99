"""Which measurements are learnt from and which only test: whole recordings, or parts of few long ones.

A recording in which no free run fits can do neither.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.settings import READING, RUNNING
from registry.datasets.reading.cleaning import runs
from registry.errors import BenchError


def thirds(names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Those to learn from, and every third by name, at least one, to test on.

    Spread over the session, so that neither is all of one kind of flight or of one state of the battery.
    """
    ordered, n = sorted(names), max(1, round(len(names) * READING.held_out))
    test = {ordered[round((i + 0.5) * len(ordered) / n - 0.5)] for i in range(n)}
    return tuple(x for x in ordered if x not in test), tuple(x for x in ordered if x in test)


def run_steps(log: Log) -> int:
    """Samples of the default horizon of free runs, where all states are measured."""
    return max(RUNNING.fewest, round(RUNNING.longest * log.pace))


def stretch(log: Log) -> int:
    """Samples of the longest stretch of valid ones."""
    return max((end - first for first, end in runs(log.valid.numpy())), default=0)


def least_stretch(subject: Subject) -> int:
    """Valid samples in a row that a recording needs: a free run, and what the filters beside it reach.

    0 where states are estimated: free runs are as long as recordings allow then.
    """
    if any(subject.logs[0].estimated):
        return 0
    steps = run_steps(subject.logs[0])
    if all(stretch(log) > 3 * steps for log in subject.logs):
        return steps + 1  # no filter reaches farther than a free run, and its noise need not be estimated
    return steps + 1 + 2 * noise_of(subject).half_width


def too_short(subject: Subject, least: int) -> list[str]:
    """Names of the recordings without so many valid samples in a row."""
    return [log.name for log in subject.logs if stretch(log) < least]


def refuse_short(subject: Subject) -> None:
    """Raise before the work where no recording to learn from, or none to test on, is long enough for a free run.

    Raises:
        BenchError: with the longest stretch of valid samples that there is, and what is needed.
    """
    least = least_stretch(subject)
    short, dt = too_short(subject, least), subject.logs[0].dt
    for names, what in ((subject.training, "learn from"), (subject.held_out, "test on")):
        if names and set(names) <= set(short):
            longest = max(map(stretch, subject.of(names))) * dt
            raise BenchError(
                f"The longest stretch of valid samples in the recordings to {what} is {longest:.2g} s, and a free run "
                f"of {run_steps(subject.logs[0]) * dt:.2g} s, with what filters reach beside it, needs at "
                f"least {least * dt:.2g} s: record longer."
            )


def in_parts(subject: Subject) -> Subject:
    """The subject with each long recording cut in parts where a folder holds few, and every third part held out.

    Of three flights often one alone turns fast: whatever acts there could be learnt or tested, not both. Many
    recordings stay whole, so that what differs from one to another is tested too. Recordings of a published split are
    learnt from and tested on as published.
    """
    if subject.parted:
        return subject
    subject = replace(subject, parted=True)
    parts = [_parts(log) for log in subject.logs]
    if subject.folder is None or len(parts) >= READING.whole or all(len(p) == 1 for p in parts):
        return subject
    logs = tuple(log for part in parts for log in part)
    training, held_out = thirds([log.name for log in logs])
    note = (
        f"Few recordings were given, and each long one is cut in parts: effects are fitted to {len(training)} parts "
        f"and tested on {len(held_out)} others, so that what only one recording shows is learnt and tested."
    )
    return replace(subject, logs=logs, training=training, held_out=held_out, notes=(*subject.notes, note))


def _parts(log: Log) -> list[Log]:
    """Parts of one length, in order; the whole where they would be too few or too short."""
    shortest = max(READING.part * log.pace, READING.part_samples)
    count = min(READING.most_parts, int(len(log) / shortest))
    if count < READING.fewest_parts:
        return [log]
    ends = np.linspace(0, len(log), count + 1).round().astype(int)
    parts = [log.part(slice(a, b), f"{log.name}_{i}of{count}") for i, (a, b) in enumerate(pairwise(ends), start=1)]
    return [replace(part, part_of=log.name) for part in parts]
