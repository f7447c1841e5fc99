"""What follows from the error of a network beside that of a model, for sure on held-out recordings.

A network that reads a history also knows better where a run starts than one noisy sample says, which saves up to the
noise floor's squared error f² and is no physics. So something is *missing* only where, of the model's squared error e²
(or that of the model with a disturbance observer, if that is smaller), the network's n² is surely less than
0.8² (e² − f²), and less than 0.8² (a² − f²) too, where a is the error of a linear autoregression that sees no inputs
(`autoregression`): what a controller holds comes back whatever the physics, and a network that does no better has
learned that, which no model of the plant alone can know. Where n² − f² is surely more than 0.8² (e² − f²), *little* is
left to learn.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.diagnose.compare import Repetition
from bench.diagnose.evidence import Predictable
from bench.diagnose.settings import CEILING, DECIDING
from bench.diagnose.simulate.free_run import Group


@dataclass(frozen=True, eq=False)
class Compared:
    """Squared errors at the last horizon."""

    squared: dict[str, np.ndarray]
    """(W, groups) of "extended", "network", "floor", "still" (nothing moves), "autoregression", and of "disturbance" if
    there is one."""
    repeated: Repetition
    groups: Sequence[Group]
    """Those that are judged, then single channels."""

    def rms(self, line: str, at: int) -> float:
        """Root mean square error of a line at horizon ``at``; NaN where there is no such line."""
        return float(self.squared[line][:, at].mean() ** 0.5) if line in self.squared else float("nan")

    def finding(self, at: int) -> str:
        """One of `Predictable.finding`."""
        e, n, f, still, auto = (
            self.squared[line][:, at] for line in ("extended", "network", "floor", "still", "autoregression")
        )
        helped = self.squared.get("disturbance", self.squared["extended"])[:, at]
        best = helped if helped.mean() < e.mean() else e
        if not np.isfinite([e, n, f]).all():
            return "open"
        if e.mean() <= max(DECIDING.high_excess * f.mean(), DECIDING.least_share * still.mean()):
            return "little"
        share = CEILING.little**2
        if self._surely(n - e):
            return "worse"
        if self._surely(share * (best - f) - n):
            return "missing" if self._surely(share * (auto - f) - n) else "autoregression"
        if self._surely(share * (e - f) - n):
            return "slow"
        return "little" if self._surely((n - f) - share * (e - f)) else "open"

    def _surely(self, positive: np.ndarray) -> bool:
        """Whether the mean of (W,) is above zero with all of its 95 % interval."""
        return bool(np.quantile(self.repeated.means(positive), 0.025) > 0)


def find(of: Compared, judged: int, horizon_s: float) -> tuple[tuple[Predictable, ...], tuple[Predictable, ...]]:
    """One finding for each of the first ``judged`` groups, and one for each channel after them."""
    every = [
        Predictable(
            group=group.name,
            horizon_s=horizon_s,
            unit=group.unit,
            model=of.rms("extended", at),
            observer=of.rms("disturbance", at),
            autoregression=of.rms("autoregression", at),
            network=of.rms("network", at),
            floor=of.rms("floor", at),
            finding=of.finding(at),
        )
        for at, group in enumerate(of.groups)
    ]
    groups, channels = every[:judged], tuple(every[judged:])
    return tuple(_placed(group, channels) for group in groups), channels


def _placed(group: Predictable, channels: Sequence[Predictable]) -> Predictable:
    """A group with the channels in which something is missing, where that is not all of them."""
    inside = [c for c in channels if c.group.partition(".")[0] == group.group]
    lacking = [c.group for c in inside if group.finding == c.finding == "missing"]
    return replace(group, own=bool(inside), axes=() if len(lacking) == len(inside) else tuple(lacking))
