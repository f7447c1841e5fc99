"""An affine map whose bits do not depend on how many models run beside it."""

import torch
from torch import Tensor
from torch.nn.functional import pad

from registry.kernels.pointwise import pad16


def affine(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """W x + b for one model or for M models side by side.

    Args:
        x: (B, K) or (M, B, K).
        weight: (O, K) or (M, O, K).
        bias: (O,) or (M, O).

    Returns:
        (B, O) or (M, B, O).

    The bias joins the product as one more column, and both are padded: thin products (one
    output) and sums over the batch take other routes in BLAS when they are alone than in a group.
    """
    if x.dim() == 2:
        return affine(x.unsqueeze(0), weight.unsqueeze(0), bias.unsqueeze(0))[0]
    n, k = weight.shape[-2:]
    columns = pad16(k + 1)
    ones = torch.ones_like(x[..., :1])
    padded = pad(torch.cat([weight, bias.unsqueeze(-1)], -1), (0, columns - k - 1, 0, pad16(n) - n))
    rows = pad(torch.cat([x, ones], -1), (0, columns - k - 1, 0, -x.shape[-2] % 32))
    return torch.bmm(rows, padded.mT)[:, : x.shape[-2], :n]
