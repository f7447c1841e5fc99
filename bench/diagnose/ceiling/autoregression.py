"""A forecast that sees neither inputs nor a model: a linear regression on the measured state in which a run starts.

What a controller holds comes back by itself, as far as anybody knows who does not look at its commands. A network shown
such recordings learns that too, which is no physics that a model of the plant lacks. In verification of forecasts it is
the usual reference beside persistence and the mean (damped persistence; Murphy 1992, Weather and Forecasting 7(4)),
both of which it contains.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from bench.diagnose.ceiling.deviation import corrected, deviation
from bench.diagnose.logs.subject import Log
from bench.diagnose.simulate.free_run import Group, measured_windows
from registry.dynamics import rotation_matrix

Runs = tuple[Sequence[Log], Sequence[np.ndarray]]
"""Recordings, and the samples of each that runs start from."""


def autoregression(learned: Runs, judged: Runs, steps: int, groups: Sequence[Group]) -> Tensor:
    """States (W, steps + 1, s) of runs, each sample of the horizon with least-squares coefficients of its own.

    Args:
        learned: what the coefficients come from.
        judged: what is forecast.
        steps: samples of the horizon.
        groups: measured signals: of these are the starts, and what is forecast. The rest stays as it is.
    """
    known = measured_windows(*learned, steps)
    moved = deviation(known[:, :1].expand_as(known[:, 1:]), known[:, 1:], groups)  # (N, steps, n)
    gains = torch.linalg.lstsq(_start(known[:, 0], groups), moved.flatten(1), driver="gelsd").solution
    first = measured_windows(*judged, steps)[:, :1]
    by = (_start(first[:, 0], groups) @ gains).unflatten(1, moved.shape[1:])
    return torch.cat([first, corrected(first.expand(-1, steps, -1), by, groups)], dim=1)


def _start(state: Tensor, groups: Sequence[Group]) -> Tensor:
    """Regressors (W, c) of a state (W, s): one, and what was measured; of an attitude the rotation matrix."""
    parts = [torch.ones_like(state[:, :1])]
    for group in groups:
        own = state[:, list(group.at)]
        parts.append(rotation_matrix(own).flatten(-2) if group.name == "attitude" else own)
    return torch.cat(parts, dim=-1)
