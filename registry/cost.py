"""The training cost of the paper, in scaled units: L_tot = α L_pred + β L_si. Leading model dimensions are kept."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:  # contracts use the cost
    from registry.contracts import Gradients, Predictor


def batch_mean(x: Tensor) -> Tensor:
    """Mean over the batch, (B,) → () or (M, B) → (M,), each model by itself so that its bits are its own."""
    if x.dim() == 1:
        return x.mean()
    return x.mean().unsqueeze(0) if len(x) == 1 else torch.stack([row.mean() for row in x.unbind(0)])


def prediction_cost(predicted: Tensor, measured: Tensor) -> Tensor:
    """L_pred (paper, eq. L_pred): mean over windows and steps of eᵀe; (…, B, T, n) → (…)."""
    return _squares(predicted - measured) / (predicted.shape[-3] * predicted.shape[-2])


def _squares(error: Tensor) -> Tensor:
    """Their sum (…) over (…, B, T, n), each model by itself."""
    flat = error.flatten(-3)
    if flat.dim() == 1:
        return flat.dot(flat)
    return torch.stack([e.dot(e) for e in flat.unbind(0)]) if len(flat) > 1 else flat[0].dot(flat[0]).unsqueeze(0)


def prediction_vjp(predicted: Tensor, measured: Tensor, weight: float) -> tuple[Tensor, Tensor]:
    """`prediction_cost`, and the gradient of ``weight`` times it by what was predicted, which is overwritten.

    Autograd's, bit for bit.
    """
    count, error = predicted.shape[-3] * predicted.shape[-2], predicted.sub_(measured)
    return _squares(error) / count, error.mul_(2 * _share(weight, count, error.dtype))


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
    return batch_mean(torch.linalg.vector_norm(read - outputs, dim=-1))


def state_initialization_vjp(
    predictor: Predictor, state: Tensor, inputs: Tensor, outputs: Tensor, weight: float
) -> tuple[Tensor, Tensor, Gradients]:
    """`state_initialization_cost`, and the gradients of ``weight`` times it by the state and by the parameters.

    Autograd's, bit for bit.
    """
    found = predictor.readout_vjp(state, inputs)
    if found is None:
        return outputs.new_zeros(outputs.shape[:-2]), torch.zeros_like(state), {}
    read, back = found
    distance = read.sub_(outputs)
    norm = torch.linalg.vector_norm(distance, dim=-1, keepdim=True)
    cost = batch_mean(norm.squeeze(-1))
    norm.clamp_(min=torch.finfo(norm.dtype).tiny)  # a distance of zero has no direction
    d_state = torch.zeros_like(state)
    gradients = back(distance.div_(norm).mul_(_share(weight, norm.shape[-2], norm.dtype)), d_state)
    return cost, d_state, gradients


@lru_cache
def _share(weight: float, count: int, dtype: torch.dtype) -> float:
    """weight / count, rounded as autograd does."""
    return float(torch.tensor(weight, dtype=dtype) / count)
