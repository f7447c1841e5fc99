"""The optimizer: Adam with decoupled weight decay, for models that are rows of a tensor, each with its own rate."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from bench.experiment.config import Training

BETAS, EPS = (0.9, 0.999), 1e-8


class Adam:
    """Changes the tensors that it is given in place.

    torch's private function, as it is in the one version that is required: the public `torch.optim.adamw.adamw` comes
    to the same bits and takes 80 µs more, of the 1 to 3 ms of an update.
    """

    def __init__(self, options: Training, rates: Sequence[float], tensors: Sequence[Tensor]) -> None:
        """Of models that train side by side.

        Args:
            options: what they have in common.
            rates: the M learning rates at the start.
            tensors: weights, gradients and the gradients' two moments, (M, P) each. Rows of a length that no vector
                of the processor cuts keep their bits however they are put together.
        """
        self.options = options
        self.parts: dict[float, list[list[Tensor]]] = {}
        """Learning rate → the tensors' rows that have it; the whole tensors, in one piece, where all have it."""
        for rate in dict.fromkeys(rates):
            rows = [j for j, r in enumerate(rates) if r == rate]
            self.parts[rate] = [[x] if len(rows) == len(rates) else [x[j] for j in rows] for x in tensors]

    def step(self, update: int) -> None:
        """The ``update``-th, from 1: the rate falls along a cosine to its final fraction over the budget."""
        o = self.options
        fall = 0.5 * (1 + math.cos(math.pi * (update - 1) / o.updates))
        for rate, (weights, gradients, means, squares) in self.parts.items():
            torch._fused_adamw_(
                weights,
                gradients,
                means,
                squares,
                [],
                [torch.tensor(float(update), device=weights[0].device)] * len(weights),
                lr=rate * (o.final_rate + (1 - o.final_rate) * fall),
                beta1=BETAS[0],
                beta2=BETAS[1],
                weight_decay=o.weight_decay,
                eps=EPS,
                amsgrad=False,
                maximize=False,
            )
