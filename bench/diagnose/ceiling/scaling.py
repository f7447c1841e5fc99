"""The units in which networks think: each signal by its spread, each deviation by what is typical at its time."""

from dataclasses import dataclass

import torch
from torch import Tensor

from bench.diagnose.ceiling.examples import Examples
from bench.diagnose.settings import CEILING


@dataclass(frozen=True, eq=False)
class Scaling:
    """Of signals and deviations, from examples to learn from."""

    mean: Tensor
    """(c,) of the signals."""
    spread: Tensor
    """(c,) their standard deviation."""
    past: Tensor
    """(n,) typical deviations of short runs."""
    ahead: Tensor
    """(T, n) typical deviations of free runs; at their start not less than a share of those at their end."""

    @classmethod
    def of(cls, examples: Examples) -> "Scaling":
        """From finite examples."""
        known = examples.signals.flatten(0, 1)
        known = known[torch.isfinite(known).all(-1)]
        typical = examples.deviations.square().mean(0).sqrt()
        return cls(
            known.mean(0),
            _positive(known.std(0)),
            _positive(examples.history.square().mean((0, 1)).sqrt()),
            _positive(torch.hypot(typical, CEILING.start * typical[-1:])),
        )

    def shown(self, examples: Examples) -> tuple[Tensor, Tensor]:
        """Signals (W, τ + T, c) and history (W, τ, n) as a network sees them, float32; 0 where nothing is known."""
        signals = torch.nan_to_num((examples.signals - self.mean) / self.spread, nan=0.0)
        history = examples.history / self.past
        far = CEILING.far
        return signals.clamp(-far, far).float(), history.clamp(-far, far).float()


def _positive(scale: Tensor) -> Tensor:
    """With 1 in place of 0: what never varies."""
    return torch.where(scale > 0, scale, 1.0)
