"""The multi-layer fully connected RNN of the paper."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from torch.nn.functional import pad
from typing_extensions import override

from registry.contracts import Gradients, Predictor, PredictorEntry, Problem, ReadoutVJP, RunVJP, StateLayout
from registry.core import PREDICTORS, option
from registry.kernels.mlfc import mlfc, mlfc_vjp
from registry.kernels.mlp import affine, mlp_vjp
from registry.predictors.lstm import newest_first
from registry.predictors.parts.weights import uniform


class MLFCPredictor(Predictor):
    """Network of `MLFC`: tanh layers with skip connections forward and backward, linear read-out of all of them."""

    def __init__(self, entry: "MLFC", problem: Problem) -> None:
        super().__init__(problem)
        n_inputs, n_outputs = self.n_inputs, self.n_outputs
        self.layers, self.hidden, self.dropout = entry.layers, entry.hidden, entry.dropout
        size = entry.layers * entry.hidden
        self.fed_back = entry.output_feedback
        self.history = 2 if self.fed_back else 1
        self.layout = StateLayout(self.history * n_outputs, size, 0)
        seen, each = n_inputs + n_outputs, range(entry.layers)
        self.columns = seen + size - entry.hidden
        """Of what may enter a layer: [u | ỹ | y of the other layers]."""
        self.entering = [slice(0, self.columns)] * entry.layers
        self.read = slice(0, size)
        """Layer outputs that the read-out sees."""
        if not entry.skip:
            self.entering = [slice(seen + (i - 1) * entry.hidden, seen + i * entry.hidden) if i else slice(0, seen)
                             for i in each]  # fmt: skip
            self.read = slice(size - entry.hidden, size)
        counts = [at.stop - at.start for at in self.entering]
        size = self.read.stop - self.read.start
        drawn = lambda i, n: uniform(  # noqa: E731
            entry.hidden, n, fan_in=counts[i] + entry.hidden, scale=entry.weight_scale
        )
        self.input_weight = nn.ParameterList([drawn(i, counts[i]) for i in each])
        self.feedback_weight = nn.ParameterList([drawn(i, entry.hidden) for i in each])
        self.bias = nn.ParameterList([nn.Parameter(torch.zeros(entry.hidden)) for _ in each])
        self.output_weight = uniform(n_outputs, size, fan_in=size + n_inputs, scale=entry.weight_scale)
        self.direct_weight = uniform(n_outputs, n_inputs, fan_in=size + n_inputs, scale=entry.weight_scale)
        self.output_bias = nn.Parameter(torch.zeros(n_outputs))
        if self.fed_back:
            self.fed_weight = nn.Parameter(torch.zeros(n_outputs, n_outputs))

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """The last measured output; where A_o is free the one before it too, which L_si looks at."""
        return newest_first(outputs[..., : self.n_outputs], self.history)

    @override
    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        outputs, hidden = mlfc(*self._run(inputs, state, feedback))
        return outputs, self._end(state, outputs, hidden, feedback)

    @override
    def rollout_vjp(
        self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None
    ) -> tuple[Tensor, Tensor, RunVJP]:
        outputs, hidden, back = mlfc_vjp(*self._run(inputs, state, feedback))
        end, n, before = self._end(state, outputs, hidden, feedback), self.n_outputs, self.layout.buffer

        def vjp(d_outputs: Tensor | None, d_end: Tensor | None) -> tuple[Tensor, Gradients]:
            d_outputs = torch.zeros_like(outputs) if d_outputs is None else d_outputs
            d_end = torch.zeros_like(end) if d_end is None else d_end
            steps = d_outputs.shape[-2]
            if feedback is None:
                d_outputs[..., -1, :] += d_end[..., :n]
            if feedback is None and self.fed_back and steps > 1:
                d_outputs[..., -2, :] += d_end[..., n:before]
            d_fed, d_hidden, (*layers, readout) = back(d_outputs, d_end[..., before:])
            if self.fed_back:
                d_fed = torch.cat([d_fed + d_end[..., n:before] if steps == 1 else d_fed, torch.zeros_like(d_fed)], -1)
            return torch.cat([d_fed, d_hidden], -1), self._separate(layers, readout)

        return outputs, end, vjp

    def _end(self, state: Tensor, outputs: Tensor, hidden: Tensor, feedback: Tensor | None) -> Tensor:
        """The state after a run: what is fed back next, and what the layers gave."""
        fed = (outputs if feedback is None else feedback)[..., -self.history :, :]
        if fed.shape[-2] < self.history:
            fed = torch.cat([state[..., : self.n_outputs].unsqueeze(-2), fed], -2)
        return torch.cat([newest_first(fed, self.history), hidden], -1)

    def _run(self, inputs: Tensor, state: Tensor, feedback: Tensor | None) -> tuple[Any, ...]:
        """What `mlfc` is given."""
        fed, hidden, _ = self.layout.split(state)
        fed = fed[..., : self.n_outputs]
        seen = self.n_inputs + self.n_outputs  # columns of input_weight before the other layers'
        layers = []
        for i in range(self.layers):
            at, before, bias = self.entering[i], seen + i * self.hidden, self.bias[i].unsqueeze(-1)
            w = pad(self.input_weight[i], (at.start, self.columns - at.stop))
            own = self.feedback_weight[i]
            layers.append(torch.cat([w[..., :seen], bias, w[..., seen:before], own, w[..., before:]], -1))
        if self.fed_back:
            of_fed: Tensor = self.fed_weight
        else:
            of_fed = torch.zeros_like(self.output_bias).unsqueeze(-1).expand(*self.output_bias.shape, self.n_outputs)
        of_layers = pad(self.output_weight, (self.read.start, self.layers * self.hidden - self.read.stop))
        readout = torch.cat([self.direct_weight, of_fed, self.output_bias.unsqueeze(-1), of_layers], -1)
        return inputs, fed, hidden, layers, readout, feedback, self.dropout if self.training else 0.0

    def _separate(self, layers: list[Tensor], readout: Tensor) -> Gradients:
        """Gradients of the parameters from those of what `_run` made of them."""
        seen, found = self.n_inputs + self.n_outputs, {}
        for i, d in enumerate(layers):
            sizes = [seen, 1, i * self.hidden, self.hidden, (self.layers - 1 - i) * self.hidden]
            entering, bias, before, own, after = d.split(sizes, -1)
            found[f"input_weight.{i}"] = torch.cat([entering, before, after], -1)[..., self.entering[i]]
            found |= {f"bias.{i}": bias.squeeze(-1), f"feedback_weight.{i}": own}
        direct, fed, bias, weight = readout.split([self.n_inputs, self.n_outputs, 1, self.layers * self.hidden], -1)
        found |= {"fed_weight": fed} if self.fed_back else {}
        return found | {
            "direct_weight": direct,
            "output_bias": bias.squeeze(-1),
            "output_weight": weight[..., self.read],
        }

    def readout(self, state: Tensor, inputs: Tensor) -> Tensor:
        """A_s [y¹ .. y^L] + A_o o + B u + b (paper, eq. output_div; c = y − A_o y_{k0−1} − B u − b)."""
        return affine(*self._read(state, inputs), self.output_bias)

    @override
    def readout_vjp(self, state: Tensor, inputs: Tensor) -> tuple[Tensor, ReadoutVJP]:
        x, weight = self._read(state, inputs)
        read, back = mlp_vjp(x, [(weight, self.output_bias)])

        def vjp(d_read: Tensor, d_state: Tensor) -> Gradients:
            d_x, (d_weight, d_bias) = back(d_read, True)
            assert d_x is not None
            start, stop = (self.layout.buffer + at for at in (self.read.start, self.read.stop))
            d_state[..., start:stop] += d_x[..., : stop - start]
            of_layers, of_inputs, *of_fed = d_weight.split([w.shape[-1] for w in self._weights()], -1)
            found = {"output_weight": of_layers, "direct_weight": of_inputs, "output_bias": d_bias}
            return found | dict(zip(["fed_weight"], of_fed, strict=False))

        return read, vjp

    def _read(self, state: Tensor, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """What the read-out reads of a state, and its weight."""
        buffers, hidden, _ = self.layout.split(state)
        read = [hidden[..., self.read], inputs, *([buffers[..., self.n_outputs :]] if self.fed_back else [])]
        return torch.cat(read, -1), torch.cat(self._weights(), -1)

    def _weights(self) -> list[Tensor]:
        """Those of the read-out: of the layers, of the inputs and, where it is free, of the output fed back."""
        return [self.output_weight, self.direct_weight, *([self.fed_weight] if self.fed_back else [])]


@PREDICTORS.register("MLFC")
@dataclass(frozen=True)
class MLFC(PredictorEntry):
    """Multi-layer fully connected RNN: tanh layers joined by skip connections forward and backward.

    Mohajerin and Waslander, eqs. LRLayer and layerinput; the output is fed back beside the input.
    """

    network: ClassVar[bool] = True
    supports_batching: ClassVar[bool] = True

    layers: int = option(1, "layers", low=1, high=20, search=(1, 3))
    hidden: int = option(50, "neurons in each layer", low=1, high=2000, log=True, search=(10, 100))
    dropout: float = option(0.0, "probability of dropping a layer output before the read-out", low=0.0, high=0.9)
    weight_scale: float = option(1.0, "initial weights are uniform within ± this / √fan-in", low=0.0, high=10.0)
    output_feedback: bool = option(
        False, "whether the read-out sees the output fed back: A_o is free, else zero", source="paper, eq. output_div"
    )
    skip: bool = option(
        True, "skip connections; without them every layer sees the one before it, and the read-out the last one"
    )

    @override
    def build(self, problem: Problem) -> Predictor:
        return MLFCPredictor(self, problem)


@PREDICTORS.register("MLFC A_o")
@dataclass(frozen=True)
class MLFCFedBack(MLFC):
    """`MLFC` whose read-out sees the output fed back, as the paper's equation has it: ỹ = A_s s + A_o o + B u + b.

    In `MLFC` A_o is zero. Studies show both.
    """

    output_feedback: bool = option(True, "whether A_o is free", source="paper, eq. output_div")


@PREDICTORS.register("MLFC serial")
@dataclass(frozen=True)
class MLFCSerial(MLFC):
    """`MLFC` without its skip connections: a recurrent MLP, whose layers stand in series.

    What the paper says of skip connections is judged against it.
    """

    skip: bool = option(False, "skip connections")
