"""States that no sensor saw but on which measured ones depend: a model's own simulation stands in for them.

The measured states are put in place at every sample, so that the others are carried by the model alone; where they
began is sought, so that the measured states of the first samples are met.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from bench.diagnose.logs.subject import Log
from bench.diagnose.regression.weak import LogBatch, how_many, narrowed
from bench.diagnose.settings import BEGINNING
from registry.dynamics import PhysicsModel


def hidden(logs: Sequence[Log]) -> tuple[int, ...]:
    """Places in the state of what must be estimated: none where the measured states are enough."""
    return tuple(i for i, e in enumerate(logs[0].estimated) if e)


def completed(model: PhysicsModel, stack: LogBatch) -> Tensor:
    """States (…, L, N, s): as measured, and as the model carries those that were not."""
    at = list(hidden(stack.logs))
    size, narrow, path = stack.states.shape[-1], narrowed(model), [beginning(model, stack)]
    inputs = stack.inputs.expand(*path[0].shape[:-2], *stack.inputs.shape)
    for k in range(stack.states.shape[1] - 1):
        after = narrow.step(path[-1], inputs[..., k, :], inputs[..., k + 1, :], stack.dt)
        state = stack.states[:, k + 1].expand(*after.shape[:-1], size).clone()
        state[..., at] = after[..., at]
        path.append(torch.cat([state, after[..., size:]], dim=-1))
    return torch.stack([p[..., :size] for p in path], dim=-2)


def beginning(model: PhysicsModel, stack: LogBatch) -> Tensor:
    """Full states (…, L, full) at the first samples, from which a free run meets the first measurements."""
    at, size = list(hidden(stack.logs)), stack.states.shape[-1]
    seen = [i for i in range(size) if i not in at and stack.logs[0].measured[i]]
    logs, many, narrow = len(stack.logs), how_many(model), narrowed(model)
    shape = (logs,) if many is None else (many, logs)
    span = min(BEGINNING.warm, stack.states.shape[1] - 1)
    first = stack.states[:, 0].expand(*shape, size).clone()
    guess = _settled(narrow, first, stack, at)
    measured = stack.states[:, 1 : span + 1, seen]

    def misfit(of: Tensor) -> Tensor:
        """(…, H + 1, L, span · seen) of beginnings (…, H + 1, L, H)."""
        count = of.shape[-3]
        state = first.unsqueeze(-3).expand(*of.shape[:-1], size).clone()
        state[..., at] = of
        inputs, out = stack.inputs.repeat(count, 1, 1).expand(*shape[:-1], -1, -1, -1), []
        state = narrow.initial(state.flatten(-3, -2), inputs[..., 0, :], stack.dt)
        for k in range(span):
            state = narrow.step(state, inputs[..., k, :], inputs[..., k + 1, :], stack.dt)
            out.append(state[..., seen])
        found = torch.stack(out, dim=-2).unflatten(-3, (count, logs)) - measured
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


def _settled(narrow: PhysicsModel, first: Tensor, stack: LogBatch, at: Sequence[int]) -> Tensor:
    """The unmeasured states (…, L, H) after the first input for long, with the measured ones held."""
    u = stack.inputs[:, 0].expand(*first.shape[:-1], stack.inputs.shape[-1])
    size, state = first.shape[-1], narrow.initial(first, u, stack.dt)
    for _ in range(BEGINNING.settle):
        after = narrow.step(state, u, u, stack.dt)
        kept = first.clone()
        kept[..., list(at)] = after[..., list(at)]
        state = torch.cat([kept, after[..., size:]], dim=-1)
    return torch.nan_to_num(state[..., list(at)], nan=1.0, posinf=1.0, neginf=1.0)
