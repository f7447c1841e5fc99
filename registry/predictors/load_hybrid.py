"""The load hybrid: exact rigid-body kinematics under a learned load."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.contracts import Dataset, Predictor, PredictorEntry, Problem, StateLayout
from registry.core import PREDICTORS, option
from registry.cost import batch_mean
from registry.dynamics import rotation_matrix
from registry.errors import BenchError
from registry.kernels.loaded_body import LoadedBody
from registry.physics.quadrotor import Quadrotor
from registry.predictors.parts.learned_load import SWING, LearnedLoad, Rotors, Sizes, Units
from registry.predictors.parts.mirror import Mirrors
from registry.predictors.parts.white_box import WhiteBox, measured_signals
from registry.stated import refuse_unstated
from registry.units import SIGNALS

SPREAD = 1.5
"""Units of velocity and body rates within the networks: this many standard deviations of the training part."""
TYPICAL = ((0.2, 0.01), (0.55, 0.03))
"""Of velocity and body rates, in standard deviations: error that costs 1, and error below which the cost is square."""


class LoadHybridPredictor(Predictor):
    """See `LoadHybrid`. The G mirror images of a batch of B windows are run as one batch, image after image.

    State, of every image: [rotor speeds at k0−1 and k0 over hover's | R | v_b | ω | offset], hidden, cell.
    """

    def __init__(self, entry: "LoadHybrid", problem: Problem) -> None:
        super().__init__(problem)
        self.history, self.jitter, self.layers = problem.history, entry.jitter, entry.layers
        if {c.group for c in problem.inputs} != {"rotor_speed"} or problem.system != "quadrotor":
            raise BenchError("The Load hybrid is for quadrotors driven by their rotor speeds: --inputs rotor_speed.")
        if {c.group for c in problem.outputs} != {"velocity", "body_rates"} or problem.n_outputs != 6:
            raise BenchError("The Load hybrid predicts all of velocity and body_rates: --outputs velocity,body_rates.")
        if problem.history < 2:
            raise BenchError("The Load hybrid starts from at least two samples: --set history=50.")
        box = WhiteBox(problem)
        assert isinstance(box.model, Quadrotor)
        known = (*problem.outputs, *problem.context)
        names = [c.name for c in known]
        self.columns = {
            s: [names.index(f"{s}.{a}") for a in SIGNALS[s].axes]
            for s in ("velocity", "body_rates", "attitude", "specific_force")
            if f"{s}.{SIGNALS[s].axes[0]}" in names
        }
        """Columns of outputs and context, axis by axis."""
        self.order = sorted(range(6), key=(self.columns["velocity"] + self.columns["body_rates"]).__getitem__)
        self.felt = self.columns.get("specific_force")
        self.mirrors = Mirrors(box.model, entry.mirrors)
        self.signs = self.mirrors.signs(known)
        sizes = Sizes(entry.layers, entry.hidden, entry.encoder, entry.dropout, entry.weight_scale, entry.forget_bias)
        self.load = LearnedLoad(sizes, box.model, box.dt, problem.history, self.felt is not None)
        pieces = (2 * self.n_inputs + 21, self.load.states, self.load.states)
        self.layout = StateLayout(*(len(self.mirrors) * p for p in pieces))

    def units(self) -> Units:
        """From the scalers, which the training part sets."""
        scale = self.output_scaler.scale
        spread = (SPREAD * float(scale[self.columns[s]].square().mean().sqrt()) for s in ("velocity", "body_rates"))
        return Units(float(self.input_scaler.offset.mean()), *spread)

    # --------------------------------------------------------------------------------------------- the history

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """See `Predictor.init_buffers`: what the history says, once for every mirror image.

        In training only the vehicle itself is run, and its state stands for all: `augment` mirrors windows at random.
        """
        if inputs.dim() == 4:
            return self.init_buffers(inputs[0], outputs[0]).unsqueeze(0)
        images = 1 if self.training else len(self.mirrors)
        u, y = self._speeds(inputs, images), self.output_scaler.invert(outputs[..., : self.n_outputs])
        if self.context_scaler is not None:
            y = torch.cat([y, self.context_scaler.invert(outputs[..., self.n_outputs :])], -1)
        y = torch.cat([y * self.signs[g].to(y) for g in range(images)]).permute(2, 1, 0)
        rotation = rotation_matrix(y[self.columns["attitude"]].movedim(0, -1)).permute(2, 3, 0, 1)  # (3, 3, τ, G·B)
        velocity, w = y[self.columns["velocity"]], y[self.columns["body_rates"]]
        v = (rotation * velocity.unsqueeze(1)).sum(0)
        force = None if self.felt is None else y[self.felt]
        offset, hidden, cell = self.load.read(u, rotation[2], v, w, force, self.units())
        u, rotation = u[:, -2:].transpose(0, 1), rotation[:, :, -1]
        buffer = torch.cat([u.flatten(0, 1), rotation.flatten(0, 1), v[:, -1], w[:, -1], offset])
        return self._state((buffer, hidden, cell), images)

    # ---------------------------------------------------------------------------------------------- prediction

    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Predictor.rollout`.

        Raises:
            BenchError: measured outputs are to be fed back; its state holds the attitude too.
        """
        if feedback is not None:
            raise BenchError("The Load hybrid runs free: it takes no measured outputs after its history.")
        if inputs.dim() == 4:
            outputs, end = self.rollout(inputs[0], state[0])
            return outputs.unsqueeze(0), end.unsqueeze(0)
        images = 1 if self.training else len(self.mirrors)
        run = (x.unflatten(-1, (len(self.mirrors), -1))[:, :images] for x in self.layout.split(state))
        start = [x.transpose(0, 1).flatten(0, 1).T for x in run]
        mirrored, after = self._run(self._speeds(inputs, images), *start)
        signs = self.signs[:images, : self.n_outputs].to(mirrored)
        own = mirrored.unflatten(0, (images, -1)) * signs.view(images, 1, 1, -1)
        while len(own) > 1:  # in pairs, so that the order of the images does not show
            own = (own[::2] + own[1::2]) / 2
        return self.output_scaler(own[0]), self._state(after, images)

    def _speeds(self, inputs: Tensor, images: int) -> Tensor:
        """Rotor speeds (m, K, G·B) relative to hover's, of all images, from scaled ones (B, K, m)."""
        speeds = self.input_scaler.invert(inputs) / self.units().hover
        return torch.cat([speeds[..., self.mirrors.rotors[g]] for g in range(images)]).permute(2, 1, 0)

    def _state(self, pieces: Sequence[Tensor], images: int) -> Tensor:
        """State (B, s) of buffer, hidden and cell (·, G·B); one image stands for all where only one was run."""
        parts = [x.T.unflatten(0, (images, -1)).transpose(0, 1) for x in pieces]
        return torch.cat([x.expand(-1, len(self.mirrors), -1).flatten(1) for x in parts], -1)

    def _run(self, u: Tensor, buffer: Tensor, hidden: Tensor, cell: Tensor) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Outputs (B, T, n), SI, and buffer, hidden, cell (·, B) at the end, from speeds (m, T, B) and those at k0."""
        m, units = self.n_inputs, self.units()
        before, rotation, motion, offset = buffer.split([2 * m, 9, 6, 6])
        line = torch.cat([before.unflatten(0, (2, m)).transpose(0, 1), u], 1)  # (m, T + 2, B)
        rotors = Rotors(*(x[..., 1:, :] for x in self.load.look(line)))
        given, offset = self.load.given(rotors, offset, units)
        mean, change = rotors.mean.transpose(0, 1), rotors.change.transpose(0, 1)  # (T, m, B)
        entering = torch.cat([SWING * (mean - 1), change], 1)
        body, network = LoadedBody(self.load.dt, units.velocity, units.rates, self.load.moving(units)), self.load.cell()
        squash = body.per_unit * u.new_tensor([0.5] * 3 + [0.25] * 3).unsqueeze(-1)
        hidden, cell = (x.unflatten(0, (self.layers, -1)).contiguous() for x in (hidden, cell))
        rotation = rotation.unflatten(0, (3, 3))
        rotations, motions = [], []
        for k in range(len(mean)):
            hidden, cell = network((entering[k], 2 * torch.tanh(motion * squash), rotation[2]), hidden, cell)
            turning = mean[k], rotors.surplus[k], rotors.yaw[k]
            rotation, motion = body(rotation, motion, hidden[-1], given[k], turning)
            rotations.append(rotation)
            motions.append(motion)
        v, w = torch.stack(motions).split(3, 1)
        world = (torch.stack(rotations) * v.unsqueeze(1)).sum(2)
        outputs = torch.cat([world, w], 1)[:, self.order].permute(2, 0, 1)
        buffer = torch.cat([line[:, -2:].transpose(0, 1).flatten(0, 1), rotation.flatten(0, 1), motion, offset])
        return outputs, (buffer, hidden.flatten(0, 1), cell.flatten(0, 1))

    # ------------------------------------------------------------------------------------------------ training

    def cost(self, predicted: Tensor, measured: Tensor) -> Tensor:
        """Mean distance of velocity and of body rates, each in units of its typical one; square below a hundredth.

        Distances, and not their squares, are what the steps of a prediction are judged by.
        """
        error = (predicted - measured) * self.output_scaler.scale
        total = error.new_zeros(error.shape[:-2])
        for (typical, smooth), unit, signal in zip(TYPICAL, self.units()[1:], ("velocity", "body_rates"), strict=True):
            relative = error[..., self.columns[signal]].square().sum(-1) / (unit / SPREAD) ** 2
            total = total + (relative + smooth**2).sqrt().mean(-1) / typical
        return batch_mean(total)

    def augment(self, windows: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        """A mirror image of each window, drawn at random, its rotor speeds a little earlier or later.

        The delay between rotor speeds and motion is known to a fraction of a sample only. At the ends of the window
        the speeds are taken to stay as they are.
        """
        u_history, y_history, u, y = windows
        batch, past = u.shape[:-2], u_history.shape[-2]
        line = self.input_scaler.invert(torch.cat([u_history, u], -2))
        if self.jitter:
            line = _shifted(line, self.jitter * (2 * torch.rand(batch, dtype=line.dtype).to(line) - 1))
        image = torch.randint(len(self.mirrors), batch)
        rotors = self.mirrors.rotors[image].to(line.device).unsqueeze(-2).expand(line.shape)
        line = self.input_scaler(line.gather(-1, rotors))
        signs = self.signs[image].to(y).unsqueeze(-2)
        offsets, scales = [self.output_scaler.offset], [self.output_scaler.scale]
        if self.context_scaler is not None:
            offsets.append(self.context_scaler.offset)
            scales.append(self.context_scaler.scale)
        shift = torch.cat(offsets) / torch.cat(scales)  # a mirror is about zero in SI
        y_history = (y_history + shift) * signs - shift
        n = self.n_outputs
        y = (y + shift[:n]) * signs[..., :n] - shift[:n]
        return line[..., :past, :], y_history, line[..., past:, :], y


def _shifted(line: Tensor, delay: Tensor) -> Tensor:
    """(…, K, m) delayed by (…) samples, interpolated; beyond its ends it stays."""
    at = torch.arange(line.shape[-2], device=line.device) - delay.unsqueeze(-1)
    at = at.clamp(0, line.shape[-2] - 1)
    below = at.floor().long().clamp(max=line.shape[-2] - 2)
    part = (at - below).unsqueeze(-1)
    take = lambda i: line.gather(-2, i.unsqueeze(-1).expand(line.shape))  # noqa: E731
    return torch.lerp(take(below), take(below + 1), part)


@PREDICTORS.register("Load hybrid")
@dataclass(frozen=True)
class LoadHybrid(PredictorEntry):
    """Rigid-body kinematics of a quadrotor under a load that is learned: nominal rotors, features, an LSTM, an offset.

    The load (angular acceleration and specific force) is W φ + d_k + O h_k: W starts as the nominal rigid body, φ are
    rotor speeds and known features of the motion, h_k is an LSTM's output, and d_k is what the load lacked during the
    history, found by linear filters on the residual of the motion and of the accelerometer, and fading. A GRU reads the
    history and sets the LSTM's states. Unlike Mohajerin and Waslander's hybrid, whose networks stand before and after
    the physics and correct its states, here every prediction obeys the kinematics exactly and only forces and torques
    are learned; a vehicle's mirror symmetry is used in training and prediction. The rigid body is the textbook's; this
    arrangement is our own.
    """

    network: ClassVar[bool] = True
    stateful: ClassVar[bool] = False

    layers: int = option(1, "layers in series of the LSTM", low=1, high=20, search=(1, 2))
    hidden: int = option(24, "cells in each layer", low=1, high=2000, log=True, search=(8, 64))
    encoder: int = option(24, "cells of the GRU that reads the history", low=1, high=2000, log=True, search=(8, 64))
    dropout: float = option(0.2, "probability of dropping what the GRU passes on", low=0.0, high=0.9)
    mirrors: bool = option(
        True, "train on mirror images of windows and predict with the mean of all, where the rotors are symmetric"
    )
    jitter: float = option(
        1.0, "rotor speeds of a training window are delayed by up to ± this", unit="samples", low=0.0, high=10.0
    )
    weight_scale: float = option(1.0, "initial weights are uniform within ± this / √fan-in", low=0.0, high=10.0)
    forget_bias: float = option(1.0, "initial bias of the forget gates", low=-10.0, high=10.0)

    def signals(self, dataset: Dataset) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
        """See `PredictorEntry.signals`; the accelerometer is read where there is one."""
        if dataset.system != "quadrotor" or "rotor_speed" not in measured_signals(dataset):
            raise BenchError(
                f"The Load hybrid is for quadrotors whose rotor speeds were measured, which {dataset.label} does not "
                "hold: take a Hybrid or an LSTM."
            )
        refuse_unstated(dataset, Quadrotor)
        felt = ("specific_force",) if "specific_force" in measured_signals(dataset) else ()
        return ("rotor_speed",), ("velocity", "body_rates"), ("attitude", *felt)

    @override
    def build(self, problem: Problem) -> Predictor:
        return LoadHybridPredictor(self, problem)
