"""What the measured signals of a log say about each other, without physics and with it."""

from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import median_filter

from bench.diagnose.logs.subject import Log
from bench.diagnose.settings import READING
from registry.datasets.reading.cleaning import widen
from registry.dynamics import PhysicsModel

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Pair:
    """A signal and the one that is its time derivative."""

    signal: str
    rate: str
    channels: tuple[int, ...]
    """Of the signal, among the model's states; four of an attitude."""
    rates: tuple[int, ...]
    """Of its derivative, axis by axis; about the body's axes where the signal is an attitude."""
    axes: tuple[str, ...]

    @property
    def turns(self) -> bool:
        """Whether the signal is an attitude, a unit quaternion."""
        return len(self.channels) == 4


def pairs(model: PhysicsModel, measured: tuple[bool, ...]) -> list[Pair]:
    """The pairs among the measured states: an attitude and what turns it, and every state whose rate is another."""
    names = [c.group for c in model.state_channels]
    out = []
    if turns := model.description().turning:
        turned, turning = (tuple(i for i, n in enumerate(names) if n == s) for s in turns)
        axes = tuple(model.state_channels[i].axis for i in turning)
        out = [Pair(*turns, turned, turning, axes)]
    grouped: dict[tuple[str, str], list[tuple[int, int]]] = {}
    for i, j in _integrals(model):
        grouped.setdefault((names[i], names[j]), []).append((i, j))
    for (signal, rate), found in grouped.items():
        axes = tuple(model.state_channels[i].axis for i, _ in found)
        out.append(Pair(signal, rate, tuple(i for i, _ in found), tuple(j for _, j in found), axes))
    return [p for p in out if all(measured[i] for i in (*p.channels, *p.rates))]


def _integrals(model: PhysicsModel) -> list[tuple[int, int]]:
    """States i whose derivative is state j itself, whatever the states and inputs: found by trying three."""
    generator = torch.Generator().manual_seed(0)
    size = len(model.state_channels)
    state = 0.5 + torch.rand(3, size + model.internal_size, generator=generator, dtype=torch.float64)
    width = drives(model) + len(model.extras)
    with torch.no_grad():
        rate = model.derivative(state, torch.full((3, width), 0.5, dtype=torch.float64))
    same = (rate[:, :size, None] == state[:, None, :size]).all(dim=0)
    return [(int(i), int(j)) for i, j in same.nonzero() if i != j]


def drives(model: PhysicsModel) -> int:
    """Number of driving channels."""
    return model.driving_channels


def conjugate_product(a: Array, b: Array) -> Array:
    """a⁻¹ ⊗ b as a rotation vector (N, 3) [rad], of unit quaternions xyzw (N, 4)."""
    av, aw, bv, bw = -a[:, :3], a[:, 3:], b[:, :3], b[:, 3:]
    v = aw * bv + bw * av + np.cross(av, bv)
    w = aw * bw - (av * bv).sum(axis=1, keepdims=True)
    v, w = np.where(w < 0, -v, v), np.abs(w)
    size = np.linalg.norm(v, axis=1, keepdims=True)
    return 2 * v * np.where(size > 1e-9, np.arctan2(size, w) / np.maximum(size, 1e-12), 1.0)


def within(usable: Array, length: int) -> Array:
    """Windows (N − length,) of which every sample is usable."""
    bad = np.concatenate([[0], np.cumsum(~usable)])
    return np.asarray(bad[length + 1 :] == bad[: -length - 1])


def change(x: Array, turns: bool, lag: int = 1) -> Array:
    """By how much a signal (N, c) changes over ``lag`` samples (N − lag, c or 3)."""
    return conjugate_product(x[:-lag], x[lag:]) if turns else x[lag:] - x[:-lag]


def integral(rate: Array, dt: float) -> Array:
    """∫ rate dt over each step (N − 1, c) of a smooth rate (N, c), to the fourth order."""
    out = (rate[1:] + rate[:-1]) / 2
    out[1:-1] += (rate[1:-2] + rate[2:-1] - rate[:-3] - rate[3:]) / 24
    return out * dt


def beyond_rate(x: Array, pair: Pair, dt: float) -> Array:
    """By how much a signal changes over each step of states (N, s) beyond what its rate says (N − 1, axes)."""
    return change(x[:, pair.channels], pair.turns) - integral(x[:, pair.rates], dt)


def slope(x: Array, turns: bool, dt: float) -> Array:
    """Rate of a signal (N, c) at every sample, from its neighbours (N, c or 3)."""
    middle = change(x, turns, 2) / (2 * dt)
    return np.concatenate([middle[:1], middle, middle[-1:]])


def accumulated(steps: Array) -> Array:
    """Steps (N − 1, c) summed up, from zero (N, c)."""
    return np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])


def outlying(y: Array) -> Array:
    """How far each sample (N, c) is from the median of those around it."""
    out: Array = y - median_filter(y, size=(2 * READING.half_width + 1, 1), mode="mirror")
    return out


def correlation(a: Array, b: Array) -> float:
    """Of two signals (K,) about their means; 0 where one of them is constant."""
    return float(np.corrcoef(a, b)[0, 1]) if min(float(a.std()), float(b.std())) > 0 else 0.0


def spread(x: Array) -> Array:
    """1σ of the columns (c,) of (N, c) as the median of their size has it."""
    out: Array = 1.4826 * np.median(np.abs(x), axis=0) if len(x) else np.zeros(x.shape[1:])
    return out


def modelled(model: PhysicsModel, log: Log, inputs: Array | None = None) -> Array:
    """dx/dt (N, s) as the model has it at the measured states, without memories of effects."""
    given = log.inputs if inputs is None else torch.from_numpy(inputs)
    width = len(model.state_channels)
    state = torch.cat([log.states, log.states.new_zeros(len(log), model.internal_size)], dim=1)
    rates = torch.zeros_like(given)
    if model.input_hold == "linear" and len(given) > 2:
        rates = torch.gradient(given, spacing=log.dt, dim=0)[0]
    with torch.no_grad():
        out: Array = model.derivative(state, given, rates)[:, :width].numpy()
    return out


class View:
    """A log while it is checked: faults that were found are taken out of it."""

    def __init__(self, model: PhysicsModel, log: Log) -> None:
        self.model, self.log, self.dt = model, log, log.dt
        self.drive = log.recording.input_channels[0].group if log.recording.input_channels else ""
        self.x = log.states.numpy().copy()
        self.driving = log.inputs.numpy()[:, : log.inputs.shape[1] - len(model.extras)].copy()
        self.pairs = pairs(model, log.measured)
        self.rates = modelled(model, log)
        self.usable = _inside(log.valid.numpy())

    def ignore(self, rows: tuple[int, int]) -> None:
        """Leave these rows and their neighbours out of what follows."""
        self.usable[max(0, rows[0] - READING.ends) : rows[1] + READING.ends + 1] = False

    def steps(self, pair: Pair) -> Array:
        """By how much the signal changes over each step beyond what its rate says (N − 1, axes)."""
        return beyond_rate(self.x, pair, self.dt)

    def beyond_model(self, channels: tuple[int, ...]) -> Array:
        """By how much states change over each step beyond what the model says (N − 1, len)."""
        return change(self.x[:, channels], False) - integral(self.rates[:, channels], self.dt)


def _inside(valid: Array) -> Array:
    """Valid samples (N,) with enough valid ones around them."""
    return ~widen(np.concatenate([[True], ~valid, [True]]), READING.ends)[1:-1]
