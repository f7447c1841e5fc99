"""Where a search for an effect's parameters starts: at shares of what was recorded."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from torch import Tensor

from bench.diagnose.logs.subject import Log
from bench.diagnose.regression.parameters import Entry
from bench.diagnose.settings import LINEARISING
from registry.dynamics import DryEffect, Effect, PhysicsModel
from registry.effects.actuation import LONGEST_DELAY


@dataclass(frozen=True)
class StartingPoints:
    """The starting points of every effect in one model on some recordings."""

    model: PhysicsModel
    sizes: Mapping[str, float]
    """How large the signals of `PhysicsModel.followed` became, SI, and the "time_scale" [s]: that of a machine which is
    seen to move, of others `PhysicsModel.time_scale`. Of a machine also its "travel" from end to end; of what is no
    vehicle the "second" (`Log.second`) and the "longest_delay" that is looked for [s], of what turns the "turn" [rad].
    """
    medians: Mapping[str, float]
    """Of the model's extras."""
    noise: Sequence[float] = ()
    """(s,) 1σ of the states as recorded; empty: not known."""

    @classmethod
    def of(
        cls, model: PhysicsModel, states: Tensor, inputs: Tensor, log: Log, noise: Sequence[float] = ()
    ) -> "StartingPoints":
        """In ``model``, to which effects are added, on states proper (…, s) and inputs (…, m) sampled as ``log`` is."""
        first = inputs.shape[-1] - len(model.extras)
        medians = {name: float(inputs[..., first + i].median()) for i, name in enumerate(model.extras)}
        followed, largest = model.followed(states, inputs), LINEARISING.largest
        sizes = {name: float(np.quantile(np.abs(x.numpy()), largest)) for name, x in followed.items()}
        moves = sizes.get("displacement") and sizes.get("speed")
        if moves:
            sizes["travel"] = float(np.ptp(np.quantile(followed["displacement"].numpy(), (1 - largest, largest))))
        time = sizes["displacement"] / sizes["speed"] if moves else model.time_scale(states, inputs)
        sizes["time_scale"] = time
        if not model.vehicle:
            longest = max(LONGEST_DELAY * log.second, min(time, LINEARISING.remembered * log.dt))
            sizes |= {"second": log.second, "longest_delay": longest}
        if model.effect_unit("m") == "rad":
            sizes["turn"] = 2 * np.pi
        return cls(model, sizes, medians, noise)

    def neutral(self, kind: type[Effect]) -> list[Effect]:
        """Neutral for an effect that is linear in its parameters, else one a value of its search grid."""
        neutral = self._seen(kind.neutral_for(self.model, self.medians).sized(self.sizes, fitted=False))
        return [replace(neutral, **values) for values in self._grid(kind)]

    def felt(self, kind: type[Effect]) -> list[Effect]:
        """One a value of its search grid, all else as met in practice, so that every parameter is felt."""
        typical = self._seen(kind.typical_for(self.model).sized(self.sizes))
        return [replace(typical, **values) for values in self._grid(kind)]

    def _seen(self, effect: Effect) -> Effect:
        return effect.seen_through(self.model, self.noise) if self.noise and isinstance(effect, DryEffect) else effect

    def reach(self, kind: type[Effect], entry: Entry) -> tuple[float, float]:
        """Between which values an effect linearised at ``entry`` is believed: to the next ones of its search grid."""
        grid = kind.grid(self.sizes).get(entry.name, ())
        below, above = [v for v in grid if v < entry.value], [v for v in grid if v > entry.value]
        return max(below, default=entry.low), min(above, default=entry.high)

    def _grid(self, kind: type[Effect]) -> list[dict[str, Any]]:
        """Parameters of the search grid, all combinations; of an effect without one a single empty one."""
        grid = kind.grid(self.sizes)
        return [dict(zip(grid, values, strict=True)) for values in product(*grid.values())]
