"""L_pred, the prediction cost of the paper, in scaled units. Leading model dimensions are kept."""

from functools import lru_cache

import torch
from torch import Tensor


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
    return _squares(error) / count, error.mul_(2 * rounded_share(weight, count, error.dtype))


@lru_cache
def rounded_share(weight: float, count: int, dtype: torch.dtype) -> float:
    """weight / count, rounded as autograd does."""
    return float(torch.tensor(weight, dtype=dtype) / count)
