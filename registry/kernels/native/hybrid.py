"""Input model, rigid body and output model of a hybrid, the whole sequence in C++ (hybrid.cpp)."""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from registry.kernels.native.call import Call, addresses, structure
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
    """Arguments as for `hybrid`; ``keep``: for a way back."""

    family: ClassVar[str] = "hybrid"
    structure: ClassVar[type[ctypes.Structure]] = _Structure

    def __init__(
        self, core: Core, body: RigidBodyStep, links: HybridCoupling, arrays: dict[str, Tensor | None],
        networks: list[Network], keep: bool,
    ) -> None:  # fmt: skip
        u = arrays["u"]
        assert u is not None
        (batch, steps, m), n, count = u.shape, len(links.rows), len(networks[0].weights)
        cells = networks[0].weights[1].shape[-1]
        super().__init__(
            core, u, batch=batch, steps=steps, inputs=m, outputs=n, layers=count // 4, cells=cells,
            networks=len(networks), added=links.added, held=links.held, keep=keep, dt=body.dt, gravity=body.gravity,
        )  # fmt: skip
        self.weights = [w.contiguous() for network in networks for w in network.weights]
        self.y, self.states = (batch, steps, n), networks[0].hidden.shape
        self.networks, self.given = len(networks), arrays["given"]
        for name, x in arrays.items():
            self.point(name, x)
        for name in ("load_scale", "scale", "offset", "rows"):
            self.point(name, getattr(links, name))
        for i, network in enumerate(networks):
            self.point("hidden", network.hidden, i)
            self.point("cell", network.cell, i)
        self.table("weights", addresses(self.weights))

    def _per_network(self, *names: str) -> list[Tensor]:
        return [self.new(name, self.states, i) for i in range(self.networks) for name in names]

    def forward(self) -> tuple[Tensor, ...]:
        """See `hybrid`."""
        made = self.new("after", self.y), self.new("before", self.y), self.new("end_state", (self.y[0], 13))
        ends = self._per_network("end_hidden", "end_cell")
        self.run("forward")
        return (*made, *ends)

    def backward(self, given: tuple[Tensor, ...], inputs_too: bool, given_too: bool) -> tuple[Tensor | None, ...]:
        """Gradients of inputs, state, given loads, coupling, then states of each network, then weights."""
        held = len(self.held)
        for name, x in zip(("d_after", "d_before", "d_end_state"), given[:3], strict=True):
            self.point(name, x)
        for i, x in enumerate(given[3:]):
            self.point(("d_end_hidden", "d_end_cell")[i % 2], x, i // 2)
        gradients = [torch.empty_like(w) for w in self.weights]
        self.table("gradients", addresses(gradients))
        self.fields.input_gradient = inputs_too
        du = self.new("du", tuple(self.like.shape)) if inputs_too else None
        d_given = self.new("d_given", tuple(self.given.shape)) if given_too and self.given is not None else None
        made = du, self.new("d_state", (self.y[0], 13)), d_given, self.new("d_coupling", (3,))
        states = self._per_network("d_hidden", "d_cell")
        self.run("backward")
        del self.held[held:]
        return (*made, *states, *gradients)


class _Hybrid(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, core: Core, body: RigidBodyStep, links: HybridCoupling, forced: Tensor | None, count: int,
        *tensors: Any,
    ) -> tuple[Tensor, ...]:  # fmt: skip
        ctx.save_for_backward(*tensors[4 + 2 * count :])
        ctx.run = _assembled(core, body, links, forced, count, tensors, keep=True)
        made: tuple[Tensor, ...] = ctx.run.forward()
        return made

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        _ = ctx.saved_tensors
        return (*[None] * 5, *ctx.run.backward(grads, ctx.needs_input_grad[5], ctx.needs_input_grad[7]))


def _assembled(
    core: Core, body: RigidBodyStep, links: HybridCoupling, forced: Tensor | None, count: int, tensors: Any, keep: bool
) -> HybridCall:
    """From a flat list: inputs, state, given, coupling, states of each network, weights of each."""
    u, state, given, coupling, *rest = tensors
    states, weights = rest[: 2 * count], rest[2 * count :]
    each = len(weights) // count
    networks = [Network(weights[i * each : (i + 1) * each], states[2 * i], states[2 * i + 1]) for i in range(count)]
    arrays = {"u": u, "forced": forced, "state": state, "given": given, "coupling": coupling}
    return HybridCall(core, body, links, arrays, networks, keep)


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
    states = [s for network in networks for s in (network.hidden, network.cell)]
    weights = [w for network in networks for w in network.weights]
    tensors = (inputs, state, given, body.coupling, *states, *weights)
    if torch.is_grad_enabled() and any(x is not None and x.requires_grad for x in tensors):
        made: tuple[Tensor, ...] = _Hybrid.apply(core, body, links, forced, len(networks), *tensors)
    else:
        made = _assembled(core, body, links, forced, len(networks), tensors, keep=False).forward()
    after, before, end, *ends = made
    return after, before, end, list(zip(ends[::2], ends[1::2], strict=True))


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
    arrays = {"u": inputs, "forced": forced, "state": state, "given": given, "coupling": body.coupling}
    run, count = HybridCall(core, body, links, arrays, networks, keep=True), len(networks)
    after, before, end, *ends = run.forward()

    def vjp(d_after: Tensor, d_end: Tensor, d_ends: Ends) -> tuple[Tensor, Ends, list[Tensor]]:
        slopes = (d_after, torch.zeros_like(before), d_end, *(d for pair in d_ends for d in pair))
        d_state, _, *found = (g for g in run.backward(slopes, inputs_too=False, given_too=False) if g is not None)
        hidden, cells, weights = found[: 2 * count : 2], found[1 : 2 * count : 2], found[2 * count :]
        return d_state, list(zip(hidden, cells, strict=True)), weights

    return after, end, list(zip(ends[::2], ends[1::2], strict=True)), vjp
