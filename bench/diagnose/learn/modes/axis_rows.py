"""What a model leaves along one axis, against a hidden mode that a measured signal drives.

Of given poles everything else is linear: the gains, how each recording begins, what the model's numbers and functions
of signals explain beside it. All is fitted through a filter that makes the rest white, so that a wandering
force, which its own past tells as well, is not taken for a mode.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.diagnose.learn.axis_series import AxisSeries, Stretch
from bench.diagnose.learn.modes.filters import Pole
from bench.diagnose.learn.modes.whitened import Whitened, left_of
from bench.diagnose.regression.generic import Folds, follow
from bench.diagnose.regression.least_squares import whitening
from bench.diagnose.regression.rows import filtered
from bench.diagnose.settings import UNSEEN


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fit to the training recordings."""

    loss: float
    """Sum of squared innovations."""
    values: np.ndarray
    """Of what is beside, of the driver itself and the gains."""
    left: list[np.ndarray]
    """A training stretch: what is left (J,), not whitened."""


class AxisRows:
    """The recordings along an axis, and the signals that could drive a mode."""

    def __init__(self, series: AxisSeries, drivers: Sequence[int], training: Sequence[str], columns: list[int]) -> None:
        """Prepare.

        Args:
            series: of all recordings.
            drivers: places of the signals among those measured.
            training: recordings to fit; the others confirm.
            columns: what is fitted beside a mode.
        """
        self.series, self.drivers, self.columns = series, list(drivers), columns
        long = [s for s in series.stretches if len(s.t) >= UNSEEN.shortest]
        self.seen = [s for s in long if s.recording in training]
        self.others = [s for s in long if s.recording not in training]

    @classmethod
    def of(cls, series: AxisSeries, drivers: Sequence[int], training: Sequence[str]) -> "AxisRows | None":
        """With the columns that the residual follows; None where no training recording is long enough."""
        rows = cls(series, drivers, training, list(range(series.own)))
        if not rows.seen:
            return None
        grams: dict[str, np.ndarray] = {}
        whiten = rows.colour([s.left - s.left.mean() for s in rows.seen])
        for s in rows.seen:
            x = filtered(np.column_stack([s.beside, s.left]), whiten)
            grams[s.recording] = grams.get(s.recording, 0.0) + x.T @ x
        own = list(range(series.own))
        rows.columns = [*own, *(c for c, _ in follow(Folds.of(list(grams.values()), own), series.own, UNSEEN.beside))]
        return rows

    @property
    def count(self) -> int:
        """Rows of the training stretches that a filter leaves."""
        return sum(len(s.t) - UNSEEN.memory for s in self.seen)

    def colour(self, left: Sequence[np.ndarray]) -> np.ndarray:
        """The monic filter that makes what is left white."""
        found = whitening(left, UNSEEN.memory)
        return found / found[0]

    def plain(self, driver: int, whiten: np.ndarray, pole: Pole | None = None) -> Fitted:
        """Without a mode; ``driver`` is a number among the drivers, ``pole`` of what may swing out undriven."""
        columns = [self._static(s, driver) for s in self.seen]
        bases = [None if pole is None else _free(s, pole) for s in self.seen]
        return _solved(columns, bases, [s.left for s in self.seen], whiten)

    def fit(self, pole: Pole, driver: int, whiten: np.ndarray) -> Fitted:
        """With a mode of these poles, each stretch begun as it must; ``driver`` is a number among the drivers."""
        columns, bases = [], []
        for s in self.seen:
            columns.append(np.column_stack([self._static(s, driver), *self._moved(s, driver, pole)]))
            bases.append(_free(s, pole))
        return _solved(columns, bases, [s.left for s in self.seen], whiten)

    def held_out(self, pole: Pole, driver: int, fits: Sequence[Fitted], filters: Sequence[np.ndarray]) -> np.ndarray:
        """Negative log-likelihood (2, recordings) of those not fitted, without and with driving; all swing out.

        Args:
            pole: of the mode.
            driver: its number among the drivers.
            fits: without and with the mode.
            filters: that make what each of them leaves white.
        """
        found: dict[str, np.ndarray] = {}
        for s in self.others:
            columns = self._static(s, driver)
            both = (columns, np.column_stack([columns, *self._moved(s, driver, pole)]))
            left = []
            for x, fit, whiten in zip(both, fits, filters, strict=True):
                rest = filtered((s.left - x @ fit.values)[:, None], whiten)
                basis = np.linalg.qr(filtered(_free(s, pole), whiten))[0]
                left.append(float(((rest - basis @ (basis.T @ rest)) ** 2).sum()))
            rows = len(s.t) - UNSEEN.memory
            told = rows / 2 * np.log(np.maximum(left, 1e-300) / rows)
            found[s.recording] = found.get(s.recording, np.zeros(2)) + told
        return np.stack(list(found.values()), axis=1)

    def whitened(self, drivers: Sequence[int], whiten: np.ndarray) -> Whitened:
        """The training stretches through a filter, for scans of poles; ``drivers`` are numbers among the drivers."""
        places = [self.drivers[d] for d in drivers]
        return Whitened(self.seen, self.series.step, self.columns, places, whiten)

    def _static(self, s: Stretch, driver: int) -> np.ndarray:
        return np.column_stack([s.beside[:, self.columns], s.measured[:, self.drivers[driver]]])

    def _moved(self, s: Stretch, driver: int, pole: Pole) -> list[np.ndarray]:
        return pole.response(s.measured[:, [self.drivers[driver]]], self.series.step)


def _free(s: Stretch, pole: Pole) -> np.ndarray:
    """What a mode does (J, order) that nobody drives, for every beginning."""
    return pole.turned(s.t - s.t[0])[:, 0]


def _solved(
    columns: Sequence[np.ndarray],
    bases: Sequence[np.ndarray | None],
    left: Sequence[np.ndarray],
    whiten: np.ndarray,
) -> Fitted:
    """Columns (J, p) fitted to what is left (J,), stretches each with free amounts of a basis of its own."""
    gram = np.zeros((columns[0].shape[1] + 1,) * 2)
    for x, basis, y in zip(columns, bases, left, strict=True):
        rows = filtered(np.column_stack([x, y]), whiten)
        if basis is not None:
            across = np.linalg.qr(filtered(basis, whiten))[0]
            rows = rows - across @ (across.T @ rows)
        gram += rows.T @ rows
    loss, values = left_of(gram)
    rest = []
    for x, basis, y in zip(columns, bases, left, strict=True):
        now = y - x @ values
        if basis is not None:
            amounts = np.linalg.lstsq(filtered(basis, whiten), filtered(now[:, None], whiten), rcond=None)[0]
            now = now - (basis @ amounts)[:, 0]
        rest.append(now)
    return Fitted(loss, values, rest)
