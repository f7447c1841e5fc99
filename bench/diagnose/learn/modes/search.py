"""The hidden mode that one axis shows: which signal drives it, its frequency and damping."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # scipy.optimize is imported when it is used

from bench.diagnose.learn.axis_series import AxisSeries
from bench.diagnose.learn.modes.axis_rows import AxisRows
from bench.diagnose.learn.modes.filters import Pole
from bench.diagnose.settings import HIDING, UNSEEN


@dataclass(frozen=True)
class Mode:
    """A mode along one axis."""

    axis: str
    driver: str
    pole: Pole
    gains: tuple[float, ...]
    """What a unit of z − d and of ż/ω does, over ω."""
    evidence: float
    """Log-likelihood that driving saves in the training recordings, less what the numbers cost."""


def sought(
    series: AxisSeries, drivers: dict[str, int], training: Sequence[str], tries: int, inputs: Collection[str] = ()
) -> list[Mode]:
    """The modes along one axis that held-out recordings confirm, of each driver and order the best; any may be the one.

    Args:
        series: of all recordings.
        drivers: names and places of the signals that could drive it.
        training: recordings in which it is sought.
        tries: how many axes are searched: the more, the surer it must be.
        inputs: the drivers whose own noise is no matter, so that faster modes are told from it.
    """
    rows = AxisRows.of(series, list(drivers.values()), training)
    if rows is None or rows.count < UNSEEN.shortest:
        return []
    names = list(drivers)
    whiten = rows.colour(rows.plain(0, rows.colour([s.left for s in rows.seen])).left)
    known = [name in inputs for name in names]
    poles = _grid(rows, any(known))
    whitened = rows.whitened(range(len(names)), whiten)
    seen = [whitened.scan(p) for p in poles]
    look = float(np.log(max(1, len(poles) * len(names)) * tries / HIDING.false_alarm))
    out: list[Mode] = []
    for order in (2, 1):
        sure = []
        for damping in {p.damping for p in poles if p.order == order}:
            row = [i for i, p in enumerate(poles) if p.order == order and p.damping == damping]
            losses, gains = (np.array([seen[i][k] for i in row]) for k in (0, 1))
            # The noise of a driver makes the fastest pole look best: dips count, no ends.
            dips = (losses[1:-1] < losses[:-2]) & (losses[1:-1] < losses[2:])
            dips &= gains[1:-1] - _charge(rows, order) > look
            dips &= np.array([[poles[i].frequency < _fastest(rows, order, k) for k in known] for i in row[1:-1]])
            sure += [(losses[i + 1, d], poles[row[i + 1]], d) for i, d in np.argwhere(dips).tolist()]
        by_driver = {d: min((one for one in sure if one[2] == d), key=lambda one: one[0]) for d in {x[2] for x in sure}}
        # Noise that is whitened beside the mode tells more surely which signal drives it.
        for _, pole, driver in sorted(by_driver.values(), key=lambda one: one[0])[: HIDING.drivers]:
            found = _refined(rows, pole, driver, names, look, _fastest(rows, order, known[driver]))
            out += [found] if found is not None else []
    return out


def _grid(rows: AxisRows, known: bool) -> list[Pole]:
    """The poles that are tried; ``known``: of drivers without noise too."""
    longest = max(s.t[-1] - s.t[0] for s in rows.seen)
    low, high = HIDING.periods / longest, _fastest(rows, 2, known=False)
    out: list[Pole] = []
    if low < high:
        for damping in HIDING.dampings:
            count = int(np.log(high / low) / np.log1p(HIDING.spacing * damping)) + 2
            tried = np.geomspace(low, high, count)
            further = np.arange(high, _fastest(rows, 2, known), tried[-1] - tried[-2])[1:]
            out += [Pole(float(f), damping, 2) for f in (*tried, *further)]
        slow = low / (2 * np.pi)
        out += [Pole(float(f), 0.0, 1) for f in np.geomspace(slow, _fastest(rows, 1, known), HIDING.lags)]
    return out


def _fastest(rows: AxisRows, order: int, known: bool) -> float:
    """The highest frequency [Hz] of what swings or relaxes; ``known``: whether what drives it has no noise.

    Noise of a driver tells noise of its own change, the better the faster the pole. What relaxes as fast as inputs
    change is a lag of theirs.
    """
    of = HIDING.highest / 2 if order == 1 else HIDING.highest_of_inputs if known else HIDING.highest
    return of / rows.series.step


def _charge(rows: AxisRows, order: int) -> float:
    """What the numbers of a mode must save: half the logarithm of the rows each (Schwarz)."""
    return order * float(np.log(rows.count))


def _refined(rows: AxisRows, pole: Pole, driver: int, names: Sequence[str], look: float, fastest: float) -> Mode | None:
    """A mode at its best frequency and damping, if it is sure in training and held-out recordings."""
    filters = [rows.colour(rows.plain(driver, rows.colour([s.left for s in rows.seen])).left)] * 2
    for _ in range(HIDING.rounds):
        pole = _nearest(rows, pole, driver, filters[1], fastest)
        fits = rows.plain(driver, filters[0], pole), rows.fit(pole, driver, filters[1])
        filters = [rows.colour(f.left) for f in fits]
    plain, fit = rows.plain(driver, filters[0], pole), rows.fit(pole, driver, filters[1])
    gain = rows.count / 2 * float(np.log(plain.loss / fit.loss))
    evidence = gain - _charge(rows, pole.order)
    if evidence < look or pole.frequency > fastest or (pole.order == 2 and pole.damping > HIDING.most_damped):
        return None
    if rows.others:
        told = rows.held_out(pole, driver, [plain, fit], filters)
        saved = told[0] - told[1]
        if saved.sum() < -np.log(HIDING.confirmed) or (saved > 0).mean() < HIDING.agreed:
            return None
    turn = 2 * np.pi * pole.frequency
    gains = tuple(float(g) / turn for g in fit.values[-pole.order :])
    return Mode(rows.series.axis, names[driver], pole, gains, evidence)


def _nearest(rows: AxisRows, pole: Pole, driver: int, whiten: np.ndarray, fastest: float) -> Pole:
    """The poles near these at which least is left."""
    whitened = rows.whitened([driver], whiten)
    bottom = HIDING.lowest / max(s.t[-1] - s.t[0] for s in rows.seen)

    def made(x: np.ndarray) -> Pole:
        damping = float(np.exp(np.clip(x[1], np.log(HIDING.least_damped), np.log(0.99)))) if pole.order == 2 else 0.0
        return Pole(float(np.exp(np.clip(x[0], np.log(bottom), np.log(2 * fastest)))), damping, pole.order)

    begin = np.log([pole.frequency, pole.damping]) if pole.order == 2 else np.log([pole.frequency])
    wide = [0.5 * HIDING.spacing * pole.damping, 0.5] if pole.order == 2 else [0.3]
    simplex = np.vstack([begin, *(begin + np.diag(wide))])
    found = scipy.optimize.minimize(
        lambda x: np.log(whitened.scan(made(x))[0][0]),
        begin,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": HIDING.refined, "xatol": 1e-4, "fatol": 1e-7},
    )
    return made(found.x)
