"""Which measurements are learnt from and which only test: whole recordings, or parts of few long ones."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.settings import READING


def thirds(names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Those to learn from, and every third by name, at least one, to test on.

    Spread over the session, so that neither is all of one kind of flight or of one state of the battery.
    """
    ordered, n = sorted(names), max(1, round(len(names) * READING.held_out))
    test = {ordered[round((i + 0.5) * len(ordered) / n - 0.5)] for i in range(n)}
    return tuple(x for x in ordered if x not in test), tuple(x for x in ordered if x in test)


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
