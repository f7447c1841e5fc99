"""The conditions in which a system is met: what a region of its errors is told in."""

import numpy as np

from bench.diagnose.logs.subject import LogBatch
from registry.dynamics import PhysicsModel, Quantity


class Condition(Quantity):
    """A quantity (L, N) at every sample; at invalid samples and beyond the end of a log it means nothing."""

    def means(self, log: int, first: np.ndarray, samples: int) -> np.ndarray:
        """Means (W,) over ``samples`` samples from each of ``first`` on."""
        known = np.nan_to_num(self.values[log])  # invalid samples, which no window touches
        sums = np.concatenate([[0.0], np.cumsum(known)])
        return np.asarray((sums[first + samples] - sums[first]) / samples)


def conditions(model: PhysicsModel, stack: LogBatch) -> list[Condition]:
    """Every condition that was measured and that varies."""
    drives, log = stack.inputs.shape[-1] - len(model.extras), stack.logs[0]
    own = model.description().conditions(
        stack.states, stack.inputs, stack.dt, log.measured, log.recording.input_channels[:drives]
    )
    found = [Condition(q.name, q.unit, q.values) for q in own]
    names = {"battery": ("battery voltage", "V"), "time": ("time since the start", "s")}
    for i, extra in enumerate(model.extras):
        found.append(Condition(*names.get(extra, (extra, "1")), stack.inputs[..., drives + i].numpy()))
    return [c for c in found if np.isfinite(c.values).any() and np.nanmax(c.values) > np.nanmin(c.values)]
