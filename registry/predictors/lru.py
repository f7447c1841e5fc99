"""The linear recurrent unit: complex diagonal state-space layers between static nonlinear ones."""

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional
from typing_extensions import override

from registry.contracts import Predictor, PredictorEntry, Problem, StateLayout
from registry.core import PREDICTORS, option
from registry.predictors.parts.weights import uniform


def scan(decay: Tensor, driven: Tensor) -> Tensor:
    """s_k = λ s_{k−1} + d_k from s_{−1} = 0 for all k at once, in ⌈log2 T⌉ passes of doubling reach.

    Hillis and Steele (1986), Data parallel algorithms.

    Args:
        decay: (H,) λ, complex.
        driven: (…, T, H) d_k, complex.

    Returns:
        (…, T, H).
    """
    reach, steps = 1, driven.shape[-2]
    while reach < steps:
        before = functional.pad(driven[..., :-reach, :], (0, 0, reach, 0))
        driven = driven + decay**reach * before
        reach *= 2
    return driven


class Layer(nn.Module):
    """s_k = λ ∘ s_{k−1} + γ ∘ B h_k;  z = gelu(Re(C s_k) + D ∘ h_k);  h_k + (W z + b) ∘ σ(V z + c) goes up."""

    def __init__(self, entry: "LRU") -> None:
        super().__init__()
        width = entry.hidden
        draw = lambda *shape: uniform(*shape, fan_in=width, scale=entry.weight_scale)  # noqa: E731
        radius = torch.empty(width).uniform_(min(entry.r_min, entry.r_max) ** 2, entry.r_max**2).clamp(min=1e-8)
        angle = entry.max_phase * torch.rand(width).clamp(min=1e-6)
        self.log_damping = nn.Parameter((-0.5 * radius.log()).log())
        self.log_phase = nn.Parameter(angle.log())
        self.log_gain = nn.Parameter(0.5 * (1 - radius).log())
        self.drive, self.read = draw(2, width, width), draw(2, width, width)  # real and imaginary parts of B and C
        self.through = draw(width)
        self.gate_weight, self.gate_bias = (
            draw(2, width, width),
            nn.Parameter(torch.zeros(2, width)),
        )  # W and V, b and c

    def forward(self, below: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """From h (…, T, H) and s before them (…, H), complex: what goes up (…, T, H) and s of every step."""
        decay = torch.exp(torch.complex(-self.log_damping.exp(), self.log_phase.exp()))
        driven = self.log_gain.exp() * (below.to(decay.dtype) @ torch.complex(*self.drive).mT)
        first = driven[..., :1, :] + decay * state.unsqueeze(-2)
        states = scan(decay, torch.cat([first, driven[..., 1:, :]], -2))
        return self.up(below, states), states

    def up(self, below: Tensor, states: Tensor) -> Tensor:
        """What goes up (…, H) from h (…, H) and s (…, H) of the same step."""
        z = functional.gelu((states @ torch.complex(*self.read).mT).real + self.through * below)
        value, gate = (functional.linear(z, w, b) for w, b in zip(self.gate_weight, self.gate_bias, strict=True))
        return below + value * gate.sigmoid()


class LRUPredictor(Predictor):
    """Network of `LRU`. State: real, then imaginary parts of every layer's s, unbounded as cells are."""

    def __init__(self, entry: "LRU", problem: Problem) -> None:
        super().__init__(problem)
        self.hidden, scale = entry.hidden, entry.weight_scale
        self.layout = StateLayout(0, 0, 2 * entry.layers * entry.hidden)
        self.input_weight = uniform(self.hidden, self.n_inputs, fan_in=self.n_inputs, scale=scale)
        self.input_bias = nn.Parameter(torch.zeros(self.hidden))
        self.stack = nn.ModuleList([Layer(entry) for _ in range(entry.layers)])
        self.output_weight = uniform(self.n_outputs, self.hidden, fan_in=self.hidden, scale=scale)
        self.output_bias = nn.Parameter(torch.zeros(self.n_outputs))

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """Nothing: no measured sample is part of the state."""
        return outputs[..., -1, :0]

    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Predictor.rollout`; outputs are not fed back, so that ``feedback`` changes nothing."""
        h, ends = functional.linear(inputs, self.input_weight, self.input_bias), []
        for layer, before in zip(self.stack, self._complex(state), strict=True):
            h, states = layer(h, before)
            ends.append(states[..., -1, :])
        end = torch.stack(ends, -2)
        return (
            functional.linear(h, self.output_weight, self.output_bias),
            torch.cat([end.real.flatten(-2), end.imag.flatten(-2)], -1),
        )

    def readout(self, state: Tensor, inputs: Tensor) -> Tensor:
        """ŷ_{k0} of the states and u_{k0}, through all layers."""
        h = functional.linear(inputs, self.input_weight, self.input_bias)
        for layer, states in zip(self.stack, self._complex(state), strict=True):
            assert isinstance(layer, Layer)
            h = layer.up(h, states)
        return functional.linear(h, self.output_weight, self.output_bias)

    def _complex(self, state: Tensor) -> tuple[Tensor, ...]:
        """Of every layer (…, H)."""
        real, imaginary = state.unflatten(-1, (2, len(self.stack), self.hidden)).unbind(-3)
        return torch.complex(real, imaginary).unbind(-2)


@PREDICTORS.register("LRU")
@dataclass(frozen=True)
class LRU(PredictorEntry):
    """Linear recurrent units: diagonal state-space layers, trained by a parallel scan; no outputs are fed back.

    Orvieto et al. (2023), Resurrecting Recurrent Neural Networks for Long Sequences (arXiv:2303.06349): poles within
    the unit circle by their parametrization, normalized drive, gated linear units between the layers; of their blocks
    the normalization is left out, which a simulation in physical units does not need.
    """

    network: ClassVar[bool] = True

    layers: int = option(2, "state-space layers in series", low=1, high=20, search=(1, 4))
    hidden: int = option(32, "complex states, and width, of each layer", low=1, high=2000, log=True, search=(10, 100))
    r_min: float = option(0.5, "smallest magnitude of a pole at the start", low=0.0, high=0.9999)
    r_max: float = option(0.99, "largest magnitude of a pole at the start", low=1e-3, high=0.9999)
    max_phase: float = option(
        math.pi / 4, "largest phase of a pole at the start", unit="rad/sample", low=1e-6, high=math.pi
    )
    weight_scale: float = option(1.0, "initial weights are uniform within ± this / √fan-in", low=0.0, high=10.0)

    @override
    def build(self, problem: Problem) -> Predictor:
        return LRUPredictor(self, problem)
