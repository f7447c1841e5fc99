"""How far and how fast a manoeuvre may go, and where the states must stay: as the recordings show, or as told."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.diagnose.logs.subject import Subject
from bench.diagnose.settings import LIMITING
from registry.dynamics import SetPoint
from registry.dynamics.model import RATE_OF
from registry.errors import BenchError, near


@dataclass(frozen=True)
class Limit:
    """One channel, SI."""

    name: str
    unit: str
    low: float
    high: float
    rate: float = float("inf")
    """Largest change in a second."""
    start: float = 0.0
    """Where it is before the manoeuvre."""

    @property
    def span(self) -> float:
        """Upper less lower limit."""
        return self.high - self.low


@dataclass(frozen=True)
class Limits:
    """Of a whole manoeuvre."""

    drives: tuple[Limit, ...]
    """What is chosen: inputs, set-points of a vehicle, or the states from which an undriven system starts."""
    states: tuple[Limit, ...]
    """Where the states stay, in the order of the model."""
    band: tuple[float, float]
    """Frequencies that the recordings excite [Hz]."""

    def told(self, given: Mapping[str, tuple[float, float, float | None]]) -> "Limits":
        """With the ends (low, high) and the rate of channels as a user gives them; a signal's name means all its axes.

        Raises:
            BenchError: no channel of such a name, or ends in the wrong order.
        """
        names = {n for x in (*self.drives, *self.states) for n in (x.name, x.name.partition(".")[0])}
        for name, (low, high, _) in given.items():
            if name not in names:
                raise BenchError(
                    f"--limit {name}: no signal to drive or to stay within has this name: {near(name, names)}"
                )
            if not low < high:
                raise BenchError(f"--limit {name}: {low:g} is not below {high:g}.")

        def changed(x: Limit) -> Limit:
            found = given.get(x.name) or given.get(x.name.partition(".")[0])
            if found is None:
                return x
            low, high, rate = found
            return replace(
                x, low=low, high=high, rate=x.rate if rate is None else rate, start=min(max(x.start, low), high)
            )

        return Limits(tuple(map(changed, self.drives)), tuple(map(changed, self.states)), self.band)


def shown(subject: Subject) -> Limits:
    """The limits that the recordings show.

    An input or a speed that takes both signs may do so alike; another one goes from zero to its largest. What is
    driven is an input; of a vehicle that would fall without a pilot its set-points; of an undriven system its start.
    """
    model, logs = subject.model, subject.logs
    valid = [log.valid.numpy() for log in logs]
    states = np.concatenate([log.states.numpy()[v] for log, v in zip(logs, valid, strict=True)])
    rates = set(RATE_OF.values())
    stay = []
    for i, c in enumerate(model.state_channels):
        x = states[:, i]
        low, high = float(x.min()), float(x.max())
        if c.group in rates:
            low, high = -max(-low, high), max(-low, high)
        room = LIMITING.room * (high - low)
        free = c.group == "attitude" or not logs[0].measured[i]
        stay.append(Limit(c.name, c.unit, *((-np.inf, np.inf) if free else (low - room, high + room))))
    pilot = model.pilot()
    if pilot is None and model.needs_pilot:
        raise BenchError(
            f"No pilot is known for {subject.system}: designs are for quadrotors and what is safe open loop."
        )
    if pilot is not None:
        return Limits(tuple(_set_point(p, states, stay) for p in pilot.set_points), tuple(stay), pilot.band)
    size = logs[0].inputs.shape[1] - len(model.extras)
    if not size:
        first = np.stack([log.states.numpy()[0] for log in logs])
        return Limits(tuple(_release(s, x) for s, x in zip(stay, first.T, strict=True)), tuple(stay), (0.0, 0.0))
    return Limits(_inputs(subject, size), tuple(stay), _band(subject, size))


def _inputs(subject: Subject, size: int) -> tuple[Limit, ...]:
    logs, found = subject.logs, []
    channels = logs[0].recording.input_channels
    for i in range(size):
        series = [log.inputs.numpy()[log.valid.numpy(), i] for log in logs]
        x, steps = np.concatenate(series), np.concatenate([np.abs(np.diff(s)) for s in series])
        low, high = float(x.min()), float(x.max())
        low, high = (-max(-low, high), max(-low, high)) if low < 0 < high else (min(low, 0.0), max(high, 0.0))
        if low == high:
            raise BenchError(
                f"{channels[i].name} is zero in all recordings: say with --limit how far it may be driven."
            )
        moving = steps[steps > 0]
        rate = float(np.percentile(moving, LIMITING.fastest)) * logs[0].rate if len(moving) else np.inf
        first = float(np.mean([s[0] for s in series]))
        found.append(Limit(channels[i].name, channels[i].unit, low, high, rate, min(max(first, low), high)))
    return tuple(found)


def _release(stay: Limit, first: np.ndarray) -> Limit:
    return replace(stay, low=max(stay.low, min(0.0, float(first.min()))), start=float(first.mean()))


def _set_point(point: SetPoint, states: np.ndarray, stay: Sequence[Limit]) -> Limit:
    """What a pilot may be asked for: the places and the speeds that the recordings (samples, s) show."""
    rate = max(float(np.percentile(np.abs(states[:, point.rate]), LIMITING.fastest)), LIMITING.slowest)
    if point.state is None:
        return Limit(point.name, point.unit, *point.ends, rate)
    there = stay[point.state]
    return Limit(point.name, point.unit, there.low, there.high, rate, float(states[:, point.state].mean()))


def _band(subject: Subject, size: int) -> tuple[float, float]:
    """Frequencies below which `LIMITING.power` of the recorded inputs is, from the lowest that a recording can hold."""
    logs, top = subject.logs, 0.0
    for log in logs:
        x = log.inputs.numpy()[:, :size]
        power = (np.abs(np.fft.rfft(x - x.mean(0), axis=0)) ** 2).sum(1)
        if power.sum() > 0:
            share = np.cumsum(power) / power.sum()
            top = max(top, float(np.fft.rfftfreq(len(x), log.dt)[np.searchsorted(share, LIMITING.power)]))
    lowest = logs[0].rate / max(map(len, logs))
    return lowest, min(max(top, 5 * lowest), logs[0].rate / 5)
