"""A neural ODE: the kinematics that the signals are known to have, and a learned derivative for the rest."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn
from typing_extensions import override

from registry.contracts import Channel, Predictor, PredictorEntry, Problem, StateLayout
from registry.core import PREDICTORS, option
from registry.dynamics.model import RATE_OF
from registry.kernels.mlp import mlp
from registry.predictors.parts.weights import uniform

VECTORS = ("position", "displacement", "angle")
"""Poses whose time derivative is their rate, axis by axis; that of an attitude is not."""


class NeuralODEPredictor(Predictor):
    """Network of `NeuralODE`. State: [u_{k0} | y_{k0} | rates that were not measured, then latent states].

    All is scaled. A pose's rate that is not among the outputs is a state of its own in units of the pose's standard
    deviation times ``pace``, in which the learned derivatives are too.
    """

    def __init__(self, entry: "NeuralODE", problem: Problem) -> None:
        super().__init__(problem)
        self.dt, self.held = 1 / problem.rate, problem.input_hold == "previous"
        names = [c.name for c in problem.outputs]
        rates = {i: _rate(c) for i, c in enumerate(problem.outputs)} if entry.kinematics else {}
        self.measured = [(i, names.index(r)) for i, r in rates.items() if r in names]
        """Outputs that are poses, and those that are their rates."""
        unmeasured = [i for i, r in rates.items() if r and r not in names]
        self.unmeasured = [(i, self.n_outputs + j) for j, i in enumerate(unmeasured)]
        """Outputs that are poses, and the places of their rates in x."""
        own = len(unmeasured) + entry.latent
        self.size = self.n_outputs + own
        poses = {i for i, _ in (*self.measured, *self.unmeasured)}
        self.learned = [i for i in range(self.size) if i not in poses]
        self.layout = StateLayout(self.n_inputs + self.n_outputs, 0, own)
        widths = [self.size + self.n_inputs] + [entry.hidden] * entry.layers
        heights = [entry.hidden] * entry.layers + [len(self.learned)]
        draw = [uniform(h, w, fan_in=w, scale=entry.weight_scale) for w, h in zip(widths, heights, strict=True)]
        self.weight = nn.ParameterList(draw)
        self.bias = nn.ParameterList([nn.Parameter(torch.zeros(h)) for h in heights])
        self.pace = entry.pace * problem.rate

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """The last inputs and outputs."""
        return torch.cat([inputs[..., -1, :], outputs[..., -1, : self.n_outputs]], -1)

    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Predictor.rollout`; measured outputs take the place of predicted ones."""
        before, x = state.split([self.n_inputs, self.size], -1)
        predicted = []
        for k, u in enumerate(inputs.unbind(-2)):
            x = self._step(x, before, before if self.held else u)
            predicted.append(x[..., : self.n_outputs])
            if feedback is not None:
                x = torch.cat([feedback[..., k, :], x[..., self.n_outputs :]], -1)
            before = u
        return torch.stack(predicted, -2), torch.cat([before, x], -1)

    def _step(self, x: Tensor, u0: Tensor, u1: Tensor) -> Tensor:
        """One sample on by the classical Runge–Kutta method; inputs (…, m) move in a straight line."""
        middle, dt = (u0 + u1) / 2, self.dt
        k1 = self.derivative(x, u0)
        k2 = self.derivative(x + dt / 2 * k1, middle)
        k3 = self.derivative(x + dt / 2 * k2, middle)
        k4 = self.derivative(x + dt * k3, u1)
        return x + dt / 6 * (k1 + 2 * (k2 + k3) + k4)

    def derivative(self, x: Tensor, inputs: Tensor) -> Tensor:
        """dx/dt (…, s) [1/s] of the scaled x (…, s) at scaled inputs (…, m)."""
        network = mlp(torch.cat([x, inputs], -1), list(zip(self.weight, self.bias, strict=True)))
        columns = dict(zip(self.learned, (self.pace * network).unbind(-1), strict=True))
        scale, offset = self.output_scaler.scale, self.output_scaler.offset
        columns |= {pose: (x[..., r] * scale[r] + offset[r]) / scale[pose] for pose, r in self.measured}
        columns |= {pose: self.pace * x[..., r] for pose, r in self.unmeasured}
        return torch.stack([columns[i] for i in range(self.size)], -1)


def _rate(channel: Channel) -> str:
    """Name of the channel that is the rate of change of a pose; empty: the channel is none."""
    return f"{RATE_OF[channel.group]}.{channel.axis}" if channel.group in VECTORS else ""


@PREDICTORS.register("Neural ODE")
@dataclass(frozen=True)
class NeuralODE(PredictorEntry):
    """Learned derivative, integrated by Runge–Kutta; positions and angles change as their rates say.

    Chen et al. (2018), Neural Ordinary Differential Equations (arXiv:1806.07366); with known equations beside learned
    ones, Rackauckas et al. (2020), Universal Differential Equations (arXiv:2001.04385); latent states as in Dupont et
    al. (2019), Augmented Neural ODEs (arXiv:1904.01681).
    """

    network: ClassVar[bool] = True

    layers: int = option(1, "tanh layers in series", low=1, high=20, search=(1, 2))
    hidden: int = option(50, "neurons in each layer", low=1, high=2000, log=True, search=(10, 100))
    latent: int = option(2, "states beside outputs and rates, which only the initializer sets", low=0, high=1000)
    kinematics: bool = option(
        True, "take it as known that positions, displacements and angles change as their rates say"
    )
    pace: float = option(
        0.1, "time of a sample over that in which a learned derivative of 1 moves a state by its deviation", low=1e-6
    )
    weight_scale: float = option(1.0, "initial weights are uniform within ± this / √fan-in", low=0.0, high=10.0)

    @override
    def build(self, problem: Problem) -> Predictor:
        return NeuralODEPredictor(self, problem)
