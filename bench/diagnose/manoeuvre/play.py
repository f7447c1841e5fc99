"""Manoeuvres played through a model: driven open loop, by a pilot, or let go from a state."""

from dataclasses import dataclass
from typing import cast

import numpy as np
import torch
from torch import Tensor

from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.manoeuvre.limits import Limits
from bench.diagnose.manoeuvre.waveform import PARAMETERS, signals
from bench.diagnose.settings import COMPOSING
from bench.diagnose.simulate.floor import measure
from registry.contracts import Recording
from registry.dynamics import PhysicsModel


@dataclass(frozen=True, eq=False)
class Played:
    """W manoeuvres, of R runs each."""

    asked: np.ndarray
    """(W, R, N, c): inputs or set-points, as `Limits.drives`; of an undriven system (W, R, 1, s) its starts."""
    inputs: Tensor
    """(W · R, N, m) as the model takes them."""
    states: Tensor
    """(W · R, N, s)."""

    def outside(self, limits: Limits) -> np.ndarray:
        """(W,): by how much of their spans the states leave their limits, infinite where they run away."""
        worst = np.zeros(len(self.asked))
        for i, limit in enumerate(limits.states):
            if np.isfinite(limit.low) and limit.span > 0:
                x = self.states[..., i].reshape(len(worst), -1).numpy()
                over = np.maximum(x - limit.high, limit.low - x).max(1) / limit.span
                worst = np.maximum(worst, np.nan_to_num(over, nan=np.inf))
        return worst


class Player:
    """Plays manoeuvres that are given by parameters in 0..1, or as signals."""

    def __init__(self, subject: Subject, limits: Limits, samples: int, noise: Noise) -> None:
        self.subject, self.limits, self.samples, self.noise = subject, limits, samples, noise
        self.model, self.log = subject.model, subject.logs[0]
        self.dt = self.log.dt
        self.driven = self.log.inputs.shape[1] > len(self.model.extras)
        self.size = len(limits.drives) * PARAMETERS if self.driven else COMPOSING.releases * len(limits.drives)
        """Parameters of a manoeuvre."""
        extras = [log.inputs.numpy()[:, log.inputs.shape[1] - len(self.model.extras) :] for log in subject.logs]
        self._still = np.concatenate(extras).mean(0)
        self._first = torch.stack([log.states[0] for log in subject.logs]).mean(0)

    def asked(self, z: np.ndarray) -> np.ndarray:
        """What is asked for (W, R, N, c), or the starts (W, R, 1, s), by parameters (W, size)."""
        drives = self.limits.drives
        if self.driven:
            return signals(z, drives, self.samples, self.dt, self.limits.band)[:, None]
        low, span = (np.array([getattr(d, what) for d in drives]) for what in ("low", "span"))
        return np.asarray(low + span * z.reshape(len(z), COMPOSING.releases, 1, len(drives)))

    def play(self, model: PhysicsModel, asked: np.ndarray) -> Played:
        """What is asked for, played through ``model``, whose parameters are numbers."""
        flat = asked.reshape(-1, *asked.shape[2:])
        if pilot := model.pilot():
            driving, states = pilot.flown(flat, self._extras(len(flat)), self.dt)
            return Played(asked, self._with_extras(driving), states)
        start = self._first.expand(len(flat), -1) if self.driven else torch.from_numpy(flat[:, 0].copy())
        driving = torch.from_numpy(flat.copy()) if self.driven else start.new_zeros(len(flat), self.samples, 0)
        inputs = self._with_extras(driving)
        return Played(asked, inputs, model.simulate(start, inputs, self.dt))

    def _extras(self, count: int) -> Tensor:
        """Extra inputs (count, N, e): time advances, every other one is held at its mean over the recordings."""
        out = torch.from_numpy(self._still).expand(count, self.samples, -1).clone()
        if "time" in self.model.extras:
            out[..., self.model.extras.index("time")] = torch.arange(self.samples, dtype=torch.float64) * self.dt
        return out

    def _with_extras(self, driving: Tensor) -> Tensor:
        return torch.cat([driving, self._extras(len(driving))], dim=-1)

    def logs(self, played: Played) -> list[Log]:
        """The runs as logs, with the noise and the smoothing of the recordings: the same noise at every call."""
        log, channels = self.log, self.model.state_channels
        margin = self.noise.half_width
        there = slice(margin, self.samples - margin)
        generator = np.random.default_rng(0)
        seen = measure(played.states, self.noise, channels, self.dt, generator)
        good = torch.ones(seen.shape[1], dtype=torch.bool)
        return [
            Log(
                name="",
                rate=log.rate,
                states=x,
                measured=log.measured,
                inputs=u[there],
                valid=good,
                recording=cast(Recording, None),
                estimated=log.estimated,
            )
            for x, u in zip(seen, played.inputs, strict=True)
        ]
