"""Whether signals have the axes, the signs, the units and the clock that others say they have."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.diagnose.logs.consistency import Array, Pair, accumulated, change, correlation, integral, within
from bench.diagnose.logs.subject import Log
from bench.diagnose.result import DataProblem
from bench.diagnose.settings import ALIGNING

KNOWN = {57.29578: "degrees for radians", 9.549297: "rpm for rad/s", 1000.0: "a thousandth", 100.0: "centi"}
"""Factors between units that are taken for each other."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Changes of a signal over windows against those that another one says, axis by axis."""

    correlation: Array
    """(c, c): of measured axis i with said axis j."""
    low: Array
    """(c,): slope of measured over said where all noise is in what is said …"""
    high: Array
    """(c,): … and where all of it is in what is measured; the truth is between."""


def alignment(
    log: Log, among: Sequence[Pair], x: Array, modelled: Array, usable: Array
) -> tuple[list[DataProblem], list[Pair]]:
    """What is wrong with the axes of a log, and the pairs of signals that agree.

    Args:
        log: the recording.
        among: signals with their rates.
        x: (N, s) states.
        modelled: (N, s) their time derivative by the model.
        usable: (N,) samples that count.
    """
    found: list[DataProblem] = []
    sound, paces, length = [], [], max(3, round(ALIGNING.window * log.pace))
    for pair in among:
        measured, said = changes(pair, x, log.dt, length)
        inside = within(usable, length)
        fit = fit_alignment(measured[inside], said[inside], length)
        if fit is None:
            sound.append(pair)
            continue
        wrong = (
            _interchanged(log, pair, fit, x, inside, length)
            or _axes(log, pair, fit, x, modelled, usable)
            or _scale(log, pair, fit)
            or _unrelated(log, pair, fit, (measured[inside], said[inside]), x[: len(inside)][inside], length)
        )
        found += wrong
        if not wrong:
            sound.append(pair)
            paces.append(_paces(measured, said, inside, round(ALIGNING.clock_block * log.pace)))
    if not found:
        found += _clock(log, sound, paces, length)
    if not found:
        found += _against_model(log, sound, x, modelled, usable)
    return found, sound


def fit_alignment(measured: Array, said: Array, length: int) -> Fit | None:
    """Compare changes (K, c) over ``length`` steps; windows that fit worst are left out. None: too few."""
    if len(measured) < ALIGNING.apart * length:
        return None
    size = measured.std(axis=0) + said.std(axis=0) + 1e-12
    miss = np.minimum(np.abs(measured - said), np.abs(measured + said)) / size
    worst = miss.max(axis=1)
    keep = worst <= np.quantile(worst, 0.9)
    m, s = measured[keep], said[keep]
    mm, ss, ms = (m * m).sum(axis=0), (s * s).sum(axis=0), (m * s).sum(axis=0)
    cross = m.T @ s / np.sqrt(np.outer(mm, ss) + 1e-300)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Fit(cross, ms / ss, mm / ms)


def changes(pair: Pair, x: Array, dt: float, length: int) -> tuple[Array, Array]:
    """What the signal changes over windows of ``length`` steps, and what its rate says (N − length, axes).

    Of an attitude the small turns of every step are summed up, as the body rates are.
    """
    own, rate = change(x[:, pair.channels], pair.turns), integral(x[:, pair.rates], dt)
    a, b = accumulated(own), accumulated(rate)
    return a[length:] - a[:-length], b[length:] - b[:-length]


def _interchanged(log: Log, pair: Pair, fit: Fit, x: Array, inside: Array, length: int) -> list[DataProblem]:
    """Whether the rate changes as the signal says, and not the other way round: each has the other's column."""
    if pair.turns:
        return []
    measured, said = changes(Pair(pair.rate, pair.signal, pair.rates, pair.channels, pair.axes), x, log.dt, length)
    back = fit_alignment(measured[inside], said[inside], length)
    if back is None or np.diag(fit.correlation).max() > 0.6 or np.diag(back.correlation).min() < 0.95:
        return []
    if back.low.min() < 1 / ALIGNING.scale or back.high.max() > ALIGNING.scale:
        return []
    detail = (
        f"{pair.rate} changes as {pair.signal} says (correlation {np.diag(back.correlation).min():.2f}), and not the "
        f"other way round ({np.diag(fit.correlation).max():.2f}): each seems to be in the other's column."
    )
    return [DataProblem(log.name, pair.rate, "swapped signals", (0, len(log) - 1), detail)]


def _axes(log: Log, pair: Pair, fit: Fit, x: Array, modelled: Array, usable: Array) -> list[DataProblem]:
    c, diagonal = fit.correlation, np.diag(fit.correlation)
    axes, found = pair.axes, []
    for i, axis in enumerate(axes):
        for j in range(i + 1, len(axes)):
            if min(abs(c[i, j]), abs(c[j, i])) > 0.85 and max(abs(diagonal[i]), abs(diagonal[j])) < 0.6:
                detail = (
                    f"{pair.signal}.{axis} changes as {pair.rate} says of axis {axes[j]} (correlation {c[i, j]:.2f}) "
                    f"and the other way round ({c[j, i]:.2f}), not as it says of its own ({diagonal[i]:.2f})."
                )
                signal = _blamed(log, pair, (i, j), x, modelled, usable)
                found.append(DataProblem(log.name, signal, "swapped axes", (0, len(log) - 1), detail))
    if found:
        return found
    for i, axis in enumerate(axes):
        if diagonal[i] < -0.8 and -fit.low[i] > 0.6 and -fit.high[i] < 1.6:
            detail = (
                f"{pair.signal}.{axis} changes against what {pair.rate} says: slope "
                f"{(fit.low[i] + fit.high[i]) / 2:.2f}, correlation {diagonal[i]:.2f}."
            )
            signal = _blamed(log, pair, (i, i), x, modelled, usable)
            found.append(DataProblem(log.name, signal, "swapped sign", (0, len(log) - 1), detail))
    return found


def _blamed(log: Log, pair: Pair, axes: tuple[int, int], x: Array, modelled: Array, usable: Array) -> str:
    """Which of the two signals the model speaks against, along an axis, or two that are swapped."""
    i, j = axes
    length = max(3, round(ALIGNING.window * log.pace))
    channels = [pair.rates[i], pair.rates[j]]
    measured, said = (
        accumulated(s) for s in (np.diff(x[:, channels], axis=0), integral(modelled[:, channels], log.dt))
    )
    inside = within(usable, length)
    fit = fit_alignment(
        (measured[length:] - measured[:-length])[inside], (said[length:] - said[:-length])[inside], length
    )
    if fit is None:
        return pair.rate
    own = fit.correlation[0, 0] if i == j else min(fit.correlation[0, 0], fit.correlation[1, 1])
    return pair.signal if own > 0.3 else pair.rate


def _scale(log: Log, pair: Pair, fit: Fit) -> list[DataProblem]:
    diagonal = np.diag(fit.correlation)
    clear = diagonal > 0.95
    if not clear.any():
        return []
    low, high = float(fit.low[clear].min()), float(fit.high[clear].max())
    if high > 1 / ALIGNING.scale and low < ALIGNING.scale:
        return []
    factor = float(np.median((fit.low[clear] + fit.high[clear]) / 2))
    size = max(factor, 1 / factor)
    unit = next((name for k, name in KNOWN.items() if abs(size / k - 1) < 0.03), "")
    detail = f"{pair.signal} changes {factor:.4g} times as much as {pair.rate} says"
    detail += f": {unit}?" if unit else "."
    # What is too great is in the smaller unit.
    signal = pair.signal if factor > 1 else pair.rate
    return [DataProblem(log.name, signal, "unit" if unit else "scale", (0, len(log) - 1), detail)]


def _unrelated(log: Log, pair: Pair, fit: Fit, over: tuple[Array, Array], x: Array, length: int) -> list[DataProblem]:
    """Whether what is filed as a rate moves as smoothly as the signal does, and does not go with its change.

    Neither about its mean, which may be off, nor without the windows that fit worst, in which it may have jumped.

    Args:
        log: the recording.
        pair: the signal and its rate.
        fit: of what the two say.
        over: changes (K, c) over windows as measured, and as the rate says.
        x: (K, s) states where these begin.
        length: steps of a window.
    """
    if pair.turns:
        return []
    measured, said = over
    size, near, found = measured.std(axis=0), max(1, length // 8), []
    for i, axis in enumerate(pair.axes):
        smooth = [correlation(v[near:], v[:-near]) for v in (measured[:, i], x[:, pair.rates[i]])]
        by = max(correlation(measured[:, i], said[:, i]), fit.correlation[i, i], key=abs)
        moves = size[i] >= ALIGNING.moving * size.max()  # an axis that rests shows how each signal drifts
        if moves and min(smooth) > ALIGNING.smooth and abs(by) < ALIGNING.unrelated:
            of = f".{axis}" if axis else ""
            detail = (
                f"{pair.rate}{of} is no rate of {pair.signal}{of}: what they say of {length * log.dt:.2g} s has a "
                f"correlation of {by:.2f}. Take {pair.rate} out of dataset.toml, and it is read from the slope of "
                f"{pair.signal}."
            )
            found.append(DataProblem(log.name, pair.rate, "unrelated", (0, len(log) - 1), detail))
    return found


def _paces(measured: Array, said: Array, inside: Array, block: int) -> Array:
    """Bounds of slope measured over said in each block, all axes together (blocks, 2); NaN where little moves."""
    count = max(1, len(measured) // block)
    out = np.full((count, 2), np.nan)
    for k, part in enumerate(np.array_split(np.arange(len(measured)), count)):
        m, s = (v[part][inside[part]] for v in (measured, said))
        if len(m) < len(part) / 3:
            continue
        mm, ss, ms = (float((a * b).sum()) for a, b in ((m, m), (s, s), (m, s)))
        if ms > 0.995 * (mm * ss) ** 0.5 > 0:
            out[k] = ms / ss, mm / ms
    return out


def _clock(log: Log, sound: Sequence[Pair], paces: Sequence[Array], length: int) -> list[DataProblem]:
    """A factor between signals and their rates that is the same in all of them is the clock's."""
    if len(paces) < 2:
        return []
    low, high = np.min([p[:, 0] for p in paces], axis=0), np.max([p[:, 1] for p in paces], axis=0)
    known = np.isfinite(low) & np.isfinite(high)
    fast, slow = known & (low > 1 + ALIGNING.clock_error), known & (high < 1 - ALIGNING.clock_error)
    for off in (fast, slow):
        agree = off & (high - low < 0.4 * np.abs(low - 1) + 0.01)
        if agree.sum() < min(2, known.sum()) or not agree.any():
            continue
        size = len(log) / len(low)
        at = np.flatnonzero(agree)
        whole = agree.sum() > 0.7 * known.sum()
        rows = (0, len(log) - 1) if whole else (round(at[0] * size), min(len(log) - 1, round((at[-1] + 1) * size)))
        pace = float(np.median((low + high)[agree] / 2))
        detail = (
            f"{' and '.join(p.signal for p in sound)} change {pace:.3f} times as much as their rates say over the "
            f"stated {log.rate:g} Hz: a sample takes {1e3 * pace * log.dt:.4g} ms and not {1e3 * log.dt:.4g} ms."
        )
        return [DataProblem(log.name, "time", "clock rate", rows, detail)]
    return []


def _against_model(log: Log, sound: Sequence[Pair], x: Array, modelled: Array, usable: Array) -> list[DataProblem]:
    """Motion against the force that drives it, in signals that agree with each other."""
    found = []
    for pair in sound:
        length = max(3, round((ALIGNING.window / 2 if pair.turns else ALIGNING.window) * log.pace))
        channels = list(pair.rates)
        own, said = (accumulated(s) for s in (np.diff(x[:, channels], axis=0), integral(modelled[:, channels], log.dt)))
        inside = within(usable, length)
        fit = fit_alignment((own[length:] - own[:-length])[inside], (said[length:] - said[:-length])[inside], length)
        if fit is None:
            continue
        for i, axis in enumerate(pair.axes):
            if fit.correlation[i, i] < -0.8 and -fit.low[i] > 0.5 and -fit.high[i] < 2:
                detail = (
                    f"{pair.rate}.{axis} changes against what the model says: slope "
                    f"{(fit.low[i] + fit.high[i]) / 2:.2f}, correlation {fit.correlation[i, i]:.2f}; signs or "
                    f"numbers of the inputs{'' if pair.turns else ', or of the attitude,'} do not fit."
                )
                found.append(DataProblem(log.name, pair.rate, "swapped sign", (0, len(log) - 1), detail))
    return found
