"""Rates that were made as differences of neighbouring samples: half a sample from the time they are filed under."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from bench.diagnose.logs.consistency import Pair, change, pairs
from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.settings import READING


def centred(subject: Subject) -> Subject:
    """The subject with differences filed at the middle of the interval that they span, and a note that says so.

    A rate that is the pose's difference to the sample before belongs half a sample earlier. Left there, the inputs
    would seem to act late. The mean with the next one is the difference about its own sample; the last sample of a log
    has no next one and becomes invalid.
    """
    late = [p for p in pairs(subject.model, subject.logs[0].measured) if _late(subject.logs, p)]
    if not late:
        return subject
    rates = [c for p in late for c in p.rates]
    said = " and ".join(f"{p.rate.replace('_', ' ')} of {p.signal.replace('_', ' ')}" for p in late)
    ms = 500 * subject.logs[0].dt
    note = (
        f"Backward differences: {said}. They belong half a sample ({ms:.3g} ms) earlier than they are filed and were "
        "averaged with the next one, which is at the right time."
    )
    return replace(
        subject,
        logs=tuple(_moved(log, rates) for log in subject.logs),
        differences=tuple(p.rate for p in late),
        notes=(*subject.notes, note),
    )


def _late(logs: Sequence[Log], pair: Pair) -> bool:
    left = np.zeros(3)  # by the differences to the sample before, to the one after and over both
    for log in logs:
        x, good = log.states.numpy(), log.valid.numpy()
        usable = good[2:] & good[1:-1] & good[:-2]
        difference = change(x[:, pair.channels], pair.turns) / log.dt
        own, before, after = x[1:-1, pair.rates][usable], difference[:-1][usable], difference[1:][usable]
        left += [((own - d) ** 2).sum() for d in (before, after, (before + after) / 2)]
    return bool(left[0] < READING.plain_difference**2 * left[1:].min())


def _moved(log: Log, rates: Sequence[int]) -> Log:
    states, valid = log.states.clone(), log.valid.clone()
    at = torch.tensor(rates)
    states[:-1, at] = (log.states[:-1, at] + log.states[1:, at]) / 2
    valid[:-1] &= log.valid[1:]
    valid[-1] = False
    return replace(log, states=states, valid=valid)
