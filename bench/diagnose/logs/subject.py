"""What is diagnosed: a physics model and measurements of the same system, each as the model sees it."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from bench.diagnose.logs.smoothing import Slope, Smoothing
from bench.diagnose.settings import RUNNING
from registry.contracts import Recording
from registry.datasets.folder.dataset import Folder
from registry.dynamics import PhysicsModel
from registry.errors import BenchError

_BETWEEN = "between", "missed", "finer"


@dataclass(frozen=True, eq=False)
class Log:
    """One recording as the model sees it. Everything float64, SI."""

    name: str
    rate: float
    """[Hz]."""
    states: Tensor
    """(N, s): the model's state channels; 0 where one was not measured."""
    measured: tuple[bool, ...]
    """(s,): whether a state channel was measured, and what it depends on was too."""
    inputs: Tensor
    """(N, m): the driving signal, then the model's extras."""
    valid: Tensor
    """(N,) bool."""
    recording: Recording
    estimated: tuple[bool, ...] = ()
    """(s,): channels that were not measured although all that was measured depends on them."""
    sensed: Tensor | None = None
    """(N, f): the integral over time of what sensors tell of the state's rates; None: there is no such sensor."""
    between: Tensor | None = None
    """(N − 1, s): means of the states from each sample to the next, where others between them were left out."""
    finer: Tensor | None = None
    """((N − 1) stride + 1, s): the states with those that were left out, where all of them were measured."""
    missed: Tensor | None = None
    """(N − 1, s): what the means of two samples lack as means of slopes between them; see `logs.slopes`."""
    part_of: str = ""
    """Name of the recording that it was cut from; empty: it is whole."""
    second: float = 1.0
    """Time [s] that stands for a second of flight in all that looks at stretches of time: of a vehicle a second, of a
    slow or fast machine as long as `second_of` says."""

    @property
    def means(self) -> Tensor:
        """(N − 1, s): of the states from each sample to the next."""
        if self.between is not None:
            return self.between
        own = (self.states[:-1] + self.states[1:]) / 2
        return own if self.missed is None else own + self.missed

    @property
    def dt(self) -> float:
        """Sampling period [s]."""
        return 1 / self.rate

    @property
    def pace(self) -> float:
        """Samples in what stands for a second."""
        return self.rate * self.second

    @property
    def paths(self) -> np.ndarray:
        """(N, s + f): the states, and the integrals of what was sensed, whose changes the weak form compares."""
        own = self.states.numpy()
        return own if self.sensed is None else np.concatenate([own, self.sensed.numpy()], axis=1)

    def __len__(self) -> int:
        return len(self.states)

    def _finer(self, at: slice) -> slice:
        """Where the samples of ``at``, one after the other, stand among those that were left out."""
        assert self.finer is not None
        first, last, _ = at.indices(len(self))
        stride = (len(self.finer) - 1) // max(1, len(self) - 1)
        return slice(first * stride, (last - 1) * stride + 1)

    def part(self, at: slice, name: str) -> "Log":
        """Some of the samples, one after the other, as a log of this name."""
        return replace(
            self,
            name=name,
            states=self.states[at],
            inputs=self.inputs[at],
            valid=self.valid[at],
            sensed=None if self.sensed is None else self.sensed[at],
            between=None if self.between is None else self.between[at][: len(self.states[at]) - 1],
            finer=None if self.finer is None else self.finer[self._finer(at)],
            missed=None if self.missed is None else self.missed[at][: len(self.states[at]) - 1],
            recording=self.recording.part(at, name),
        )


@dataclass(frozen=True, eq=False)
class LogBatch:
    """Logs of one rate side by side, the shorter ones padded with their last sample."""

    logs: tuple[Log, ...]
    states: Tensor
    """(L, N, s)."""
    inputs: Tensor
    """(L, N, m)."""
    dt: float
    means: Tensor | None = None
    """(L, N − 1, s): of the states from each sample to the next, of recordings that were thinned out."""
    missed: Tensor | None = None
    """(L, N − 1, s): see `Log.missed`."""
    finer: Tensor | None = None
    """(L, (N − 1) stride + 1, s): see `Log.finer`."""
    noise: tuple[float, ...] = ()
    """(s,) 1σ of the states; empty: not known."""

    def samples(self, x: Tensor) -> Tensor:
        """Those (…, n, c) of series (…, L, N, c) that are no padding, one log after the other."""
        return torch.cat([x[..., i, : len(log), :] for i, log in enumerate(self.logs)], dim=-2)

    @property
    def between(self) -> Tensor:
        """Means (L, N − 1, s) of the states from each sample to the next: of these, or of all that were left out."""
        if self.means is not None:
            return self.means
        own = (self.states[:, :-1] + self.states[:, 1:]) / 2
        return own if self.missed is None else own + self.missed

    @property
    def good(self) -> Tensor:
        """(L, N − 1): whether both samples of an interval are valid, and are no padding."""
        good = torch.zeros(self.states.shape[0], self.states.shape[1] - 1, dtype=torch.bool)
        for i, log in enumerate(self.logs):
            good[i, : len(log) - 1] = log.valid[:-1] & log.valid[1:]
        return good

    @property
    def sensed(self) -> bool:
        """Whether every log has what sensors tell of the rates."""
        return bool(self.logs) and all(log.sensed is not None for log in self.logs)

    @property
    def paths(self) -> np.ndarray:
        """(L, N, s + f): `Log.paths` side by side, with the states of this stack."""
        if not self.sensed:
            return self.states.numpy()
        sensed = _padded([log.sensed for log in self.logs if log.sensed is not None])
        return torch.cat([self.states, sensed], dim=-1).numpy()

    @property
    def measured(self) -> tuple[int, ...]:
        """Places of what was measured in every log, among the model's `measured_channels`."""
        return measured(self.logs)

    @classmethod
    def of(cls, logs: Sequence[Log]) -> "LogBatch":
        """Of logs of one rate.

        Raises:
            BenchError: they were sampled at different rates.
        """
        rates = {log.rate for log in logs}
        if len(rates) != 1:
            raise BenchError(f"The recordings were sampled at {sorted(rates)} Hz: resample them to one rate first.")
        states, inputs = (_padded([getattr(log, what) for log in logs]) for what in ("states", "inputs"))
        means, missed, finer = (
            _padded(given) if len(given) == len(logs) else None
            for given in ([x for x in (getattr(log, what) for log in logs) if x is not None] for what in _BETWEEN)
        )
        return cls(tuple(logs), states, inputs, logs[0].dt, means, missed, finer)


def measured(logs: Sequence[Log]) -> tuple[int, ...]:
    """Places of what was measured in every log, among the model's `measured_channels`."""
    states = logs[0].states.shape[-1]
    own = [i for i in range(states) if all(log.measured[i] for log in logs)]
    first = logs[0].sensed
    told = 0 if first is None or any(log.sensed is None for log in logs) else first.shape[1]
    return (*own, *(states + i for i in range(told)))


def _padded(series: Sequence[Tensor]) -> Tensor:
    """Series (N_i, c) side by side (L, N, c), the shorter ones padded with their last sample."""
    longest = max(map(len, series))
    return torch.stack([torch.cat([x, x[-1:].expand(longest - len(x), -1)]) for x in series])


@dataclass(frozen=True, eq=False)
class Subject:
    """A model and measurements to compare it with."""

    name: str
    model: PhysicsModel
    """With nominal constants."""
    logs: tuple[Log, ...]
    training: tuple[str, ...]
    """Names of the recordings that may be fitted."""
    held_out: tuple[str, ...]
    """Names of the recordings that only test."""
    smoothing: Smoothing | None = None
    """As stated; None: to be estimated."""
    noise: dict[str, float] = field(default_factory=dict)
    """1σ before smoothing, by signal, SI, as stated, or as slopes were read from it."""
    uncertainty: dict[str, float] = field(default_factory=dict)
    """Relative 1σ of the model's constants where it differs from the model's own."""
    signals: tuple[str, ...] = ()
    """Signals that were measured in every recording."""
    differences: tuple[str, ...] = ()
    """Rates that were computed as differences of their signals, and so have no clock of their own."""
    commands: str = ""
    """The recorded signal that asked for the measured drive, as stated; see `select.timing.commanded`."""
    timed: bool = False
    """Whether the inputs are read at the times at which they act; see `select.timing.reading`."""
    parted: bool = False
    """Whether it is settled which parts are learnt from; see `logs.parts`."""
    memory: int | None = None
    """Order of the autoregression that whitens what a model leaves, where a search settled it; 0: none."""
    long_windows: bool = False
    """Whether a search settled that rates are compared over windows as long as a free run."""
    notes: tuple[str, ...] = ()
    """What was done to the measurements, in sentences."""
    warned: tuple[str, ...] = ()
    """Those of them that say what these recordings cannot tell, for who only checks them."""
    resampled: tuple[str, ...] = ()
    """Those of them that say where samples are not as they were logged."""
    left_out: tuple[str, ...] = ()
    """Names of the recordings that are too short to judge a model by, where others are not."""
    folder: Folder | None = None
    """Where they were read from, if a dataset.toml describes them."""
    finer: dict[str, str] = field(default_factory=dict)
    """By signal, the option of the data set that reads it from a finer sensor."""
    slopes: dict[int, Slope] = field(default_factory=dict)
    """States that were not measured and are slopes of others, by place; see `logs.slopes`."""

    def of(self, names: Sequence[str]) -> tuple[Log, ...]:
        """The logs of these names, in order."""
        by_name = {log.name: log for log in self.logs}
        return tuple(by_name[n] for n in names)

    @property
    def system(self) -> str:
        """Registered name of the model, or its class."""
        return type(self.model).system_name()


def log_of(recording: Recording, model: PhysicsModel, drive: str, longest: float | None = None) -> Log:
    """A recording in the order of the model's states and inputs.

    Args:
        recording: measurements.
        model: with these states and inputs.
        drive: the signal that drives it.
        longest: how long the longest recording beside it is [s]; None: no longer.

    Raises:
        BenchError: a signal that the model needs was not measured.
    """
    by_name = {c.name: i for i, c in enumerate(recording.channels)}
    columns = np.concatenate([recording.inputs, recording.outputs], axis=1).astype(np.float64)
    picks = [by_name.get(c.name) for c in model.state_channels]
    if all(p is None for p in picks):
        raise BenchError(
            f"Recording {recording.name} holds none of the states of the model: "
            f"{', '.join(dict.fromkeys(c.group for c in model.state_channels))}."
        )
    zeros = np.zeros(len(recording))
    states = np.stack([zeros if p is None else columns[:, p] for p in picks], axis=1)
    driving = recording.pick([drive])[0] if type(model).input_signals else columns[:, :0]
    extras = [
        recording.begins + np.arange(len(recording)) / recording.rate
        if name == "time"
        else recording.pick([name])[0][:, 0]
        for name in model.extras
    ]
    inputs = np.concatenate([driving, *(e[:, None] for e in extras)], axis=1)
    if "attitude" in {c.group for c in model.state_channels}:
        at = [i for i, c in enumerate(model.state_channels) if c.group == "attitude"]
        states[:, at] = _continuous(states[:, at])
        if not any(p is not None for p in (picks[i] for i in at)):
            states[:, at[-1]] = 1.0  # level
    measured = tuple(p is not None for p in picks)
    known = self_contained(model, measured)
    longest = len(recording) / recording.rate if longest is None else longest
    return Log(
        name=recording.name,
        rate=recording.rate,
        states=torch.from_numpy(states),
        measured=known if any(known) else measured,
        inputs=torch.from_numpy(np.ascontiguousarray(inputs, dtype=np.float64)),
        valid=torch.from_numpy(recording.valid.copy()),
        recording=recording,
        estimated=() if any(known) else tuple(not m for m in measured),
        sensed=_sensed(recording, model),
        second=1.0 if model.vehicle else second_of(recording.rate, longest),
    )


def second_of(rate: float, longest: float) -> float:
    """Time [s] that stands for a second of a machine of any speed: of a heated house hours, of a circuit milliseconds.

    A second where its free runs are no shorter than they may be, else as long as these: a machine that is slower by any
    factor, and logged as often in its own time, is looked at over times that are longer by this factor. No longer than
    the longest recording.

    Args:
        rate: of the log [Hz].
        longest: how long the longest recording is [s].
    """
    return max(RUNNING.fewest / RUNNING.longest / rate, min(1.0, longest))


def _sensed(recording: Recording, model: PhysicsModel) -> Tensor | None:
    """The integral (N, f) of what the model's sensors recorded; None: they did not."""
    names = {c.name for c in recording.channels}
    if not model.sensed_channels or not all(c.name in names for c in model.sensed_channels):
        return None
    shown = recording.pick(list(dict.fromkeys(c.group for c in model.sensed_channels)))[0].astype(np.float64)
    shown = np.where(np.isfinite(shown), shown, 0.0)  # where it is not, the recording is not valid
    parts = (shown[1:] + shown[:-1]) / (2 * recording.rate)
    return torch.from_numpy(np.concatenate([np.zeros_like(shown[:1]), np.cumsum(parts, axis=0)]))


def drives_of(model: PhysicsModel, log: Log) -> int:
    """Channels of the driving signal among a log's inputs."""
    return log.inputs.shape[1] - len(model.extras)


def named_drive(log: Log, place: int) -> str:
    """A channel of what drives the system in words, with its axis where there are several."""
    channels = log.recording.input_channels
    one = sum(c.group == channels[place].group for c in channels) == 1
    return (channels[place].group if one else channels[place].name).replace(".", " ").replace("_", " ")


def self_contained(model: PhysicsModel, measured: Sequence[bool]) -> tuple[bool, ...]:
    """Which measured states (s,) depend on measured ones only, by way of others too: what can be run free."""
    if all(measured):
        return tuple(measured)
    size, generator = len(measured), torch.Generator().manual_seed(0)
    width = model.driving_channels + len(model.extras)
    state = 0.5 + torch.rand(size + model.internal_size, generator=generator, dtype=torch.float64)
    given = torch.full((width,), 0.5, dtype=torch.float64)
    slopes = torch.autograd.functional.jacobian(lambda x: model.derivative(x, given)[:size], state)[:, :size]
    depends, known = (slopes != 0).numpy(), np.array(measured)
    for _ in range(size):
        known &= ~(depends & ~known).any(axis=1)
    return tuple(bool(k) for k in known)


def _continuous(quaternions: np.ndarray) -> np.ndarray:
    """Unit quaternions (N, 4) without jumps between q and −q."""
    flips = np.cumprod(np.where((quaternions[1:] * quaternions[:-1]).sum(1) < 0, -1.0, 1.0))
    out: np.ndarray = quaternions * np.concatenate([[1.0], flips])[:, None]
    return out
