"""Free runs of a model from measured states, and their error group by group."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from bench.diagnose.logs.parts import run_steps
from bench.diagnose.logs.sample import typical_length
from bench.diagnose.logs.subject import Log, LogBatch
from bench.diagnose.regression.driving import memories
from bench.diagnose.regression.weak import own_states
from bench.diagnose.settings import BEGINNING, RUNNING
from bench.diagnose.simulate.roll import roll
from bench.diagnose.simulate.unmeasured import completed, hidden
from registry.contracts import Channel
from registry.datasets.reading import cleaning
from registry.dynamics import PhysicsModel
from registry.errors import BenchError


@dataclass(frozen=True)
class Group:
    """State channels that are judged together."""

    name: str
    unit: str
    at: tuple[int, ...]
    """Places in the state."""


def groups(channels: Sequence[Channel], measured: Sequence[bool]) -> list[Group]:
    """The measured signals of a state; of an attitude the error is the angle between two [rad]."""
    found = []
    for name in dict.fromkeys(c.group for c in channels):
        at = tuple(i for i, c in enumerate(channels) if c.group == name)
        if all(measured[i] for i in at):
            found.append(Group(name, "rad" if name == "attitude" else channels[at[0]].unit, at))
    return found


def default_steps(logs: Sequence[Log], horizon_s: float | None = None) -> int:
    """Samples of a horizon, default that which suits the rate; of estimated states so many that they forget where they
    began.
    """
    if horizon_s is not None:
        return max(1, round(horizon_s * logs[0].rate))
    if hidden(logs):
        return max(RUNNING.fewest, typical_length(logs) // 4)
    return run_steps(logs[0])


def margin(logs: Sequence[Log], half_width: int) -> int:
    """Samples at either end of a log in which no free run begins, for a filter of that half width."""
    return max(half_width, BEGINNING.warm) if hidden(logs) else half_width


def starts(log: Log, steps: int, every: int, first: int = 0) -> np.ndarray:
    """Samples (W,) from which ``steps`` further ones are all valid, one every ``every``."""
    at = np.arange(first, len(log) - steps, every)
    bad = np.concatenate([[0], np.cumsum(~log.valid.numpy())])
    return at[bad[at + steps + 1] == bad[at]] if len(at) else at


def clear_starts(logs: Sequence[Log], steps: int, every: int, clear: int = 0) -> list[np.ndarray]:
    """Of each log, the samples that free runs of ``steps`` start from, none nearer than ``clear`` to invalid ones.

    Raises:
        BenchError: no log is long enough; with the longest stretch that there is.
    """
    at = [starts(log, steps + 2 * clear, every) + clear for log in logs]
    if any(map(len, at)):
        return at
    longest = max(((b - a) / log.rate for log in logs for a, b in cleaning.runs(log.valid.numpy())), default=0.0)
    whole, run = ((n / logs[0].rate if logs else math.nan) for n in (steps + 2 * clear + 1, steps))
    raise BenchError(
        f"No recording to compare with has {whole:.3g} s of valid samples in a row, which a free run of {run:.3g} s "
        f"needs. The longest stretch is {longest:.3g} s: give a shorter horizon, or longer recordings."
    )


def free_run(
    model: PhysicsModel, logs: Sequence[Log], at: Sequence[np.ndarray], steps: int, drift: Tensor | None = None
) -> Tensor:
    """Predicted states (W, steps + 1, s) from the measured ones at the samples ``at`` of each log, all logs together.

    Delays, lags and swinging loads start as the log's past says. The parameters may be tensors (B, 1, 1), for B
    models at once: then (B, W, steps + 1, s). ``drift`` is as for `roll`.
    """
    inputs = windows([log.inputs for log in logs], at, steps)
    return roll(model, past(model, logs, at), inputs, logs[0].dt, drift)[..., : len(model.state_channels)]


def past(model: PhysicsModel, logs: Sequence[Log], at: Sequence[np.ndarray]) -> Tensor:
    """Full states (…, W, full) at the samples ``at`` of each log, as its past says."""
    full = full_states(model, LogBatch.of(logs))
    return torch.cat([full[..., i, k, :] for i, k in enumerate(map(torch.as_tensor, at))], dim=-2)


def windows(series: Sequence[Tensor], at: Sequence[np.ndarray], steps: int) -> Tensor:
    """The samples (W, steps + 1, c) from each of ``at`` on, of one series (N, c) a log."""
    return torch.cat([x[k[:, None] + np.arange(steps + 1)] for x, k in zip(series, at, strict=True)])


def full_states(model: PhysicsModel, stack: LogBatch) -> Tensor:
    """Full states (…, L, N, s) at every sample: as measured, with the effects' own states and memories."""
    parts = [completed(model, stack) if hidden(stack.logs) else stack.states]
    if model.internal_size:
        parts.append(own_states(model, stack))
    if model.input_effects():
        parts.append(memories(model, stack))
    shape = max((p.shape[:-1] for p in parts), key=len)
    return torch.cat([p.expand(*shape, p.shape[-1]) for p in parts], dim=-1)


def measured_windows(logs: Sequence[Log], at: Sequence[np.ndarray], steps: int) -> Tensor:
    """What was measured (W, steps + 1, s) in the same windows."""
    return windows([log.states for log in logs], at, steps)


def between(a: Tensor, b: Tensor) -> Tensor:
    """Vector part (…, 3) of the rotation between attitudes xyzw (…, 4): its axis times the sine of half the angle."""
    return a[..., 3:] * b[..., :3] - b[..., 3:] * a[..., :3] + torch.linalg.cross(a[..., :3], b[..., :3])


def errors(predicted: Tensor, measured: Tensor, of: Sequence[Group]) -> Tensor:
    """Squared error (…, T, groups): squared Euclidean norm over a group's axes, of an attitude the squared angle."""
    out = []
    for group in of:
        at = list(group.at)
        a, b = predicted[..., at], measured[..., at]
        if group.name == "attitude":
            vector = between(a, b).norm(dim=-1)
            out.append((2 * torch.atan2(vector, (a * b).sum(-1).abs())).square())
        else:
            out.append((a - b).square().sum(-1))
    return torch.stack(out, dim=-1)


def followed(squared: Tensor, measured: Tensor, of: Sequence[Group]) -> int:
    """For how many samples free runs tell anything: in one group at least they err less than its mean would.

    Where a system is unstable the noise of the start grows until even a perfect model is lost.

    Args:
        squared: (T, groups) mean squared errors from the start of the runs on.
        measured: (W, T, s) what was measured in the same windows.
        of: the groups.

    Returns:
        1 to T − 1.
    """
    every = measured.flatten(0, 1)
    middle = every.mean(0, keepdim=True)
    for group in of:
        if group.name == "attitude":
            q = every[..., list(group.at)]
            near = torch.where((q * q[:1]).sum(-1, keepdim=True) < 0, -q, q)  # q and −q are one attitude
            middle[..., list(group.at)] = torch.nn.functional.normalize(near.mean(0, keepdim=True), dim=-1)
    spread = errors(every, middle, of).mean(0)
    lost = ~(squared < spread).any(-1)
    lost[:2] = False
    return int(lost.long().argmax()) - 1 if lost.any() else len(squared) - 1
