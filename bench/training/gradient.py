"""The training cost of a batch and its gradient: each network's own way back where it has one, else autograd.

Autograd's records cost a thin network a fifth of an update. Both ways give the same bits.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import torch
from torch import Tensor

from bench.training.model import Model, times
from registry.contracts import Composite, Gradients, Initializer, Predictor
from registry.cost import prediction_vjp
from registry.kernels.native.library import core_for
from registry.state_cost import state_initialization_vjp


def cost_and_gradient(
    model: Model, parameters: Mapping[str, Tensor], windows: tuple[Tensor, ...], alpha: float, beta: float
) -> tuple[Tensor, Gradients]:
    """The cost (…), one a model, as `Model.forward` gives it, and its gradients by the parameters that it depends on.

    Args:
        model: in training.
        parameters: its own, by name.
        windows: scaled; see `Model.forward`.
        alpha, beta: weights of the two costs.
    """
    p, first = model.predictor, model.initializer
    if first is not None and p.by_hand and _goes_back(type(p), _kinds(first)) and core_for(*windows) is not None:
        with torch.no_grad():
            return _by_hand(model, first, windows, alpha, beta)
    cost = model(*windows, alpha, beta)
    found = torch.autograd.grad(cost, list(parameters.values()), torch.ones_like(cost), allow_unused=True)
    return cost.detach(), _named(parameters, found)


def run_cost_and_gradient(
    predictor: Predictor, parameters: Mapping[str, Tensor], inputs: Tensor, state: Tensor, outputs: Tensor
) -> tuple[Tensor, Tensor, Gradients]:
    """The cost (…) of a run from a given state, and its gradients by the state and by the parameters."""
    if predictor.by_hand and _goes_back(type(predictor)) and core_for(inputs, state, outputs) is not None:
        with torch.no_grad():
            predicted, back = predictor.training_rollout_vjp(inputs, outputs, state)
            cost, slope = prediction_vjp(predicted, outputs, 1.0)
            return cost, *back(slope)
    cost = predictor.cost(predictor.training_rollout(inputs, outputs, state), outputs)
    d_state, *found = torch.autograd.grad(cost, [state, *parameters.values()], torch.ones_like(cost), allow_unused=True)
    return cost.detach(), d_state, _named(parameters, found)


def _named(parameters: Mapping[str, Tensor], found: Sequence[Tensor | None]) -> Gradients:
    return {name: g for name, g in zip(parameters, found, strict=True) if g is not None}


def _kinds(initializer: Initializer) -> tuple[type, ...]:
    """Its class, and those of its parts."""
    return (type(initializer), *(type(x) for x in getattr(initializer, "parts", ())))


@lru_cache
def _goes_back(predictor: type[Predictor], initializers: tuple[type, ...] = ()) -> bool:
    """Whether all have a way back, and nothing that it goes along was changed by a subclass alone."""
    run = "rollout" if predictor.training_rollout is Predictor.training_rollout else "training_rollout"
    pairs = [
        (run, f"{run}_vjp"),
        ("init_buffers", f"{run}_vjp"),
        ("training_rollout", "training_rollout_vjp"),
        ("readout", "readout_vjp"),
    ]
    pairs += [("join", "separate")] if issubclass(predictor, Composite) else []
    own = predictor.cost is Predictor.cost and all(_known(predictor, *pair) for pair in pairs)
    return own and all(_known(kind, "initialize", "initialize_vjp") for kind in initializers)


def _known(kind: type, method: str, vjp: str) -> bool:
    """Whether the product is of the class that defines the method, or of one that builds on it."""
    place = {name: next(i for i, c in enumerate(kind.__mro__) if name in vars(c)) for name in (method, vjp)}
    return place[vjp] <= place[method]


def _by_hand(
    model: Model, initializer: Initializer, windows: tuple[Tensor, ...], alpha: float, beta: float
) -> tuple[Tensor, Gradients]:
    p = model.predictor
    u_history, y_history, u, y = p.augment(windows)
    state, initial = initializer.initialize_vjp(p, u_history, y_history)
    extra: tuple[Tensor, Tensor, Gradients] | None = None
    if beta and initializer.uses_state_cost:  # before the long run, which empties the caches
        last = y_history[..., -1, : p.n_outputs]
        extra = state_initialization_vjp(p, state, u_history[..., -1, :], last, beta)
    predicted, back = p.training_rollout_vjp(u, y, state)
    cost, slope = prediction_vjp(predicted, y, alpha)
    cost = times(alpha, cost)
    d_state, gradients = back(slope)
    if extra is not None:
        distance, slope, more = extra
        cost = cost + times(beta, distance)
        d_state.add_(slope)
        _add(gradients, more)
    own, more = initial(d_state)
    _add(gradients, more)
    return cost, {f"predictor.{n}": g for n, g in gradients.items()} | {f"initializer.{n}": g for n, g in own.items()}


def _add(to: Gradients, more: Gradients) -> None:
    for name, gradient in more.items():
        to[name] = to[name].add_(gradient) if name in to else gradient
