"""Stretches in which a signal and its rate contradict each other, as they do while a filter of the rate starts up."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.diagnose.checks.alignment import changes
from bench.diagnose.logs.consistency import Pair, View, spread, within
from bench.diagnose.result import DataProblem
from bench.diagnose.settings import ALIGNING, DISAGREEING
from registry.datasets.reading.cleaning import runs


@dataclass(frozen=True)
class Disagreement:
    """The worst stretch of a recording."""

    recording: str
    signal: str
    rate: str
    rows: tuple[int, int]
    times: float
    """What the rate says too much or too little over `ALIGNING.window`, over what is usual between the two."""


def disagreements(view: View) -> list[Disagreement]:
    """Of each signal with a rate the worst stretch, where it is far beyond the usual and more than all the motion."""
    length = max(3, round(ALIGNING.window * view.log.pace))
    inside = within(view.usable, length)
    if inside.sum() < ALIGNING.apart * length:
        return []
    return [found for pair in view.pairs if (found := _worst(view, pair, inside, length)) is not None]


def _worst(view: View, pair: Pair, inside: np.ndarray, length: int) -> Disagreement | None:
    moved, said = changes(pair, view.x, view.dt, length)
    beyond = moved - said
    usual = spread(beyond[inside])
    limit = np.maximum(DISAGREEING.usual * usual, np.quantile(np.abs(moved[inside]), 0.99, axis=0))
    times = np.where(inside[:, None] & (np.abs(beyond) > limit), np.abs(beyond) / np.maximum(usual, 1e-300), 0.0)
    worst = times.max(axis=1)
    if not worst.any():
        return None
    first, end = next((a, b) for a, b in runs(worst > 0) if a <= worst.argmax() < b)
    rows = (first if view.usable[:first].any() else 0, end + length - 1)
    return Disagreement(view.log.name, pair.signal, pair.rate, rows, float(worst.max()))


def told(found: Sequence[Disagreement]) -> list[DataProblem]:
    """A sentence for each pair of signals, of the recording in which they disagree most."""
    out = []
    for signal, rate in dict.fromkeys((d.signal, d.rate) for d in found):
        alike = [d for d in found if (d.signal, d.rate) == (signal, rate)]
        most = max(alike, key=lambda d: d.times)
        first, last = most.rows
        where = f"in {most.recording}" if len(alike) == 1 else f"in {len(alike)} recordings, most in {most.recording}"
        detail = (
            f"{rate.replace('_', ' ').capitalize()} and the change of {signal.replace('_', ' ')} contradict each other "
            f"{where} at samples {first} to {last}, {most.times:.0f} times as much as is usual between them: if a "
            "filter started up there, leave these rows out (skip_s in dataset.toml), or the rate, which is then read "
            "from the slope."
        )
        out.append(DataProblem(most.recording, rate, "disagreement", most.rows, detail))
    return out
