"""What a hidden mode does, as it is drawn: what is left without it against what it tells."""

from dataclasses import replace

import numpy as np
import torch

from bench.diagnose.learn.axis_series import axis_series
from bench.diagnose.learned_shape import LearnedCurve
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.settings import SKETCHING
from registry.dynamics import PhysicsModel
from registry.effects.waves.hidden_mode import HiddenMode
from registry.terms import signals as known


def answered(subject: Subject, model: PhysicsModel, noise: Noise, place: int) -> LearnedCurve | None:
    """What is left along the first axis of the mode in ``model.effects[place]``, against what the mode tells.

    The line is where both are the same, its band twice the deviation from it. None: nothing was measured there.
    """
    mode = model.effects[place]
    assert isinstance(mode, HiddenMode)
    rest = replace(model, effects=tuple(e for e in model.effects if e is not mode))
    with torch.no_grad():
        without, beside = (
            next((s for s in axis_series(subject, m, noise) if s.axis == mode.axes[0]), None) for m in (rest, model)
        )
    if without is None or beside is None:
        return None
    left, kept = (np.concatenate([s.left for s in one.stretches]) for one in (without, beside))
    told = left - kept
    low, high = (float(np.quantile(told, q)) for q in (SKETCHING.inner, 1 - SKETCHING.inner))
    grid, half = np.linspace(low, high, SKETCHING.points), 2 * float(kept.std())
    thin = slice(None, None, max(1, len(told) // SKETCHING.dots))
    axis = mode.axes[0]
    quantity = known.quantity_of(type(model), axis)
    return LearnedCurve(
        x_signal="what the hidden mode tells",
        x_unit=without.unit,
        y_quantity=quantity,
        y_unit=without.unit,
        x=tuple(grid.tolist()),
        y=tuple(grid.tolist()),
        low=tuple((grid - half).tolist()),
        high=tuple((grid + half).tolist()),
        dots_x=tuple(told[thin].tolist()),
        dots_y=tuple(left[thin].tolist()),
    )
