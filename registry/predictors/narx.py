"""NARX: a feed-forward network on tapped delay lines of inputs and outputs."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn
from typing_extensions import override

from registry.contracts import Predictor, PredictorEntry, Problem, StateLayout
from registry.core import PREDICTORS, option
from registry.kernels.mlp import mlp
from registry.predictors.lstm import newest_first
from registry.predictors.parts.weights import uniform


class NARXPredictor(Predictor):
    """Network of `NARX`. State: the buffers [u_{k0} .. u_{k0−D+2} | ỹ_{k0} .. ỹ_{k0−D+1}], newest first."""

    def __init__(self, entry: "NARX", problem: Problem) -> None:
        super().__init__(problem)
        self.delays = self.history = entry.delays
        self.teaching = entry.mode == "series-parallel"
        self.past = (self.delays - 1) * self.n_inputs
        self.layout = StateLayout(self.past + self.delays * self.n_outputs, 0, 0)
        widths = [self.delays * (self.n_inputs + self.n_outputs)] + [entry.hidden] * (entry.layers - 1)
        self.weight = nn.ParameterList([uniform(entry.hidden, w, fan_in=w, scale=entry.weight_scale) for w in widths])
        self.bias = nn.ParameterList([nn.Parameter(torch.zeros(entry.hidden)) for _ in widths])
        self.output_weight = uniform(self.n_outputs, entry.hidden, fan_in=entry.hidden, scale=entry.weight_scale)
        self.output_bias = nn.Parameter(torch.zeros(self.n_outputs))

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """The measured history in the order of the state; a short one repeats its first sample."""
        u = newest_first(inputs, self.delays - 1)
        return torch.cat([u, newest_first(outputs[..., : self.n_outputs], self.delays)], -1)

    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Predictor.rollout`; with ``feedback`` all steps are one pass, for none waits for another."""
        buffer = state[..., : self.past], state[..., self.past :]
        u = taps(buffer[0], inputs, self.delays)  # u_k .. u_{k−D+1}
        if feedback is None:
            steps, fed = [], buffer[1]
            for u_k in u.unbind(-2):
                steps.append(self._network(torch.cat([u_k, fed], -1)))
                fed = torch.cat([steps[-1], fed[..., : -self.n_outputs]], -1)
            outputs = torch.stack(steps, -2)
        else:
            y = taps(buffer[1], feedback, self.delays + 1)[..., self.n_outputs :]  # y_{k−1} .. y_{k−D}
            outputs = self._network(torch.cat([u, y], -1).flatten(-3, -2)).unflatten(-2, inputs.shape[-3:-1])
            fed = newest(buffer[1], feedback)
        return outputs, torch.cat([newest(buffer[0], inputs), fed], -1)

    def training_rollout(self, inputs: Tensor, outputs: Tensor, state: Tensor) -> Tensor:
        """One-step predictions from measured outputs (series-parallel) or the free run (parallel)."""
        return self.rollout(inputs, state, outputs if self.teaching else None)[0]

    def _network(self, x: Tensor) -> Tensor:
        """f: (…, D(m + n)) → (…, n), one row a step."""
        hidden = zip(self.weight, self.bias, strict=True)
        return mlp(x, [*hidden, (self.output_weight, self.output_bias)])


def newest(buffer: Tensor, sequence: Tensor) -> Tensor:
    """The buffer (…, w), newest first, after the samples (…, T, c) have gone through it."""
    return torch.cat([sequence.flip(-2).flatten(-2), buffer], -1)[..., : buffer.shape[-1]]


def taps(buffer: Tensor, sequence: Tensor, count: int) -> Tensor:
    """What a line of ``count`` taps shows at each step, newest first: (…, T, count·c).

    ``buffer`` (…, (count−1)·c), newest first, is what came before the samples (…, T, c).
    """
    if count == 1:
        return sequence
    before = buffer.unflatten(-1, (count - 1, sequence.shape[-1])).flip(-2)
    return torch.cat([before, sequence], -2).unfold(-2, count, 1).flip(-1).mT.flatten(-2)


@PREDICTORS.register("NARX")
@dataclass(frozen=True)
class NARX(PredictorEntry):
    """Multi-layer perceptron fed by past inputs and outputs (NARX-MLP): y_k = f(y_{k−1} .., u_k ..).

    Narendra and Parthasarathy (1990); paper, section "Background". Parallel training looks at the free run,
    series-parallel training (teacher forcing) at one-step predictions from measured outputs.
    """

    network: ClassVar[bool] = True
    supports_batching: ClassVar[bool] = True
    stateful: ClassVar[bool] = False

    layers: int = option(1, "tanh layers in series", low=1, high=20, search=(1, 3))
    hidden: int = option(50, "neurons in each layer", low=1, high=2000, log=True, search=(10, 100))
    delays: int = option(10, "taps of each delay line: u_k .. and y_{k−1} ..", unit="samples", low=1, high=100)
    mode: str = option(
        "parallel", "outputs fed back in training: own or measured ones", choices=("parallel", "series-parallel")
    )
    weight_scale: float = option(1.0, "initial weights are uniform within ± this / √fan-in", low=0.0, high=10.0)

    @override
    def build(self, problem: Problem) -> Predictor:
        return NARXPredictor(self, problem)
