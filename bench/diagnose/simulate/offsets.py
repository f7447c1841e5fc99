"""What offsets of a recording's own explain of its errors: of each axis, and of the attitude.

An estimator levels itself in every flight anew, and a set of markers is mounted anew: the attitude is off by a constant
then, which looks like a force that goes with the thrust. Few recordings may agree in it by chance.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import LogBatch
from bench.diagnose.simulate.teacher_forced import Increments, increments
from registry.dynamics import PhysicsModel
from registry.dynamics.rotations import quaternion_rate

ANGLE = 1e-3
"""By which an attitude is turned to see what that does [rad]."""


def attitude_offsets(model: PhysicsModel, stack: LogBatch, noise: Noise) -> tuple[Increments, ...]:
    """What increments lack once the attitude, if any, is turned by a constant about each axis of the body."""
    turning = model.description().turning
    if turning is None:
        return ()
    at = [i for i, c in enumerate(model.state_channels) if c.group == turning[0]]
    before, out = increments(model, stack, noise), []
    for axis in torch.eye(3, dtype=stack.states.dtype) * ANGLE:
        states, attitude = stack.states.clone(), stack.states[..., at]
        states[..., at] = attitude + quaternion_rate(attitude, axis)
        logs = tuple(replace(log, states=x[: len(log)]) for log, x in zip(stack.logs, states, strict=True))
        after = increments(model, replace(stack, logs=logs, states=states), noise)
        out.append(Increments(after.steps - before.steps, before.valid))
    return tuple(out)


def less_offsets(errors: np.ndarray, offsets: Sequence[np.ndarray], recording: np.ndarray) -> tuple[float, ...]:
    """Root mean square errors in each recording, less what constants and these offsets explain there.

    Args:
        errors: over windows, along each axis (W, a).
        offsets: what one offset each does to them (W, a).
        recording: of each window (W,).
    """
    out = []
    for i in np.unique(recording):
        own = errors[recording == i]
        constants = np.tile(np.eye(own.shape[1]), (len(own), 1))
        columns = np.column_stack([constants, *(o[recording == i].ravel() for o in offsets)])
        left = own.ravel() - columns @ np.linalg.lstsq(columns, own.ravel(), rcond=1e-9)[0]
        out.append(float((left**2).sum() / len(own)) ** 0.5)
    return tuple(out)
