"""The hybrid model: a physics model between two networks, one that drives it and one that corrects it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from typing_extensions import override

from registry.contracts import (
    Composite,
    Dataset,
    Gradients,
    Predictor,
    PredictorEntry,
    Problem,
    ReadoutVJP,
    RunVJP,
    StateLayout,
)
from registry.core import PREDICTORS, option
from registry.kernels.mlp import affine, mlp_vjp
from registry.kernels.native import hybrid as native
from registry.kernels.native.library import core_for
from registry.physics.quadrotor import Quadrotor
from registry.predictors.baselines.physics import digest
from registry.predictors.lstm import names
from registry.predictors.parts.hybrid_network import Network, RunningNetwork
from registry.predictors.parts.physics_core import (
    GeneralCore,
    PhysicsCore,
    RigidBodyCore,
    uncertain_constants,
    with_constants,
)
from registry.predictors.parts.weights import single
from registry.predictors.parts.white_box import WhiteBox, default_signals

States = native.Ends
Ran = tuple[Tensor, Tensor, Tensor, States]
"""Outputs (B, T, n), those before compensation, and the states after the run: of the physics model, of the networks."""


class HybridPredictor(Composite):
    """Input model, physics model and output model; see `Hybrid`.

    State: [what drives the physics model at k0 and its full state, SI | hidden | cell], the input model's before the
    output model's.
    """

    def __init__(self, entry: "Hybrid", problem: Problem) -> None:
        super().__init__(problem)
        self.history = problem.history
        self.residual, self.added = entry.input_model == "residual", entry.output_model == "added"
        thrust = WhiteBox(problem, entry.model, driven=False).bare
        self.box = WhiteBox(problem, entry.model, self.residual or not thrust, sought=entry.start == "sought")
        m, n, drives = self.n_inputs, self.n_outputs, len(self.box.drives)
        given = 4 if thrust else drives - self.box.extras
        self.input_network = Network(entry, problem, m + n, given)
        self.output_network = Network(entry, problem, m + n + given, n) if entry.output_model != "none" else None
        networks = ("input_network", "output_network")[: len(self._networks())]
        self.names = [f"{network}.{name}" for network in networks for name in names(entry.layers)]
        self.by_hand = thrust and not entry.fit_constants
        self.views = ("uncompensated",) if self.output_network is not None else ()
        if thrust and not self.residual:
            with torch.no_grad():
                self.input_network.output_bias[0] = 1.0  # as much thrust as weight
        count = sum(torch.as_tensor(p.value).numel() for p in uncertain_constants(self.box.model))
        self.constants = nn.Parameter(torch.zeros(count)) if entry.fit_constants else None
        layouts = [part.layout for part in self.parts()]
        self.layout = StateLayout(drives + self.box.size, sum(x.hidden for x in layouts), sum(x.cell for x in layouts))
        into, out = torch.zeros(n, self.box.size), torch.zeros(self.box.size, n)
        into[range(n), self.box.rows] = out[self.box.rows, range(n)] = 1.0
        self.register_buffer("picking", into, persistent=False)
        self.register_buffer("putting", out, persistent=False)
        self.register_buffer("rows", torch.tensor(self.box.rows), persistent=False)
        self.rows: Tensor
        self.picking: Tensor
        self.putting: Tensor

    # ----------------------------------------------------------------------------------------- initialization

    @override
    def parts(self) -> list[Predictor]:
        return list(self._networks())

    def _networks(self) -> list[Network]:
        return [x for x in (self.input_network, self.output_network) if x is not None]

    def part_history(self, part: int, inputs: Tensor, outputs: Tensor) -> tuple[Tensor, Tensor]:
        """All that was measured, for both."""
        return inputs, outputs

    @override
    def join(self, states: Sequence[Tensor], inputs: Tensor, outputs: Tensor) -> Tensor:
        _, hidden, cell = zip(*(p.layout.split(s) for p, s in zip(self.parts(), states, strict=True)), strict=True)
        return torch.cat([self.init_buffers(inputs, outputs), *hidden, *cell], -1)

    @override
    def separate(self, d_state: Tensor) -> list[Tensor]:
        return [torch.cat(pair, -1) for pair in self._ends(d_state)]

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """What drives the physics model at k0, and its full state as the history leaves it, SI."""
        return self.box.init_buffers(self, inputs, outputs)

    def readout(self, state: Tensor, inputs: Tensor) -> Tensor | None:
        """ŷ_{k0}: what the output model adds at k0 to the measured y_{k0}, from which the physics model starts."""
        if self.output_network is None:
            return None
        last = self.output_network
        return self._from(state, affine(self._top(state, last), last.output_weight, last.output_bias))

    @override
    def readout_vjp(self, state: Tensor, inputs: Tensor) -> tuple[Tensor, ReadoutVJP] | None:
        last = self.output_network
        if last is None:
            return None
        read, back = mlp_vjp(self._top(state, last), [(last.output_weight, last.output_bias)])

        def vjp(d_read: Tensor, d_state: Tensor) -> Gradients:
            d_top, (d_weight, d_bias) = back(d_read, True)
            assert d_top is not None
            self._top(d_state, last).add_(d_top)
            return {"output_network.output_weight": d_weight, "output_network.output_bias": d_bias}

        return self._from(state, read), vjp

    def _top(self, state: Tensor, last: Network) -> Tensor:
        """The hidden states that the output model's read-out sees, a part of the state."""
        end = self.layout.buffer + self.layout.hidden
        return state[..., end - last.output_weight.shape[-1] : end]

    def _from(self, state: Tensor, read: Tensor) -> Tensor:
        """ŷ_{k0} from what the output model says."""
        buffer, _, _ = self.layout.split(state)
        return read + self.output_scaler(self._states(buffer)[..., self.box.rows]) if self.added else read

    # ---------------------------------------------------------------------------------------------- prediction

    @override
    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        outputs, _, end = self._run(inputs, state, feedback)
        return outputs, end

    def rollout_vjp(
        self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None
    ) -> tuple[Tensor, Tensor, RunVJP]:
        """See `Predictor.rollout_vjp`; for a rigid body without effects. What drives it is measured: no gradient."""
        if inputs.dim() == 4:
            fed = None if feedback is None else feedback[0]
            outputs, end, back = self.rollout_vjp(inputs[0], state[0], fed)

            def of_one(d_outputs: Tensor | None, d_end: Tensor | None) -> tuple[Tensor, Gradients]:
                d_state, found = back(*(None if d is None else d[0] for d in (d_outputs, d_end)))
                return d_state.unsqueeze(0), {name: g.unsqueeze(0) for name, g in found.items()}

            return outputs.unsqueeze(0), end.unsqueeze(0), of_one
        last, start, motion = self._start(inputs, state)
        core = core_for(inputs, state, feedback, self.input_network.output_weight)
        assert core is not None and isinstance(motion, RigidBodyCore)
        run = self._native(inputs, start, motion, self._ends(state), feedback)
        outputs, x, ends, through_time = native.hybrid_vjp(core, *run)
        end = self._end(last, x, ends)

        def vjp(d_outputs: Tensor | None, d_end: Tensor | None) -> tuple[Tensor, Gradients]:
            d_outputs = torch.zeros_like(outputs) if d_outputs is None else d_outputs
            d_end = torch.zeros_like(end) if d_end is None else d_end
            d_x = self._states(self.layout.split(d_end)[0])
            d_start, d_states, weights = through_time(d_outputs, d_x, self._ends(d_end))
            gradients = dict(zip(self.names, weights, strict=True))
            return self._end(torch.zeros_like(last), d_start, d_states), gradients

        return outputs, end, vjp

    def view(self, name: str, inputs: Tensor, outputs: Tensor, state: Tensor) -> Tensor:
        """What the physics model says in the free run, before the output model corrects it; the one view."""
        return self._run(inputs, state, None)[1]

    def _run(self, inputs: Tensor, state: Tensor, feedback: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """Outputs (…, B, T, n), those before compensation, and the state (…, B, s) after the run."""
        if inputs.dim() == 4:
            one = self._run(inputs[0], state[0], None if feedback is None else feedback[0])
            return one[0].unsqueeze(0), one[1].unsqueeze(0), one[2].unsqueeze(0)
        last, start, motion = self._start(inputs, state)
        core = core_for(inputs, state, feedback, self.input_network.output_weight)
        if core is not None and isinstance(motion, RigidBodyCore):
            run = self._native(inputs, start, motion, self._ends(state), feedback)
            after, before, x, ends = native.hybrid(core, *run)
        else:
            after, before, x, ends = self._loop(inputs, start, motion, self._ends(state), feedback)
        return after, before, self._end(last, x, ends)

    def _start(self, inputs: Tensor, state: Tensor) -> tuple[Tensor, Tensor, PhysicsCore]:
        """What drives the physics model at the end of a run, its state before it, and what moves it."""
        buffer, _, _ = self.layout.split(state)
        driving = self.input_scaler.invert(inputs)[..., self.box.drives]
        last = driving[..., -1, :] if inputs.shape[-2] else buffer[..., : len(self.box.drives)]
        return last, self._states(buffer), self._motion(buffer[..., : len(self.box.drives)], driving)

    def _ends(self, state: Tensor) -> States:
        """The states of each network, parts of the state."""
        _, hidden, cell = self.layout.split(state)
        sizes = [p.layout.hidden for p in self._networks()]
        return list(zip(hidden.split(sizes, -1), cell.split(sizes, -1), strict=True))

    def _end(self, last: Tensor, x: Tensor, ends: States) -> Tensor:
        """The state of the whole."""
        hidden, cell = (torch.cat(pair, -1) for pair in zip(*ends, strict=True))
        return torch.cat([last, x, hidden, cell], -1)

    def _loop(self, inputs: Tensor, x: Tensor, motion: PhysicsCore, states: States, feedback: Tensor | None) -> Ran:
        """Step by step, for any physics."""
        networks = [RunningNetwork(p, *pair) for p, pair in zip(self._networks(), states, strict=True)]
        first, second = networks[0], networks[1] if len(networks) > 1 else None
        scale, offset = self.output_scaler.scale, self.output_scaler.offset
        picking, putting = self.picking / scale.unsqueeze(-1), self.putting * scale
        ground = (-offset / scale).unsqueeze(-1)
        x = x.T
        y = torch.addmm(ground, picking, x)
        u = inputs.permute(1, 2, 0).contiguous()  # (T, m, B)
        fed = None if feedback is None else feedback.permute(1, 2, 0)
        start = motion.load(first.read())
        outputs: list[Tensor] = []
        uncompensated: list[Tensor] = []
        for k in range(len(u)):
            given = first.step(u[k], y)
            end = motion.load(given)
            x = motion.step(k, x, start, end)
            moved = torch.addmm(ground, picking, x)
            y = moved
            if second is not None:
                own = second.step(moved, given, u[k])
                y = moved + own if self.added else own
            outputs.append(y)
            uncompensated.append(moved)
            y = y if fed is None else fed[k]
            if y is not moved:
                x = torch.addmm(x, putting, y - moved)
            start = end
        after, before = (torch.stack(series).permute(2, 0, 1) for series in (outputs, uncompensated))
        return after, before, x.T, [network.ends() for network in networks]

    def _native(
        self, inputs: Tensor, x: Tensor, motion: RigidBodyCore, states: States, feedback: Tensor | None
    ) -> tuple[Any, ...]:
        """What `native.hybrid` is given, for all steps in one call."""
        scaler = self.output_scaler
        links = native.HybridCoupling(
            self.rows, scaler.scale, scaler.offset, motion.scale.squeeze(-1), motion.held, self.added
        )
        networks = [native.Network(p.weights(), *pair) for p, pair in zip(self._networks(), states, strict=True)]
        return inputs, x, motion.body, links, networks, motion.given, feedback

    def _states(self, buffer: Tensor) -> Tensor:
        return buffer[..., len(self.box.drives) :]

    def _motion(self, before: Tensor, driving: Tensor) -> PhysicsCore:
        model: Any = self.box.model
        if self.constants is not None:
            model = with_constants(model, single(self.constants, 1))
        if self.box.bare:
            assert isinstance(model, Quadrotor)
            return RigidBodyCore(self.box, model, before, driving, self.residual)
        own = self.box.drives[: len(self.box.drives) - self.box.extras]
        scale = self.input_scaler.offset[own], self.input_scaler.scale[own]
        return GeneralCore(self.box, model, before, driving, self.residual, scale)


@PREDICTORS.register("Hybrid")
@dataclass(frozen=True)
class Hybrid(PredictorEntry):
    """A physics model between two LSTM networks, trained as one: the first drives it, the second corrects it.

    Mohajerin and Waslander, section "Hybrid model". Corrected outputs go back to the input model and to the physics
    model, whose other states, such as attitude and position, loop inside it. The output model sees what the physics
    model says, the inputs, and what the input model gives.
    """

    network: ClassVar[bool] = True

    layers: int = option(1, "layers in series, of each network", low=1, high=20, search=(1, 2))
    hidden: int = option(50, "cells in each layer", low=1, high=2000, log=True, search=(10, 100))
    input_model: str = option(
        "learned",
        "thrust and torques (of other models: the driving signal) are learned, or the nominal ones plus a learned part",
        choices=("learned", "residual"),
    )
    output_model: str = option(
        "added",
        "the output model is added to the physics model (paper), predicts alone, or is left out",
        choices=("added", "alone", "none"),
    )
    model: str = option("", "path of a model.toml, as `bench extend` writes it; empty: nominal constants")
    start: str = option(
        "zero",
        "unmeasured states at the start of the history: zero, or sought so that a free run meets the history best",
        choices=("zero", "sought"),
    )
    fit_constants: bool = option(False, "train uncertain physical constants too, within 10 standard deviations")
    weight_scale: float = option(1.0, "initial weights are uniform within ± this / √fan-in", low=0.0, high=10.0)
    forget_bias: float = option(1.0, "initial bias of the forget gates", low=-10.0, high=10.0)

    @override
    def signals(self, dataset: Dataset) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
        inputs, outputs, context = default_signals(dataset, self.model)
        return dataset.inputs if self.input_model == "learned" else inputs, outputs, context

    @override
    def content(self) -> str:
        return digest(self.model)

    @override
    def build(self, problem: Problem) -> Predictor:
        return HybridPredictor(self, problem)


@PREDICTORS.register("Hybrid residual")
@dataclass(frozen=True)
class HybridResidual(Hybrid):
    """`Hybrid` whose input model adds to what the nominal rotors make: untrained, it is the physics model.

    An alternative to the paper's, for physics whose input map is known.
    """

    input_model: str = option(
        "residual", "the nominal map of the rotor speeds plus a learned part", choices=("residual",)
    )


@PREDICTORS.register("Hybrid unsummed")
@dataclass(frozen=True)
class HybridUnsummed(Hybrid):
    """`Hybrid` whose output model predicts alone: the physics model reaches the output through it only.

    The paper expects the physics to be ignored then (section "Hybrid model").
    """

    output_model: str = option("alone", "the output model predicts alone", choices=("alone",))
