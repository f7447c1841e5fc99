"""The errors of one equation on held-out recordings, and what an effect saves of them."""

import math
from dataclasses import dataclass

from bench.diagnose.settings import MATTERING


@dataclass(frozen=True)
class EquationError:
    """Root mean square errors of one equation at one horizon on held-out recordings, SI."""

    equation: str
    horizon_s: float
    unit: str
    models: dict[str, float]
    """By model."""
    predictable: float
    """What the last model leaves with the help of a regression on all measured signals."""
    floor: float
    """What measurement noise alone leaves."""
    axis: str = ""
    """Along which it is judged, such as "torque z"; empty: all together."""
    own_floor: float = 0.0
    """What noise leaves of the extended model, which may let more noise of the inputs in."""
    by_recording: tuple[float, ...] = ()
    """Of the extended model, recording by recording, less what offsets explain there; see `simulate.offsets`."""

    @property
    def explainable(self) -> float:
        """Squared error of the calibrated model that could be explained."""
        return max(self.models["calibrated"] ** 2 - self._best**2, 0.0)

    @property
    def scale(self) -> float:
        """Squared error that shares are told of: what can be explained, but no less than what would matter."""
        return max(self.explainable, (MATTERING.near**2 - 1) * self._best**2, 1e-300)

    @property
    def matters(self) -> bool:
        """Whether enough can be explained that anything is worth a term."""
        return self.models["calibrated"] > MATTERING.near * self._best

    @property
    def lost(self) -> bool:
        """Whether functions of the measured signals would predict far better than the extended model does."""
        return self.models["extended"] > MATTERING.lost * self.predictable

    @property
    def left(self) -> bool:
        """Whether more is left than noise leaves, whether or not functions of the measured signals predict it."""
        return self.models["extended"] > MATTERING.near * self.own_floor

    def worse(self, other: "EquationError") -> bool:
        """Whether the extended model errs more than another answer's in some recording, and not for noise alone.

        That is for the noise that it lets in, recordings having as much of it as any.
        """
        noisier = max(1.0, self.own_floor / other.own_floor if other.own_floor else 1.0)
        errors = [(e.models["extended"], *e.by_recording) for e in (self, other)]
        return any(mine > MATTERING.near * noisier * its for mine, its in zip(*errors, strict=True))

    def better(self, other: "EquationError") -> bool:
        """Whether it errs less than another answer by what matters, and not for an offset in each recording alone.

        An estimator's attitude is off by a constant of its own in every flight, and few flights may agree by chance.
        """
        mine, its = (math.hypot(*e.by_recording) for e in (self, other))
        return mine < its / MATTERING.near and self.models["extended"] < other.models["extended"] / MATTERING.near

    @property
    def missed(self) -> bool:
        """Whether it is lost, and the effects found explain next to nothing of it, or make it worse."""
        return self.lost and self.unexplained > 1 - MATTERING.share

    @property
    def _best(self) -> float:
        return min(self.models["extended"], self.predictable)

    @property
    def unexplained(self) -> float:
        """Share of what can be explained that the extended model leaves, 0 to 1; 0 where it is near the best."""
        if self.models["extended"] <= MATTERING.near * self.predictable:
            return 0.0
        left = self.models["extended"] ** 2 - self.predictable**2
        return left / max(self.models["calibrated"] ** 2 - self.predictable**2, left)


@dataclass(frozen=True)
class Saving:
    """What an effect saves of one equation's squared error on held-out recordings."""

    equation: str
    horizon_s: float
    share: float
    """Of what can be explained there."""
    low: float
    high: float
    """95 % over blocks of recordings."""
    matters: bool
    """Whether enough can be explained in this equation that anything is worth a term."""
    ratio: float = 1.0
    """Error with the effect, relative to that without."""
    axis: str = ""
    """Along which it is judged, such as "torque z"; empty: all together."""

    @property
    def harms(self) -> bool:
        """Whether the equation is lost by it, for sure: what other equations gain is then not understood."""
        return self.ratio > MATTERING.lost and self.high < 0

    @property
    def rescues(self) -> bool:
        """Whether the equation would be lost without it, for sure, however little that is of all that was missing."""
        return self.ratio < 1 / MATTERING.lost and self.low > 0

    @property
    def worth(self) -> bool:
        """Whether it is large enough, and sure: by its share of all, or as what keeps an equation from being lost.

        Beside a much larger effect the second one is a small share of the squared error, and most of what the first one
        leaves. Then the error itself counts: its rise without the effect, of what can be explained.
        """
        rise = (max(self.share, 0.0) * (1 - self.ratio) / (1 + self.ratio)) ** 0.5 if self.rescues else 0.0
        return self.matters and self.low > 0 and max(self.share, rise) >= MATTERING.share
