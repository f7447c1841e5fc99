"""Force and torque, or rate of change, that a model leaves out, against the conditions in which it does."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.diagnose.evidence import ResidualMap
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import LogBatch
from bench.diagnose.regression.conditions import Condition
from bench.diagnose.regression.test_functions import TestFunctions
from bench.diagnose.regression.weak import mean_rates
from bench.diagnose.settings import MAPPING
from registry.dynamics import PhysicsModel


def residual_maps(
    model: PhysicsModel,
    after: PhysicsModel | None,
    stack: LogBatch,
    where: Sequence[Condition],
    noise: Noise,
    window: int,
    regions: Mapping[str, str],
) -> tuple[ResidualMap, ...]:
    """Residuals against the conditions they follow most.

    Args:
        model: what leaves the residual.
        after: a better model, whose means are drawn in the same bins.
        stack: measurements.
        where: the conditions.
        noise: what the states went through.
        window: samples over which a residual is averaged.
        regions: by name of a condition, the region that it tells.
    """
    stride = max(2, window // 2)
    measured = [i for i in range(len(model.state_channels)) if all(log.measured[i] for log in stack.logs)]
    tests = TestFunctions.over(stack.logs, stride, [noise.smoothing_of(i) for i in measured])
    if not any(len(c) for c in tests.centres):
        return ()
    before = residuals(model, stack, tests, measured)
    better = {} if after is None else residuals(after, stack, tests, measured)
    found = []
    for condition in where:
        x = np.concatenate([condition.means(i, c - stride, 2 * stride + 1) for i, c in enumerate(tests.centres)])
        if len(x) >= 4 * MAPPING.bins:
            bins = np.array_split(np.argsort(x, kind="stable"), MAPPING.bins)
            every = (_Followed(condition, what, x, y, bins, better.get(what)) for what, y in before.items())
            found += [f for f in every if f.share > MAPPING.follows]
    found.sort(key=lambda f: (f.condition.name not in regions, -f.share))
    maps: list[ResidualMap] = []
    for f in found:
        against = sum(m.x_signal == f.condition.name for m in maps)
        of = sum(m.y_quantity == f.quantity[0] for m in maps)
        if len(maps) < MAPPING.maps and max(against, of) < MAPPING.each:
            maps.append(f.drawn(regions.get(f.condition.name, "")))
    return tuple(maps)


@dataclass(frozen=True, eq=False)
class _Followed:
    """A residual (J,) beside a condition."""

    condition: Condition
    quantity: tuple[str, str]
    """Name and unit."""
    x: np.ndarray
    """(J,) the condition."""
    y: np.ndarray
    bins: Sequence[np.ndarray]
    """Places of equally many samples each, by ascending condition."""
    better: np.ndarray | None
    """(J,) the residual of a better model."""

    @cached_property
    def share(self) -> float:
        """Share R² of the residual's variance that its means in bins hold, less what chance alone gives them.

        R² = 1 − Σ_b Σ_(j in b) (y_j − ȳ_b)² / (J − bins) / s², with s² the variance of y: adjusted for the means.
        """
        y = self.y
        total = float(((y - y.mean()) ** 2).sum())
        within = sum(float(((y[b] - y[b].mean()) ** 2).sum()) for b in self.bins)
        if not total > 0:
            return 0.0
        return 1 - within / (len(y) - len(self.bins)) / (total / (len(y) - 1))

    def drawn(self, region: str) -> ResidualMap:
        """As a page shows it, with no more than `MAPPING.dots` dots."""
        thin = slice(None, None, max(1, -(-len(self.x) // MAPPING.dots)))
        return ResidualMap(
            x_signal=self.condition.name,
            x_unit=self.condition.unit,
            y_quantity=self.quantity[0],
            y_unit=self.quantity[1],
            x=tuple(self.x[thin].tolist()),
            y=tuple(self.y[thin].tolist()),
            centres=self._means(self.x),
            before=self._means(self.y),
            after=() if self.better is None else self._means(self.better),
            region=region,
        )

    def _means(self, values: np.ndarray) -> tuple[float, ...]:
        return tuple(float(values[b].mean()) for b in self.bins)


def residuals(
    model: PhysicsModel, stack: LogBatch, tests: TestFunctions, channels: Sequence[int]
) -> dict[tuple[str, str], np.ndarray]:
    """Mean residuals (J,) over the windows of ``tests``, by quantity and unit.

    What the quantities are is the system's to say, `Description.residuals`.

    Args:
        model: whose rates are taken off.
        stack: measurements.
        tests: test functions for ``channels``.
        channels: measured state channels.
    """
    rates, columns = mean_rates(model, stack)[..., list(channels)].numpy(), list(channels)
    parts = []
    for i, log in enumerate(stack.logs):
        states = log.states.numpy()[:, columns]
        modelled = [tests.integral(i, c, rates[i, :, c], stack.dt) for c in range(len(columns))]
        parts.append(tests.increment(i, states) - np.stack(modelled, axis=-1))
    mean = np.concatenate(parts) / (tests.stride * stack.dt)
    logs = np.repeat(np.arange(len(tests.centres)), [len(c) for c in tests.centres])
    at = logs, np.concatenate(tests.centres)
    by_channel = {c: mean[:, i] for i, c in enumerate(columns)}
    found = model.description().residuals(stack.states[at], stack.inputs[at], by_channel)
    return {(q.name, q.unit): q.values for q in found}
