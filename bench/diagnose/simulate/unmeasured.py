"""States that no sensor saw but on which measured ones depend: a model's own simulation stands in for them.

The measured states are put in place at every sample, so that the others are carried by the model alone; where they
began is sought, so that the measured states of the first samples are met.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from bench.diagnose.logs.subject import Log, LogBatch
from bench.diagnose.regression.driving import how_many, narrowed
from bench.diagnose.settings import BEGINNING
from bench.diagnose.simulate.roll import passed, roll
from registry.dynamics import PhysicsModel
from registry.equations import models


def hidden(logs: Sequence[Log]) -> tuple[int, ...]:
    """Places in the state of what must be estimated: none where the measured states are enough."""
    return tuple(i for i, e in enumerate(logs[0].estimated) if e)


def completed(model: PhysicsModel, stack: LogBatch) -> Tensor:
    """States (…, L, N, s): as measured, and as the model carries those that were not."""
    at = hidden(stack.logs)
    path = _carried(model, beginning(model, stack), stack.states, stack.inputs, stack.dt, at)
    out = stack.states.expand(*path.shape[:-1], stack.states.shape[-1]).clone()
    out[..., list(at)] = path
    return out


def beginning(model: PhysicsModel, stack: LogBatch) -> Tensor:
    """Full states (…, L, full) at the first samples, from which a free run meets the first measurements."""
    places = hidden(stack.logs)
    at, size = list(places), stack.states.shape[-1]
    seen = [i for i in range(size) if i not in at and stack.logs[0].measured[i]]
    logs, many, narrow = len(stack.logs), how_many(model), narrowed(model)
    shape = (logs,) if many is None else (many, logs)
    span = min(BEGINNING.warm, stack.states.shape[1] - 1)
    first = stack.states[:, 0].expand(*shape, size).clone()
    resting = narrow.initial(first, stack.inputs[:, 0].expand(*shape, stack.inputs.shape[-1]), stack.dt)
    guess = _settled(model, resting, stack, places)
    measured = stack.states[:, 1 : span + 1, seen]

    def misfit(of: Tensor) -> Tensor:
        """(…, H + 1, L, span · seen) of beginnings (…, H + 1, L, H)."""
        count = of.shape[-3]
        state = first.unsqueeze(-3).expand(*of.shape[:-1], size).clone()
        state[..., at] = of
        inputs = stack.inputs[:, : span + 1].repeat(count, 1, 1)
        begun = narrow.initial(state.flatten(-3, -2), inputs[:, 0].expand(*shape[:-1], -1, -1), stack.dt)
        run = roll(model, begun, inputs, stack.dt)[..., 1:, seen]
        found = run.unflatten(-3, (count, logs)) - measured
        return torch.nan_to_num(found.flatten(-2), nan=1e3, posinf=1e3, neginf=-1e3)

    found, damping = guess, torch.full((*shape, 1), 1e-3, dtype=first.dtype)
    probe = 1e-4 * (guess.abs() + 1e-2)
    for _ in range(BEGINNING.steps):
        moved = torch.stack([found, *(found + torch.diag(torch.ones(len(at)))[i] * probe for i in range(len(at)))], -3)
        errors = misfit(moved)
        base = errors[..., 0, :, :]
        slopes = torch.stack([(errors[..., i + 1, :, :] - base) for i in range(len(at))], -1) / probe.unsqueeze(-2)
        gram = slopes.transpose(-1, -2) @ slopes
        diagonal = torch.diagonal(gram, dim1=-2, dim2=-1)
        gram = gram + torch.diag_embed(diagonal * damping + 1e-12)
        step = -torch.linalg.solve(gram, slopes.transpose(-1, -2) @ base.unsqueeze(-1)).squeeze(-1)
        tried = found + step
        better = (misfit(tried.unsqueeze(-3))[..., 0, :, :] ** 2).sum(-1) < (base**2).sum(-1)
        found = torch.where(better.unsqueeze(-1), tried, found)
        damping = torch.where(better.unsqueeze(-1), damping / 5, damping * 10)
    first[..., at] = found
    return narrow.initial(first, stack.inputs[:, 0].expand(*shape, stack.inputs.shape[-1]), stack.dt)


def _settled(model: PhysicsModel, resting: Tensor, stack: LogBatch, at: tuple[int, ...]) -> Tensor:
    """The unmeasured states (…, L, H) after the first input for long, from ``resting`` on, the measured ones held."""
    states, inputs = (x[:, :1].expand(-1, BEGINNING.settle + 1, -1) for x in (stack.states, stack.inputs))
    return torch.nan_to_num(
        _carried(model, resting, states, inputs, stack.dt, at)[..., -1, :], nan=1.0, posinf=1.0, neginf=1.0
    )


def _carried(
    model: PhysicsModel, begin: Tensor, states: Tensor, inputs: Tensor, dt: float, at: tuple[int, ...]
) -> Tensor:
    """The states (…, L, N, H) at the places ``at`` as a model carries them, all others put in place at every sample.

    Args:
        model: its parameters may be tensors (B, 1, 1), for B models at once.
        begin: (…, L, full) at the first sample.
        states: (L, N, s) of which the others are taken.
        inputs: (L, N, m).
        dt: [s].
        at: of the H states.
    """
    places, size, narrow = list(at), states.shape[-1], narrowed(model)
    fast = models.carried(model, inputs.shape[-1], dt, at)
    if fast is not None:
        internal = model.internal_size
        acting = passed(narrow, begin[..., size + internal :], inputs, dt)[1].flatten(-2)
        own = torch.cat([begin[..., places], begin[..., size : size + internal]], dim=-1)
        given = (x.reshape(-1, *x.shape[-3:]) for x in (states[:, :-1], acting))
        body = fast(own.reshape(-1, *own.shape[-2:]), *given, steps=inputs.shape[-2] - 1)
        carried = body[..., : len(places)].reshape(*own.shape[:-1], -1, len(places))
        return torch.cat([begin[..., None, places], carried], dim=-2)
    path, inputs = [begin], inputs.expand(*begin.shape[:-2], *inputs.shape)
    for k in range(states.shape[1] - 1):
        after = narrow.step(path[-1], inputs[..., k, :], inputs[..., k + 1, :], dt)
        state = states[:, k + 1].expand(*after.shape[:-1], size).clone()
        state[..., places] = after[..., places]
        path.append(torch.cat([state, after[..., size:]], dim=-1))
    return torch.stack([p[..., places] for p in path], dim=-2)
