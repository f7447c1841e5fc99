"""The training cost of the paper, in scaled units: L_tot = α L_pred + β L_si. Leading model dimensions are kept."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:  # contracts use the cost
    from registry.contracts import Predictor


def batch_mean(x: Tensor) -> Tensor:
    """Mean over the batch, (B,) → () or (M, B) → (M,), each model by itself so that its bits are its own."""
    if x.dim() == 1:
        return x.mean()
    return x.mean().unsqueeze(0) if len(x) == 1 else torch.stack([row.mean() for row in x.unbind(0)])


def prediction_cost(predicted: Tensor, measured: Tensor) -> Tensor:
    """L_pred (paper, eq. L_pred): mean over windows and steps of eᵀe; (…, B, T, n) → (…)."""
    windows, steps = predicted.shape[-3:-1]
    error = (predicted - measured).flatten(-3)
    squares = error.dot(error) if error.dim() == 1 else torch.stack([e.dot(e) for e in error.unbind(0)])
    return squares / (windows * steps)


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
