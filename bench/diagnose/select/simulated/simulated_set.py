"""A set of effects that was fitted by simulation, and how it compares with another one."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.diagnose.logs.subject import Subject
from bench.diagnose.settings import GROWING
from bench.diagnose.simulate.simulation_fit import Simulated, Windows, fit


@dataclass(frozen=True, eq=False)
class SimulatedSet:
    """A set of effects, fitted."""

    ids: tuple[str, ...]
    fitted: Simulated
    subject: Subject
    windows: Windows

    @property
    def parameters(self) -> int:
        """Numbers of the added effects."""
        return sum(not e.constant for e in self.fitted.where)

    @cached_property
    def held_out(self) -> np.ndarray:
        """(W,) squared error of each window, from fits without it."""
        count = len(self.windows.log)
        folds = np.array_split(np.arange(count), min(GROWING.folds, count))
        weights = np.ones((len(folds), count))
        for row, fold in zip(weights, folds, strict=True):
            row[fold] = 0.0
        apart = fit(self.subject, self.windows, [self.fitted] * len(folds), weights, GROWING.first)
        return np.concatenate([a.loss[f] for a, f in zip(apart, folds, strict=True)])

    def criterion(self, other: "SimulatedSet") -> float:
        """Bayes's information criterion, less that of another set."""
        free = independent(self.fitted)
        gain = free * float(np.log(self.fitted.loss.sum() / other.fitted.loss.sum()))
        return gain + (self.parameters - other.parameters) * float(np.log(free))

    def log_gain(self, other: "SimulatedSet") -> np.ndarray:
        """(W,) logarithm of how many times less squared error another set leaves in each window that was not fitted."""
        return np.asarray(np.log(np.maximum(self.held_out, 1e-300) / np.maximum(other.held_out, 1e-300)))


def independent(of: Simulated) -> float:
    """How many independent observations the errors of a fit are worth, by their correlation in time."""
    total = 0.0
    for x in of.errors.transpose(0, 2, 1).reshape(-1, of.errors.shape[1]):
        y = x - x.mean()
        own = np.correlate(y, y, "full")[len(y) - 1 :] / max(float(y @ y), 1e-300)
        until = int(np.argmax(own < 0)) or len(own)
        total += len(x) / max(1.0, 2 * float(own[:until].sum()) - 1)
    return total
