"""What tests of networks share: drawn numbers, modules that run and that train, slopes, models in a group."""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor, nn
from torch.func import functional_call

from registry.contracts import Initializer, Predictor
from registry.cost import prediction_cost
from registry.state_cost import state_initialization_cost


def noise(*shape: int, seed: int, scale: float = 1.0) -> Tensor:
    return scale * torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def redrawn(module: nn.Module, scale: float = 0.6) -> nn.Module:
    """Every weight drawn anew: an initial value of zero would hide a wrong term."""
    with torch.no_grad():
        for i, p in enumerate(module.parameters()):
            p.copy_(noise(*p.shape, seed=100 + i, scale=scale))
    return module


def vivid(module: nn.Module, scale: float = 0.6) -> nn.Module:
    """`redrawn`, in float64."""
    return redrawn(module.double(), scale)


def weights(module: nn.Module) -> dict[str, np.ndarray]:
    return {name: value.detach().numpy() for name, value in module.state_dict().items()}


def close(actual: Tensor, expected: np.ndarray | Tensor, rtol: float = 1e-12) -> None:
    np.testing.assert_allclose(actual.detach().numpy(), expected, rtol=rtol, atol=1e-12)


def check_pieces(
    predictor: Predictor, u: Tensor, state: Tensor, feedback: Tensor | None = None, cut: int = 5, atol: float = 1e-10
) -> None:
    """A horizon in two pieces is the horizon; ``atol``: of the state after it, which may be large."""
    whole, end = predictor.rollout(u, state, feedback)
    fed = (None, None) if feedback is None else (feedback[:, :cut], feedback[:, cut:])
    first, middle = predictor.rollout(u[:, :cut], state, fed[0])
    second, last = predictor.rollout(u[:, cut:], middle, fed[1])
    torch.testing.assert_close(torch.cat([first, second], 1), whole, rtol=1e-10, atol=1e-10)
    torch.testing.assert_close(last, end, rtol=1e-10, atol=atol)


class Called(nn.Module):
    """A function of the data alone, its network a part of it, so that weights can be set from outside."""

    def __init__(self, network: nn.Module, run: Callable[..., tuple[Tensor, ...]]) -> None:
        super().__init__()
        self.network, self.run = network, run

    def forward(self, *data: Tensor | None) -> tuple[Tensor, ...]:
        return self.run(*data)


class Trained(nn.Module):
    """Predictor and initializer, if it has one, trained as one: outputs and total cost (eq. MS_Pred_Total_Cost)."""

    def __init__(self, predictor: Predictor, initializer: Initializer | None = None) -> None:
        super().__init__()
        self.predictor, self.initializer = predictor, initializer

    def forward(self, u_past: Tensor, y_past: Tensor, u: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        if self.initializer is None:
            state = self.predictor.init_buffers(u_past, y_past)
        else:
            state = self.initializer.initialize(self.predictor, u_past, y_past)
        outputs = self.predictor.training_rollout(u, y, state)
        cost = prediction_cost(outputs, y)
        if self.initializer is not None and self.initializer.uses_state_cost:
            cost = cost + state_initialization_cost(self.predictor, state, u_past[..., -1, :], y_past[..., -1, :])
        return outputs, cost


def leaves(network: nn.Module) -> dict[str, Tensor]:
    """The weights by name, as leaves of their own."""
    return {name: p.detach().clone().requires_grad_() for name, p in network.named_parameters()}


def check_slopes(network: nn.Module, *data: Tensor | None, fast: bool = False) -> None:
    """The slopes of what a module gives to its weights, and to the data that want them, are finite differences."""
    own = leaves(network)

    def run(*values: Tensor | None) -> tuple[Tensor, ...]:
        given = dict(zip(own, values[len(data) :], strict=True))
        return functional_call(network, given, values[: len(data)])

    assert torch.autograd.gradcheck(run, (*data, *own.values()), fast_mode=fast)


def check_group(models: Sequence[nn.Module], shapes: Sequence[tuple[int, ...]], batch: int, tolerance: float) -> None:
    """Outputs, cost and slopes of a stack are those of stacks of one, bit for bit, and nearly of each model alone."""
    data = [noise(len(models), batch, *shape, seed=i).float() for i, shape in enumerate(shapes)]
    own = [dict(model.named_parameters()) for model in models]

    def step(members: list[int]) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        stacked = {n: torch.stack([own[i][n] for i in members]).detach().requires_grad_() for n in own[0]}
        outputs, cost = functional_call(models[0], stacked, tuple(x[members] for x in data))
        cost.sum().backward()
        return outputs.detach(), cost.detach(), {n: p.grad for n, p in stacked.items()}

    outputs, cost, slopes = step(list(range(len(models))))
    assert cost.shape == (len(models),) and cost.isfinite().all()
    assert all((g.abs().flatten(1).sum(1) > 0).all() for g in slopes.values())
    for i, model in enumerate(models):
        alone, own_cost, own_slopes = step([i])
        assert torch.equal(alone[0], outputs[i]) and torch.equal(own_cost[0], cost[i])
        assert [n for n in own_slopes if not torch.equal(own_slopes[n][0], slopes[n][i])] == []
        single = model(*(x[i] for x in data))
        torch.testing.assert_close(single, (outputs[i], cost[i]), rtol=10 * tolerance, atol=tolerance)
