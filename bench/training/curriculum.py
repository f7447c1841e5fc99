"""Short predictions first: the length of training windows as a function of the update.

A network that does not yet predict ten steps learns nothing from two hundred, at twenty times the price.
"""

from typing import Any

from torch import Tensor

from bench.experiment.config import Training


def horizon_at(options: Training, update: int, horizon: int) -> int:
    """Steps that the windows of an update have, from 0 on: ``stages`` lengths that grow by equal factors, then all.

    Each of the shorter lengths has as many updates as the others, in the first ``grown_at`` of the budget.
    """
    first, stages = options.first_horizon, options.stages
    if not 0 < first < horizon:
        return horizon
    stage = int(update / options.updates / options.grown_at * stages)
    return horizon if stage >= stages else round(first * (horizon / first) ** (stage / stages))


def shortened(windows: tuple[Tensor, ...], steps: int) -> tuple[Any, ...]:
    """Windows (history, history, inputs (…, T, m), outputs (…, T, n)) with their first ``steps`` steps alone."""
    u_history, y_history, u, y = windows
    return u_history, y_history, u[..., :steps, :], y[..., :steps, :]
