"""A line in the spectrum of what a model leaves: something swings at one frequency in every recording.

Each recording has its own amplitude and phase. What the model's numbers and measured signals explain is fitted beside
it, all through a filter that makes the residual white. A line is believed where Thomson's test shows it and its
phase and amplitude in the first half of each recording tell the second half; a resonance that noise drives does not.
A harmonic of what was measured is no line of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are imported when they are used: scipy.optimize takes longer than most of what is here

from bench.diagnose.learn.axis_series import AxisSeries, Stretch
from bench.diagnose.learn.distortion import distortion, in_step
from bench.diagnose.learn.thomson import Scan, lines_at, scan
from bench.diagnose.regression.generic import Folds, follow
from bench.diagnose.regression.least_squares import ridge, squares_left, whitening
from bench.diagnose.regression.rows import filtered
from bench.diagnose.settings import UNSEEN

_NORMAL = 1.96


@dataclass(frozen=True)
class Swing:
    """A line in one recording: amplitude · cos(2π · frequency · t + phase), t from its first sample."""

    amplitude: float
    low: float
    high: float
    """95 %."""
    phase: float
    """[rad], −π to π."""
    turn: float
    """Half of its 95 % interval [rad]."""


@dataclass(frozen=True)
class Line:
    """A line along an axis."""

    axis: str
    unit: str
    frequency: float
    low: float
    high: float
    """95 % [Hz]."""
    swings: dict[str, Swing]
    """By recording."""
    evidence: float
    """−log of the probability that noise shows it at this frequency."""
    gain: float
    """Log-likelihood that it saves in the training recordings."""


def lines(series: AxisSeries, training: Sequence[str], axes: int = 1) -> list[Line]:
    """The lines along one axis, the surest first.

    Args:
        series: of all recordings.
        training: recordings in which frequencies are sought; the others must confirm a line.
        axes: how many axes are searched: the more, the surer a line must be.
    """
    rows = _Rows.of(series, training)
    found: list[Line] = []
    known: list[float] = []
    while rows is not None and len(known) < UNSEEN.most:
        line, taken = rows.surest(known, axes)
        if line is None:
            break
        known.append(line.frequency)
        found += [line] * taken
    return found


def line_at(frequencies: Sequence[float], series: AxisSeries, training: Sequence[str]) -> Line | None:
    """What recordings say of a wave of the last of these frequencies, beside the others; None: none is long enough."""
    rows = _Rows.of(series, training)
    return None if rows is None else rows.line(frequencies)


@dataclass(frozen=True, eq=False)
class _Part:
    """A stretch through the whitening filter."""

    recording: str
    t: np.ndarray
    """(J,) [s]; of as many the filter leaves the last ones."""
    rows: np.ndarray
    """(n, p + 1): what is fitted beside a line, and what is left."""

    def waves(self, frequencies: Sequence[float], whiten: np.ndarray) -> np.ndarray:
        """Cosine and sine (n, 2 F) of each frequency, through the filter."""
        phase = 2 * np.pi * np.outer(self.t, frequencies)
        return filtered(np.stack([np.cos(phase), np.sin(phase)], axis=-1).reshape(len(self.t), -1), whiten)

    def slopes(self, frequency: float, whiten: np.ndarray) -> np.ndarray:
        """What both waves (n, 2) of a frequency change by where it is 1 Hz higher."""
        turned = 2 * np.pi * self.t
        phase = turned * frequency
        return filtered(np.stack([-turned * np.sin(phase), turned * np.cos(phase)], axis=-1), whiten)


class _Rows:
    """Whitened rows of all recordings along an axis."""

    def __init__(self, series: AxisSeries, parts: Sequence[_Part], training: Sequence[str], whiten: np.ndarray) -> None:
        self.series, self.whiten = series, whiten
        self.by_name = {n: [p for p in parts if p.recording == n] for n in dict.fromkeys(p.recording for p in parts)}
        self.training = [n for n in self.by_name if n in training]

    @classmethod
    def of(cls, series: AxisSeries, training: Sequence[str]) -> "_Rows | None":
        """The rows of a series; None where no training recording is long enough."""
        long = [s for s in series.stretches if len(s.t) >= UNSEEN.shortest]
        seen = [s for s in long if s.recording in training]
        if not seen:
            return None
        own, whiten = list(range(series.own)), np.ones(1)
        columns = own
        for _ in range(2):
            grams: dict[str, np.ndarray] = {}
            for s in seen:
                x = filtered(np.column_stack([s.beside, s.left]), whiten)
                grams[s.recording] = grams.get(s.recording, 0.0) + x.T @ x
            columns = [*own, *(c for c, _ in follow(Folds.of(list(grams.values()), own), series.own, UNSEEN.beside))]
            index = [*columns, -1]
            beta = ridge(np.asarray(sum(grams.values()))[np.ix_(index, index)], 1e-9)
            whiten = whitening([s.left - s.beside[:, columns] @ beta for s in seen], UNSEEN.memory)
        parts = [
            _Part(s.recording, s.t, filtered(np.column_stack([s.beside[:, columns], s.left]), whiten)) for s in long
        ]
        return cls(series, parts, training, whiten)

    def surest(self, known: Sequence[float], axes: int) -> tuple[Line | None, bool]:
        """The line that noise shows least, beside those of frequencies ``known``, and whether it is believed.

        None: there is none.
        """
        looked = self._scan(known, known)
        usable = np.array([self.series.gain(f) >= UNSEEN.least_gain for f in looked.frequencies])
        bar = float(np.log(axes * max(1, usable.sum()) / UNSEEN.false_alarm))
        evidence = np.where(usable, looked.evidence, 0.0)
        all_ = [*known, self._refined(known, float(looked.frequencies[np.argmax(evidence)]))]
        # What follows signals may explain most of a wave; beside the wave itself it is known better, or explains all.
        line, (repeated, agreed) = self.line(all_), self._repeated(all_)
        if max(evidence.max(), line.evidence) < bar:
            return None, False
        sure = line.evidence > bar and repeated >= UNSEEN.repeated and agreed >= UNSEEN.agreed
        return line, sure and self._confirmed(all_) and not self._driven(line) and not self._distorted(line)

    def _confirmed(self, frequencies: Sequence[float]) -> bool:
        """Whether the recordings in which the last frequency was not sought show it too, if there are any."""
        others = [n for n in self.by_name if n not in self.training]
        return not others or _shown(self._scan(frequencies, frequencies[:-1], others), frequencies[-1])

    def _driven(self, line: Line) -> bool:
        """Whether the inputs swing at that frequency far more, and in step: what is left is their work, ill modelled.

        A controller that answers a periodic force swings as much as that, and no more; inputs that only happen to swing
        near its frequency are not in step with it.
        """
        stretches = [s for s in self._long() if s.recording in self.training]
        if not _shown(scan([s.driven for s in stretches], self.series.step), line.frequency):
            return False
        inputs = lines_at([s.driven[:, None] for s in stretches], self.series.step, line.frequency)[1]
        both = self._both(line, stretches)
        far = np.abs(inputs).sum() > UNSEEN.driven * np.abs(both[:, 0]).sum()
        return bool(far and in_step(inputs, both)[0])

    def _distorted(self, line: Line) -> bool:
        """Whether the line follows measured signals that do not swing at its frequency themselves."""
        long = self._long()
        return distortion([s.measured for s in long], self._both(line, long), self.series.step, line.frequency)

    def _both(self, line: Line, stretches: Sequence[Stretch]) -> np.ndarray:
        """Complex amplitudes (stretches, 2) of a line beside what is fitted, and of all that is left at its frequency.

        What is fitted beside a line may take a part of a harmonic, and what is not taken off may hide a small line.
        """
        swings = ((line.swings[s.recording], s.t[0]) for s in stretches)
        own = [w.amplitude * np.exp(1j * (w.phase + 2 * np.pi * line.frequency * t)) for w, t in swings]
        left = lines_at([s.left[:, None] for s in stretches], self.series.step, line.frequency)[1][:, 0]
        return np.stack([self.series.gain(line.frequency) * np.array(own), left], axis=1)

    def _long(self) -> list[Stretch]:
        return [s for s in self.series.stretches if len(s.t) >= UNSEEN.shortest]

    def _scan(self, fitted: Sequence[float], taken: Sequence[float], names: Sequence[str] = ()) -> Scan:
        """Look for a line in what is left beside waves ``fitted``, of which those ``taken`` are taken off.

        In the recordings ``names``; default: those of the training.
        """
        beta = self._fit(fitted)[0]
        left = []
        for name in names or self.training:
            parts = self.by_name[name]
            amounts = self._amounts(name, beta, fitted)[: 2 * len(taken)]
            left += [_left(p, beta) - p.waves(taken, self.whiten) @ amounts for p in parts]
        return scan(left, self.series.step)

    def _fit(self, frequencies: Sequence[float]) -> tuple[np.ndarray, float]:
        """What is beside waves of these frequencies (p,), each recording's amplitudes free, and the squares left."""
        gram = np.zeros((1, 1))
        for name in self.training:
            rows = np.concatenate([p.rows for p in self.by_name[name]])
            if frequencies:
                basis = np.linalg.qr(self._waves(name, frequencies))[0]
                rows = rows - basis @ (basis.T @ rows)
            gram = gram + rows.T @ rows
        beta = ridge(gram, 1e-9)
        return beta, squares_left(gram, beta)

    def _waves(self, name: str, frequencies: Sequence[float]) -> np.ndarray:
        return np.concatenate([p.waves(frequencies, self.whiten) for p in self.by_name[name]])

    def _amounts(self, name: str, beta: np.ndarray, frequencies: Sequence[float]) -> np.ndarray:
        """Cosine and sine amplitudes (2 F,) of a recording."""
        left = np.concatenate([_left(p, beta) for p in self.by_name[name]])
        out: np.ndarray = np.linalg.lstsq(self._waves(name, frequencies), left, rcond=None)[0]
        return out

    def _refined(self, known: Sequence[float], near: float) -> float:
        """The frequency at which least is left of the training recordings."""
        longest = max(p.t[-1] - self.by_name[n][0].t[0] for n in self.training for p in self.by_name[n])
        reach = 0.75 / longest
        found = scipy.optimize.minimize_scalar(
            lambda f: self._fit([*known, f])[1], bounds=(near - reach, near + reach), method="bounded"
        )
        return float(found.x)

    def _repeated(self, frequencies: Sequence[float]) -> tuple[float, float]:
        """Share of the last wave in second halves that first halves tell, and of the recordings in which they do."""
        beta = self._fit(frequencies)[0]
        power, missed = [], []
        for name, parts in self.by_name.items():
            left = np.concatenate([_left(p, beta) for p in parts])
            waves = self._waves(name, frequencies)
            halves = np.array_split(np.arange(len(left)), 2)
            first, second = (np.linalg.lstsq(waves[h], left[h], rcond=None)[0][-2:] for h in halves)
            last = waves[halves[1]][:, -2:]
            power.append(float(((last @ second) ** 2).sum()))
            missed.append(float(((last @ (second - first)) ** 2).sum()))
        told = np.array(missed) < np.array(power)
        return 1 - sum(missed) / max(sum(power), 1e-300), float(told.mean())

    def line(self, frequencies: Sequence[float]) -> Line:
        """The line of the last of these frequencies, beside the others."""
        frequency, (beta, loss) = frequencies[-1], self._fit(frequencies)
        looked = self._scan(frequencies, frequencies[:-1])
        near = int(np.argmin(np.abs(looked.frequencies - frequency)))
        level = float(looked.background[near])  # of the noise about it
        rows = sum(len(p.rows) for n in self.training for p in self.by_name[n])
        gain, swings, sharpness = self.series.gain(frequency), {}, 0.0
        for name, parts in self.by_name.items():
            waves = self._waves(name, frequencies)
            amounts = self._amounts(name, beta, frequencies)
            inverse = np.linalg.pinv(waves)[-2:]
            covariance = level * inverse @ inverse.T
            a, b = amounts[-2:]
            size = float(np.hypot(a, b))
            along, across = np.array([[a, b], [-b, a]]) / max(size, 1e-300)
            half, turn = (_NORMAL * float(v @ covariance @ v) ** 0.5 for v in (along, across))
            swings[name] = Swing(
                amplitude=size / gain,
                low=max(0.0, size - half) / gain,
                high=(size + half) / gain,
                phase=float(np.arctan2(-b, a)),
                turn=min(turn / max(size, 1e-300), np.pi),
            )
            if name in self.training:
                moved = np.concatenate([p.slopes(frequency, self.whiten) for p in parts]) @ [a, b]
                moved = moved - waves @ np.linalg.lstsq(waves, moved, rcond=None)[0]
                sharpness += float(moved @ moved)
        half = _NORMAL * (level / max(sharpness, 1e-300)) ** 0.5
        return Line(
            axis=self.series.axis,
            unit=self.series.unit,
            frequency=frequency,
            low=frequency - half,
            high=frequency + half,
            swings=swings,
            evidence=float(looked.evidence[max(0, near - 1) : near + 2].max()),
            gain=rows / 2 * float(np.log(self._fit(frequencies[:-1])[1] / loss)),
        )


def _left(part: _Part, beta: np.ndarray) -> np.ndarray:
    """What everything beside a line leaves (n,)."""
    out: np.ndarray = part.rows[:, -1] - part.rows[:, :-1] @ beta
    return out


def _shown(looked: Scan, frequency: float) -> bool:
    """Whether there is a line at one frequency, of which nobody knew from these series."""
    near = int(np.argmin(np.abs(looked.frequencies - frequency)))
    return bool(looked.evidence[near] > -np.log(UNSEEN.confirmed))
