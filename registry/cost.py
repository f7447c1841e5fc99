"""The training cost of the paper, in scaled units: L_tot = α L_pred + β L_si. Leading model dimensions are kept."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

if TYPE_CHECKING:  # contracts use the cost
    from registry.contracts import Predictor


def batch_mean(x: Tensor) -> Tensor:
    """Mean over the batch, (B,) → () or (M, B) → (M,), each model by itself so that its bits are its own."""
    if x.dim() == 1:
        return x.mean()
    return x.mean().unsqueeze(0) if len(x) == 1 else torch.stack([row.mean() for row in x.unbind(0)])


def prediction_cost(predicted: Tensor, measured: Tensor) -> Tensor:
    """L_pred (paper, eq. L_pred): mean over windows and steps of eᵀe; (…, B, T, n) → (…)."""
    cost: Tensor = _SquaredError.apply(predicted, measured)
    return cost


def state_initialization_cost(predictor: Predictor, state: Tensor, inputs: Tensor, outputs: Tensor) -> Tensor:
    """L_si (paper, eq. state_init_cost): mean over windows of |A_s s_{k0} − c|.

    Args:
        predictor: whose read-out gives A_s s + B u + b.
        state: (…, B, s) at k0.
        inputs: (…, B, m) u_{k0}, scaled.
        outputs: (…, B, n) y_{k0}, scaled.

    Returns:
        (…): the Euclidean norm of the distance, averaged over the batch; zero for a predictor without states.
    """
    read = predictor.readout(state, inputs)
    if read is None:
        return outputs.new_zeros(outputs.shape[:-2])
    cost: Tensor = _Distance.apply(read, outputs)
    return cost


class _SquaredError(torch.autograd.Function):
    """Mean over windows and steps of the squared error, one step for autograd."""

    @staticmethod
    def forward(ctx: Any, predicted: Tensor, measured: Tensor) -> Tensor:
        error = predicted - measured
        ctx.save_for_backward(error)
        windows, steps = error.shape[-3:-1]
        each = [e.dot(e) for e in error.reshape(-1, error.shape[-3:].numel()).unbind(0)]
        return torch.stack(each).view(error.shape[:-3]) / (windows * steps)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        (error,) = ctx.saved_tensors
        windows, steps = error.shape[-3:-1]
        slope = (2 / (windows * steps) * grads[0])[..., None, None, None] * error
        return slope, -slope if ctx.needs_input_grad[1] else None


class _Distance(torch.autograd.Function):
    """Mean over windows of the Euclidean distance, one step for autograd."""

    @staticmethod
    def forward(ctx: Any, read: Tensor, outputs: Tensor) -> Tensor:
        error = read - outputs
        # the tiny constant keeps the gradient finite where the distance is exactly zero
        distance = (error.square().sum(-1) + 1e-24).sqrt()
        ctx.save_for_backward(error, distance)
        return batch_mean(distance)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        error, distance = ctx.saved_tensors
        slope = ((grads[0] / distance.shape[-1]).unsqueeze(-1) / distance).unsqueeze(-1) * error
        return slope, -slope if ctx.needs_input_grad[1] else None
