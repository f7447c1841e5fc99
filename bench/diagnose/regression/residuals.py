"""Force and torque, or rate of change, that a model leaves out, against the conditions in which it does."""

from collections.abc import Mapping, Sequence

import numpy as np

from bench.diagnose.evidence import ResidualMap
from bench.diagnose.logs.noise import Noise
from bench.diagnose.regression.conditions import Condition
from bench.diagnose.regression.weak import Stack, TestFunctions, mean_rates
from registry.dynamics import PhysicsModel

BINS = 12
"""Of equally many samples each."""
DOTS = 1500
"""Samples kept for a scatter."""
MAPS = 8
"""Maps at most."""
EACH = 2
"""Maps of one quantity, and maps against one condition, at most."""
FOLLOWS = 0.05
"""Share of a residual's variance that its means in bins must hold."""


def residual_maps(
    model: PhysicsModel,
    after: PhysicsModel | None,
    stack: Stack,
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
    hop = max(2, window // 2)
    measured = [i for i in range(len(model.state_channels)) if all(log.measured[i] for log in stack.logs)]
    tests = TestFunctions.over(stack.logs, hop, [noise.smoothing_of(i) for i in measured])
    if not any(len(c) for c in tests.centres):
        return ()
    before = residuals(model, stack, tests, measured)
    better = {} if after is None else residuals(after, stack, tests, measured)
    found = []
    for condition in where:
        x = np.concatenate([condition.means(i, c - hop, 2 * hop + 1) for i, c in enumerate(tests.centres)])
        if len(x) < 4 * BINS:
            continue
        order = np.argsort(x, kind="stable")
        bins = np.array_split(order, BINS)
        for (quantity, unit), y in before.items():
            share = _share(y, bins)
            if share > FOLLOWS:
                later = better.get((quantity, unit))
                found.append((share, condition, quantity, unit, x, y, bins, later))
    found.sort(key=lambda f: (f[1].name not in regions, -f[0]))
    maps: list[ResidualMap] = []
    for _, condition, quantity, unit, x, y, bins, later in found:
        against = sum(m.x_signal == condition.name for m in maps)
        of = sum(m.y_quantity == quantity for m in maps)
        if len(maps) == MAPS or max(against, of) >= EACH:
            continue
        thin = slice(None, None, max(1, -(-len(x) // DOTS)))
        maps.append(
            ResidualMap(
                condition.name,
                condition.unit,
                quantity,
                unit,
                tuple(x[thin].tolist()),
                tuple(y[thin].tolist()),
                _means(x, bins),
                _means(y, bins),
                () if later is None else _means(later, bins),
                regions.get(condition.name, ""),
            )
        )
    return tuple(maps)


def residuals(
    model: PhysicsModel, stack: Stack, tests: TestFunctions, channels: Sequence[int]
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
    mean = np.concatenate(parts) / (tests.hop * stack.dt)
    logs = np.repeat(np.arange(len(tests.centres)), [len(c) for c in tests.centres])
    at = logs, np.concatenate(tests.centres)
    by_channel = {c: mean[:, i] for i, c in enumerate(columns)}
    found = model.description().residuals(stack.states[at], stack.inputs[at], by_channel)
    return {(q.name, q.unit): q.values for q in found}


def _means(values: np.ndarray, bins: Sequence[np.ndarray]) -> tuple[float, ...]:
    return tuple(float(values[b].mean()) for b in bins)


def _share(y: np.ndarray, bins: Sequence[np.ndarray]) -> float:
    """Share of the variance of y that its means in bins hold, less what chance alone gives them."""
    total = float(((y - y.mean()) ** 2).sum())
    within = sum(float(((y[b] - y[b].mean()) ** 2).sum()) for b in bins)
    if not total > 0:
        return 0.0
    return 1 - within / (len(y) - len(bins)) / (total / (len(y) - 1))
