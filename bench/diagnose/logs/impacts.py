"""Where a vehicle hits something: what follows is no flight, and no model of flight says anything of it."""

from dataclasses import replace

import numpy as np

from bench.diagnose.logs.consistency import Pair, View, change, spread
from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.settings import HITTING, READING, SPIKING
from registry.dynamics import PhysicsModel


def before_impacts(subject: Subject) -> Subject:
    """The subject with every recording of a vehicle valid until it hits something, with a note for each that does."""
    if not subject.model.description().turning:
        return subject  # what a machine hits is part of it
    logs, notes = [], []
    for log in subject.logs:
        at = impact(subject.model, log)
        if at is None:
            logs.append(log)
            continue
        valid = log.valid.clone()
        valid[max(0, at - READING.ends) :] = False
        logs.append(replace(log, valid=valid))
        notes.append(
            f"{log.name}: the vehicle hits something at {at * log.dt:.2f} s (its velocity and body rates change within "
            "a sample, its position and attitude go on from where they were): what follows is left out."
        )
    if not notes:
        return subject
    before, told = subject.notes, subject.resampled  # on the page and on the terminal
    return replace(subject, logs=tuple(logs), notes=(*before, *notes), resampled=(*told, *notes))


def impact(model: PhysicsModel, log: Log) -> int | None:
    """The last sample before a vehicle hits something; None: it does not, or too little was measured to tell.

    All its rates change at once, by more than any air does, and stay changed; what they integrate to goes on, which
    it would not where samples are missing or sensors fail.
    """
    view = View(model, log)
    turned = next((p for p in view.pairs if p.turns), None)
    moved = next((p for p in view.pairs if not p.turns), None)
    if turned is None or moved is None:
        return None
    jumps = [_Jumps(view, moved, HITTING.acceleration), _Jumps(view, turned, HITTING.turn)]
    usable = view.usable[1:] & view.usable[:-1]
    large = np.logical_and.reduce([usable, *(j.size > j.most for j in jumps)])
    velocity = view.x[:, moved.rates]
    for k in np.flatnonzero(large).tolist():
        before, after = velocity[k + 1 - READING.half_width : k + 1], velocity[k + 1 : k + 1 + READING.half_width]
        changed = np.linalg.norm(np.median(after, axis=0) - np.median(before, axis=0)) > HITTING.acceleration * log.dt
        if changed and all(j.of_an_impact(k) for j in jumps):
            return int(k)
    return None


class _Jumps:
    """What a rate and its signal do over every step, or those beside it, beyond what the model says."""

    def __init__(self, view: View, pair: Pair, most: float) -> None:
        """Of a pair whose rate changes by up to ``most`` [1/s] more than the model says, as long as nothing is hit."""
        self.most = most * view.dt
        self.beyond, self.off = view.beyond_model(pair.rates), view.steps(pair)
        self.size, self.bend, moved = map(_largest, (self.beyond, self.off, change(view.x[:, pair.rates], False)))
        self.reach = moved * view.dt
        """How far the signal may be off with a rate in between."""

    def of_an_impact(self, step: int) -> bool:
        """Whether the rate changes by far more than before, and its signal moves as with a rate in between."""
        flown = slice(max(0, step - HITTING.flown), max(0, step - 1))
        if flown.stop - flown.start < READING.ends:
            return False
        usual, straight = (SPIKING.distance * np.linalg.norm(spread(x[flown])) for x in (self.beyond, self.off))
        return bool(self.size[step] > self.most + usual and self.bend[step] <= self.reach[step] + straight)


def _largest(steps: np.ndarray) -> np.ndarray:
    """The length (N − 1,) of each step (N − 1, c), or of the one before or after it, whichever is largest."""
    size = np.linalg.norm(steps, axis=1)
    return np.maximum.reduce([size, np.append(size[1:], 0), np.append(0, size[:-1])])
