"""A temporal convolutional network on past inputs and outputs, fed back like a NARX."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional
from typing_extensions import override

from registry.contracts import Predictor, PredictorEntry, Problem, StateLayout
from registry.core import PREDICTORS, option
from registry.predictors.lstm import newest_first
from registry.predictors.parts.weights import uniform


class Convolution(nn.Module):
    """Causal, dilated: y_k = b + Σ_j W_j x_{k − j d}, j = 0 .. K−1."""

    def __init__(self, columns: int, width: int, entry: "TCN", dilation: int) -> None:
        super().__init__()
        self.dilation = dilation
        self.weight = uniform(entry.kernel, width, columns, fan_in=columns * entry.kernel, scale=entry.weight_scale)
        self.bias = nn.Parameter(torch.zeros(width))

    @property
    def reach(self) -> int:
        """How far it looks back [samples]."""
        return self.dilation * (len(self.weight) - 1)

    def forward(self, x: Tensor) -> Tensor:
        """(B, N, c) → (B, N − reach, width): the samples whose past is all there."""
        taps, n = len(self.weight), x.shape[1] - self.reach
        seen = [x[:, self.reach - j * self.dilation :][:, :n] for j in range(taps)]  # a product is faster than conv1d
        return functional.linear(torch.cat(seen, -1), self.weight.permute(1, 0, 2).flatten(1), self.bias)


class Block(nn.Module):
    """relu(x + relu(conv(relu(conv(x))))), x through a matrix where its width changes."""

    def __init__(self, columns: int, entry: "TCN", dilation: int) -> None:
        super().__init__()
        width = entry.hidden
        self.first = Convolution(columns, width, entry, dilation)
        self.second = Convolution(width, width, entry, dilation)
        self.skip = uniform(width, columns, fan_in=columns, scale=entry.weight_scale) if columns != width else None

    def forward(self, x: Tensor, past: tuple[Tensor, Tensor] | None = None) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """The samples whose past is all there, and what the convolutions saw last.

        Args:
            x: (B, N, c).
            past: what the convolutions saw before, (B, reach, ·) each; None: it is in ``x``.
        """
        if past is not None:
            x = torch.cat([past[0], x], 1)
        inner = self.first(x).relu()
        if past is not None:
            inner = torch.cat([past[1], inner], 1)
        y = self.second(inner).relu()
        straight = x[:, x.shape[1] - y.shape[1] :]
        straight = straight if self.skip is None else functional.linear(straight, self.skip)
        seen = x[:, x.shape[1] - self.first.reach :], inner[:, inner.shape[1] - self.second.reach :]
        return (straight + y).relu(), seen


class TCNPredictor(Predictor):
    """Network of `TCN`. State: the buffers [u_{k0} .. u_{k0−R+2} | ỹ_{k0} .. ỹ_{k0−R+1}], newest first.

    R is the receptive field: step k sees u_k .. u_{k−R+1} and ỹ_{k−1} .. ỹ_{k−R}.
    """

    def __init__(self, entry: "TCN", problem: Problem) -> None:
        super().__init__(problem)
        columns = [self.n_inputs + self.n_outputs] + [entry.hidden] * (entry.layers - 1)
        self.blocks = nn.ModuleList([Block(c, entry, 2**i) for i, c in enumerate(columns)])
        self.output_weight = uniform(self.n_outputs, entry.hidden, fan_in=entry.hidden, scale=entry.weight_scale)
        self.output_bias = nn.Parameter(torch.zeros(self.n_outputs))
        self.history = 1 + 2 * (entry.kernel - 1) * (2**entry.layers - 1)
        self.teaching = entry.mode == "series-parallel"
        self.past = (self.history - 1) * self.n_inputs
        self.layout = StateLayout(self.past + self.history * self.n_outputs, 0, 0)

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """The measured history in the order of the state; a short one repeats its first sample."""
        u = newest_first(inputs, self.history - 1)
        return torch.cat([u, newest_first(outputs[..., : self.n_outputs], self.history)], -1)

    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Predictor.rollout`; with ``feedback`` all steps are one pass, for none waits for another."""
        u = state[..., : self.past].unflatten(-1, (self.history - 1, self.n_inputs)).flip(-2)
        y = state[..., self.past :].unflatten(-1, (self.history, self.n_outputs)).flip(-2)
        if feedback is None:
            feedback = outputs = self._free(inputs, u, y)
        else:
            fed = torch.cat([y, feedback[:, :-1]], 1)
            outputs, _ = self._network(torch.cat([torch.cat([u, inputs], 1), fed], -1))
        after = torch.cat([u, inputs], 1), torch.cat([y, feedback], 1)
        return outputs, torch.cat([newest_first(after[0], self.history - 1), newest_first(after[1], self.history)], -1)

    def training_rollout(self, inputs: Tensor, outputs: Tensor, state: Tensor) -> Tensor:
        """One-step predictions from measured outputs (series-parallel) or the free run (parallel)."""
        return self.rollout(inputs, state, outputs if self.teaching else None)[0]

    def _free(self, inputs: Tensor, u: Tensor, y: Tensor) -> Tensor:
        """The first step from the whole buffers; the others from it and what the convolutions remember."""
        first = torch.cat([torch.cat([u, inputs[:, :1]], 1), y], -1)
        fed, past = self._network(first)
        outputs = [fed]
        for k in range(1, inputs.shape[1]):
            fed, past = self._network(torch.cat([inputs[:, k : k + 1], fed], -1), past)
            outputs.append(fed)
        return torch.cat(outputs, 1)

    def _network(
        self, x: Tensor, past: list[tuple[Tensor, Tensor]] | None = None
    ) -> tuple[Tensor, list[tuple[Tensor, Tensor]]]:
        """Outputs (B, N', n) of samples (B, N, m + n), and what the blocks remember; see `Block.forward`."""
        seen = []
        for i, block in enumerate(self.blocks):
            x, last = block(x, None if past is None else past[i])
            seen.append(last)
        return functional.linear(x, self.output_weight, self.output_bias), seen


@PREDICTORS.register("TCN")
@dataclass(frozen=True)
class TCN(PredictorEntry):
    """Temporal convolutional network: residual blocks of dilated causal convolutions of past inputs and outputs.

    Bai, Kolter and Koltun (2018), An Empirical Evaluation of Generic Convolutional and Recurrent Networks for Sequence
    Modeling (arXiv:1803.01271), without weight normalization and dropout; on past inputs and outputs as in Andersson et
    al. (2019), Deep Convolutional Networks in System Identification (arXiv:1909.01730).
    """

    network: ClassVar[bool] = True
    stateful: ClassVar[bool] = False

    layers: int = option(
        3, "residual blocks; each looks twice as far back as the one below", low=1, high=10, search=(2, 5)
    )
    hidden: int = option(16, "channels of each convolution", low=1, high=2000, log=True, search=(8, 64))
    kernel: int = option(2, "taps of each convolution", low=2, high=16, search=(2, 4))
    mode: str = option(
        "parallel", "outputs fed back in training: own or measured ones", choices=("parallel", "series-parallel")
    )
    weight_scale: float = option(1.0, "initial weights are uniform within ± this / √fan-in", low=0.0, high=10.0)

    @override
    def build(self, problem: Problem) -> Predictor:
        return TCNPredictor(self, problem)
