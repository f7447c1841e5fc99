"""Step after step of a model: the loop of every free run, as a compiled program where there is one."""

import math

import torch
from torch import Tensor

from bench.diagnose.regression.driving import how_many, narrowed
from registry.dynamics import PhysicsModel
from registry.equations import models


def roll(model: PhysicsModel, state: Tensor, inputs: Tensor, dt: float, drift: Tensor | None = None) -> Tensor:
    """Full states (…, W, N, full) of a free run from ``state`` (…, W, full) under inputs (W, N, m).

    ``drift`` (…, W, N − 1, s) is added to the states of the model after every step. The model's parameters may be
    tensors (B, 1, 1), for B models at once.
    """
    many, fast = how_many(model), models.step(model, inputs.shape[-1], dt, drift is not None)
    model = narrowed(model)
    if drift is not None:
        state = state.expand(*drift.shape[:-2], state.shape[-1])
    if many is not None:
        state = state.expand(many, *state.shape[-2:])
    if fast is not None:
        return _rolled(fast, model, state, inputs, dt, drift)
    inputs = inputs.expand(*state.shape[:-2], *inputs.shape[-3:])
    out = [state]
    for k in range(inputs.shape[-2] - 1):
        after = model.step(out[-1], inputs[..., k, :], inputs[..., k + 1, :], dt)
        if drift is not None:
            after = after.clone()
            after[..., : drift.shape[-1]] += drift[..., k, :]
        out.append(after)
    return torch.stack(out, dim=-2)


def _rolled(
    fast: models.Compiled, model: PhysicsModel, state: Tensor, inputs: Tensor, dt: float, drift: Tensor | None
) -> Tensor:
    """As `roll`, by a program; delays and lags, which follow the inputs alone, before."""
    size = len(model.state_channels) + model.internal_size
    memories, acting = passed(model, state[..., size:], inputs, dt)
    width, steps = state.shape[-2], inputs.shape[-2] - 1
    begin = state[..., :size].reshape(math.prod(state.shape[:-2]), width, size)
    given = [acting.flatten(-2)] if drift is None else [acting.flatten(-2), drift]
    body = fast(begin, *(x.reshape(math.prod(x.shape[:-3]), width, steps, x.shape[-1]) for x in given), steps=steps)
    path = torch.cat([begin.expand(len(body), -1, -1).unsqueeze(-2), body], dim=-2)
    path = path.reshape(*state.shape[:-1], steps + 1, size)
    return torch.cat([path, memories], dim=-1) if memories.shape[-1] else path


def passed(narrow: PhysicsModel, memory: Tensor, inputs: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """Inputs (…, W, N, m) through the input effects from memories (…, W, k) on, by all steps at once.

    Args:
        narrow: its parameters may be tensors (B, 1).
        memory: of the effects at the first sample.
        inputs: of the windows.
        dt: [s].

    Returns:
        The memories (…, W, N, k), and what acts (…, W, N − 1, 3, m) at start, middle and end of each step.
    """
    held, effects = narrow.input_hold == "previous", narrow.input_effects()
    segments = narrow.between(inputs[..., :-1, :], inputs[..., 1:, :])
    if not effects:
        return memory.unsqueeze(-2).expand(*memory.shape[:-1], inputs.shape[-2], -1), segments
    driving, extras = segments.split([segments.shape[-1] - len(narrow.extras), len(narrow.extras)], dim=-1)
    driving, extras = (x.expand(*memory.shape[:-1], *x.shape[-3:]) for x in (driving, extras))
    memories = []
    for effect, part in zip(
        effects, memory.split([e.memory_size(driving.shape[-1], dt) for e in effects], -1), strict=True
    ):
        remembered, driving = effect.over(part, driving, dt, held)
        memories.append(remembered)
    return torch.cat(memories, dim=-1), torch.cat([driving, extras], dim=-1)
