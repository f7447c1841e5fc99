"""The load on a quadrotor, learned: nominal rotors, features of the motion, an LSTM, and an offset from the history.

ℓ_k = W φ_k + O h_k + d_k of angular acceleration and specific force in body axes (see `registry.kernels.loaded_body`).
W starts as the nominal rigid body. h is the output of an LSTM. The offset d is what the load lacked during the history,
as linear filters see it in the motion and in the accelerometer; it fades, d_{k+1} = κ ∘ d_k. A GRU that reads the same
history gives the LSTM's states and a part of the offset. Arrays are feature-major (·, K, B).
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from registry.kernels.gru import Layer as GRULayer
from registry.kernels.gru import gru
from registry.kernels.loaded_body import ANGULAR, GRAVITY, features
from registry.kernels.lstm import Layer
from registry.kernels.lstm_cell import LSTMCell
from registry.physics.quadrotor import Quadrotor
from registry.predictors.lstm import LSTMWeights
from registry.predictors.parts.weights import single, uniform

SWING = 10.0
"""Relative rotor speeds, less hover's, and their changes are multiplied by this: their spread is near 0.1."""
REACH = 8.0
"""What the GRU sees is cut off at ± this."""
GAIN = 5.0
"""Logarithms of the gains of the nominal load are learned in units of 1/5, to be as quick as the other weights."""


class Sizes(NamedTuple):
    """Of the networks: LSTM layers and cells, GRU cells; and how they start."""

    layers: int
    hidden: int
    encoder: int
    dropout: float
    weight_scale: float
    forget_bias: float


class Units(NamedTuple):
    """What relative quantities are relative to."""

    hover: float
    """Rotor speed [rad/s]."""
    velocity: float
    """[m/s]."""
    rates: float
    """[rad/s]."""


class Rotors(NamedTuple):
    """Rotor speeds as the load sees them, of K steps."""

    mean: Tensor
    """(m, K, B) over each step, relative to hover's."""
    change: Tensor
    """(m, K, B) over each step, times `SWING`."""
    alone: Tensor
    """(3m, K, B) what stands for the rotors alone in the load: squares, changes, changes of the squares."""
    surplus: Tensor
    """(K, B) mean square less one."""
    yaw: Tensor
    """(K, B) sum of the squares, each with the rotor's direction."""


class LearnedLoad(nn.Module):
    """Weights of the load and of what reads the history."""

    def __init__(self, sizes: Sizes, model: Quadrotor, dt: float, history: int, felt: bool) -> None:
        """
        Args:
            sizes: of the networks.
            model: nominal constants.
            dt: length of a step [s].
            history: τ.
            felt: whether there is an accelerometer.
        """
        super().__init__()
        self.sizes, self.model, self.dt = sizes, model, dt
        m, past = len(model.rotor_positions), history - 1
        self.rotors, self.states = m, sizes.layers * sizes.hidden
        self.gain = nn.Parameter(torch.zeros(6))
        self.load = nn.Parameter(torch.zeros(6, 5 * m + 17))
        self.network = LSTMWeights(2 * m + 9, sizes.layers, sizes.hidden, sizes.weight_scale, sizes.forget_bias)
        self.network_load = nn.Parameter(torch.zeros(6, sizes.hidden))
        self.keep = nn.Parameter(torch.full((6,), 4.0))
        self.past_load = nn.Parameter(torch.full((past, 6), 0.5 / past))
        self.past_force = nn.Parameter(torch.zeros(past, 3)) if felt else None
        seen, e, scale = 2 * m + 15 + 3 * felt, sizes.encoder, sizes.weight_scale
        self.encoder_input = uniform(3 * e, seen, fan_in=e, scale=scale)
        self.encoder_recurrent = uniform(3 * e, e, fan_in=e, scale=scale)
        self.encoder_bias = nn.Parameter(torch.zeros(3 * e))
        self.latent = uniform(6 + 2 * self.states, e, fan_in=e, scale=0.1 * scale)
        self.latent_bias = nn.Parameter(torch.zeros(6 + 2 * self.states))

    def look(self, speed: Tensor) -> Rotors:
        """The rotors at K + 1 samples (m, K + 1, B); before the first step they are taken as constant."""
        mean, change = (speed[:, 1:] + speed[:, :-1]) / 2, SWING * (speed[:, 1:] - speed[:, :-1])
        square = mean.square()
        before = torch.cat([square[:, :1], square[:, :-1]], 1)
        directions = speed.new_tensor(self.model.rotor_directions).view(-1, 1, 1)
        alone = torch.cat([square, change, square - before])
        return Rotors(mean, change, alone, square.mean(0) - 1, (directions * square).sum(0))

    def map(self, units: Units) -> Tensor:
        """W (6, 5m + 17): the nominal rigid body times its gains, plus what is learned."""
        weight, model, m = single(self.load, 2), self.model, self.rotors
        thrust, reaction = (c * units.hover**2 for c in (model.thrust_coefficient, model.torque_coefficient))
        hubs, inertia = weight.new_tensor(model.rotor_positions), weight.new_tensor(model.inertia)
        torque = [thrust * hubs[:, 1], -thrust * hubs[:, 0], reaction * weight.new_tensor(model.rotor_directions)]
        nominal = torch.zeros_like(weight)
        nominal[:3, :m] = torch.stack(torque) / (ANGULAR * inertia.unsqueeze(-1))
        nominal[5, :m] = thrust / model.mass
        coupling = (inertia[[1, 2, 0]] - inertia[[2, 0, 1]]) / inertia
        nominal[:3, 3 * m + 6 : 3 * m + 9] = torch.diag(coupling * (20 * units.rates**2 / ANGULAR))
        return nominal * (GAIN * single(self.gain, 1)).exp().unsqueeze(-1) + weight

    def given(self, rotors: Rotors, offset: Tensor, units: Units) -> tuple[Tensor, Tensor]:
        """What of the load is known before the run (K, 6, B), and the offset (6, B) after it."""
        keep = torch.sigmoid(single(self.keep, 1)).unsqueeze(-1)
        steps = rotors.mean.shape[1]
        kept = keep ** torch.arange(steps, dtype=keep.dtype, device=keep.device)  # (6, K)
        alone = self.map(units)[:, : 3 * self.rotors] @ rotors.alone.transpose(0, 1)
        return alone + kept.T.unsqueeze(-1) * offset, keep**steps * offset

    def moving(self, units: Units) -> Tensor:
        """(6, 17 + 2m + H) the load of `features` and of the LSTM's output."""
        return torch.cat([self.map(units)[:, 3 * self.rotors :], single(self.network_load, 2)], -1)

    def cell(self) -> LSTMCell:
        """The LSTM, laid out for a run."""
        w = self.network
        series = zip(w.input_weight, w.recurrent_weight, w.bias, w.peephole, strict=True)
        return LSTMCell([Layer(*map(single, layer, (2, 2, 1, 2))) for layer in series])

    def read(
        self, u: Tensor, up: Tensor, v: Tensor, w: Tensor, force: Tensor | None, units: Units
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Offset of the load (6, B), hidden and cell states (L·H, B) at the end of a history.

        Args:
            u: (m, τ, B) rotor speeds relative to hover's.
            up: (3, τ, B) the vertical in body axes.
            v: (3, τ, B) velocity in body axes [m/s].
            w: (3, τ, B) body rates [rad/s].
            force: (3, τ, B) accelerometer [m/s²].
            units: of speeds, velocity and rates.
        """
        rotors = self.look(u)
        vm, wm, gm = ((x[:, 1:] + x[:, :-1]) / 2 for x in (v, w, up))
        v_, w_ = vm / units.velocity, wm / units.rates
        rows = torch.cat([rotors.alone, features(rotors.mean, rotors.surplus, rotors.yaw, v_, w_)])
        load = (self.map(units) @ rows.flatten(1)).unflatten(1, rows.shape[1:])
        turned = (w[:, 1:] - w[:, :-1]) / (self.dt * ANGULAR) - load[:3]
        moved = (v[:, 1:] - v[:, :-1]) / self.dt + torch.linalg.cross(wm, vm, dim=0) + GRAVITY * gm - load[3:]
        offset = (torch.cat([turned, moved]) * single(self.past_load, 2).T.unsqueeze(-1)).sum(1)
        tilt = gm - gm.new_tensor([0.0, 0.0, 1.0]).view(3, 1, 1)
        # each so that it is about one on a small quadrotor in lively flight
        seen = [1.7 * v_, 1.25 * w_, 7 * tilt, SWING * (rotors.mean - 1), rotors.change, 2 * turned, moved / 3]
        if force is not None and self.past_force is not None:
            lacks = force[:, 1:] - load[3:]
            more = (lacks * single(self.past_force, 2).T.unsqueeze(-1)).sum(1)
            offset = offset + nn.functional.pad(more, (0, 0, 3, 0))
            seen.append(lacks / 2)
        last = self._encode(torch.cat(seen).clamp(-REACH, REACH).permute(2, 1, 0))
        z = torch.addmm(single(self.latent_bias, 1).unsqueeze(-1), single(self.latent, 2), last.T)
        more, hidden, cell = z.split([6, self.states, self.states])
        return offset + 0.3 * more, torch.tanh(hidden), cell

    def _encode(self, seen: Tensor) -> Tensor:
        """Last output (B, E) of the GRU over (B, τ − 1, ·); nothing is fed back to it."""
        weights = (self.encoder_input, self.encoder_recurrent, self.encoder_bias)
        layer = GRULayer(*(single(p, d).unsqueeze(0) for p, d in zip(weights, (2, 2, 1), strict=True)))
        size, new = self.sizes.encoder, seen.new_zeros
        _, last = gru(
            seen.unsqueeze(0), new(1, len(seen), 0), new(1, len(seen), size), [layer], new(1, 0, size), new(1, 0)
        )
        return nn.functional.dropout(last[0], self.sizes.dropout, self.training)
