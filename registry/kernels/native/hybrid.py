"""Input model, rigid body and output model of a hybrid, the whole sequence in C++ (hybrid.cpp)."""

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.kernels.native.call import Call, addresses, called, structure
from registry.kernels.native.library import Core
from registry.kernels.rigid_body import RigidBodyStep

Ends = list[tuple[Tensor, Tensor]]
"""Hidden and cell states (B, L·H) of each network."""


@dataclass(frozen=True)
class Network:
    """Weights without a model dimension, as for `registry.kernels.lstm_torch.run`, and states (B, L·H)."""

    weights: list[Tensor]
    hidden: Tensor
    cell: Tensor


@dataclass(frozen=True)
class HybridCoupling:
    """What stands between the networks and the body."""

    rows: Tensor
    """(n,) place of each output in the state."""
    scale: Tensor
    """(n,) of the outputs."""
    offset: Tensor
    """(n,) of the outputs."""
    load_scale: Tensor
    """(4,) of what the input model gives."""
    held: bool
    """Whether a load is held over a step."""
    added: bool
    """Whether the output model's outputs add to the body's."""


class _Structure(ctypes.Structure):
    """`Call` of hybrid.cpp."""

    _fields_ = structure(
        "batch steps inputs outputs layers cells networks added held keep input_gradient",
        "dt gravity",
        "u forced state given coupling load_scale scale offset rows hidden cell after before end_state end_hidden "
        "end_cell d_after d_before d_end_state d_end_hidden d_end_cell du d_state d_given d_coupling d_hidden d_cell "
        "weights gradients",
        "hidden cell end_hidden end_cell d_end_hidden d_end_cell d_hidden d_cell",
    )


class HybridCall(Call):
    """As `hybrid`, the states and the weights of one network after those of the other; ``keep``: for a way back."""

    family: ClassVar[str] = "hybrid"
    structure: ClassVar[type[ctypes.Structure]] = _Structure

    def __init__(
        self, core: Core, body: RigidBodyStep, links: HybridCoupling, forced: Tensor | None, u: Tensor, state: Tensor,
        given: Tensor | None, coupling: Tensor, *states: Tensor, weights: Sequence[Tensor], keep: bool,
    ) -> None:  # fmt: skip
        (batch, steps, m), n, self.networks = u.shape, len(links.rows), len(states) // 2
        each = len(weights) // self.networks
        super().__init__(
            core, u, batch=batch, steps=steps, inputs=m, outputs=n, layers=each // 4, cells=weights[1].shape[-1],
            networks=self.networks, added=links.added, held=links.held, keep=keep, dt=body.dt, gravity=body.gravity,
        )  # fmt: skip
        self.weights = [w.contiguous() for w in weights]
        self.y, self.states, self.given = (batch, steps, n), tuple(states[0].shape), given
        arrays = {"u": u, "forced": forced, "state": state, "given": given, "coupling": coupling}
        for name, x in arrays.items():
            self.point(name, x)
        for name in ("load_scale", "scale", "offset", "rows"):
            self.point(name, getattr(links, name))
        for i, x in enumerate(states):
            self.point(("hidden", "cell")[i % 2], x, i // 2)
        self.table("weights", addresses(self.weights))

    def _per_network(self, *names: str) -> list[Tensor]:
        return [self.new(name, self.states, i) for i in range(self.networks) for name in names]

    def forward(self) -> tuple[Tensor, ...]:
        """See `hybrid`."""
        made = self.new("after", self.y), self.new("before", self.y), self.new("end_state", (self.y[0], 13))
        ends = self._per_network("end_hidden", "end_cell")
        self.run("forward")
        return (*made, *ends)

    def backward(self, *slopes: Tensor | None, inputs_too: bool) -> tuple[Tensor | None, ...]:
        """Gradients of inputs, state, given loads, coupling, then states of each network, then weights."""
        held, shapes = len(self.held), (self.y, self.y, (self.y[0], 13), *[self.states] * (2 * self.networks))
        whole = [self.like.new_zeros(s) if x is None else x for x, s in zip(slopes, shapes, strict=True)]
        for name, x in zip(("d_after", "d_before", "d_end_state"), whole[:3], strict=True):
            self.point(name, x)
        for i, x in enumerate(whole[3:]):
            self.point(("d_end_hidden", "d_end_cell")[i % 2], x, i // 2)
        gradients = [torch.empty_like(w) for w in self.weights]
        self.table("gradients", addresses(gradients))
        self.fields.input_gradient = inputs_too
        du = self.new("du", tuple(self.like.shape)) if inputs_too else None
        given = self.given
        d_given = self.new("d_given", tuple(given.shape)) if given is not None and given.requires_grad else None
        made = du, self.new("d_state", (self.y[0], 13)), d_given, self.new("d_coupling", (3,))
        states = self._per_network("d_hidden", "d_cell")
        self.run("backward")
        del self.held[held:]
        return (*made, *states, *gradients)


def hybrid(
    core: Core,
    inputs: Tensor,
    state: Tensor,
    body: RigidBodyStep,
    links: HybridCoupling,
    networks: list[Network],
    given: Tensor | None = None,
    forced: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor, Ends]:
    """Run T steps.

    Args:
        core: the library.
        inputs: (B, T, m), scaled.
        state: (B, 13) of the body, SI, before the run.
        body: the body; its coupling may carry a gradient.
        links: scales, and how the parts are joined.
        networks: the input model, and the output model if there is one.
        given: (T, 3, 4, B) a further part of the loads, at start, middle and end of each step.
        forced: (B, T, n) outputs that are fed back in place of the model's own.

    Returns:
        outputs (B, T, n), those of the body before the output model (B, T, n), state (B, 13) after the run, and hidden
        and cell states (B, L·H) of each network after it.
    """
    arrays, weights = (inputs, state, given, body.coupling, *_states(networks)), _weights(networks)
    after, before, end, *ends = called(partial(HybridCall, core, body, links, forced), arrays, weights)
    return after, before, end, list(zip(ends[::2], ends[1::2], strict=True))


def _states(networks: list[Network]) -> list[Tensor]:
    return [s for network in networks for s in (network.hidden, network.cell)]


def _weights(networks: list[Network]) -> list[Tensor]:
    return [w for network in networks for w in network.weights]


VJP = Callable[[Tensor, Tensor, Ends], tuple[Tensor, Ends, list[Tensor]]]
"""From the gradients of outputs, of the body's state after a run and of the networks' to those of the body's state
before it, of the networks', and of the weights, network by network."""


def hybrid_vjp(
    core: Core,
    inputs: Tensor,
    state: Tensor,
    body: RigidBodyStep,
    links: HybridCoupling,
    networks: list[Network],
    given: Tensor | None = None,
    forced: Tensor | None = None,
) -> tuple[Tensor, Tensor, Ends, VJP]:
    """`hybrid` without autograd: outputs, the ends, and its vector-Jacobian product, to be called at most once."""
    count = len(networks)
    arrays: Any = (inputs, state, given, body.coupling, *_states(networks))
    run = HybridCall(core, body, links, forced, *arrays, weights=_weights(networks), keep=True)
    after, before, end, *ends = run.forward()

    def vjp(d_after: Tensor, d_end: Tensor, d_ends: Ends) -> tuple[Tensor, Ends, list[Tensor]]:
        slopes = (d_after, torch.zeros_like(before), d_end, *(d for pair in d_ends for d in pair))
        d_state, _, *found = (g for g in run.backward(*slopes, inputs_too=False) if g is not None)
        hidden, cells, weights = found[: 2 * count : 2], found[1 : 2 * count : 2], found[2 * count :]
        return d_state, list(zip(hidden, cells, strict=True)), weights

    return after, end, list(zip(ends[::2], ends[1::2], strict=True)), vjp
