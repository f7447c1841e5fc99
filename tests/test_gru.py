"""The GRU against a plain-numpy transcription of its equations, against `torch.nn.GRU` and finite differences."""

from functools import partial

import numpy as np
import oracle
import pytest
import torch
from test_networks import noise, vivid, weights
from torch import Tensor, nn
from torch.func import functional_call

from registry import INITIALIZERS, PREDICTORS
from registry.contracts import Predictor, Problem
from registry.cost import prediction_cost
from registry.state_cost import state_initialization_cost

TAU, HIDDEN = 10, 4
close = partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-12)


def built(layers: int, m: int = 3, n: int = 2, hidden: int = HIDDEN) -> Predictor:
    torch.manual_seed(7)
    return vivid(PREDICTORS.get("GRU")(layers=layers, hidden=hidden).build(Problem.plain(m, n, 12, TAU)))


def gru_rollout(w: oracle.Weights, inputs, states, feedback=None):
    """inputs (B, T, m), states (B, n + L·H), feedback (B, T, n) or None → outputs (B, T, n), states after."""
    n, width = w["output_weight"].shape
    outputs, ends = np.empty((*inputs.shape[:2], n)), np.empty_like(states)
    for b in range(len(inputs)):
        y_before, hidden = states[b, :n], list(states[b, n:].reshape(-1, width))
        for k in range(inputs.shape[1]):
            x = np.concatenate([inputs[b, k], y_before])
            for layer, h in enumerate(hidden):
                w_r, w_z, w_v = np.split(w[f"input_weight.{layer}"], 3)
                u_r, u_z, u_v = np.split(w[f"recurrent_weight.{layer}"], 3)
                b_r, b_z, b_v = np.split(w[f"bias.{layer}"], 3)
                r = oracle.sigma(w_r @ x + u_r @ h + b_r)
                z = oracle.sigma(w_z @ x + u_z @ h + b_z)
                v = np.tanh(w_v @ x + b_v + r * (u_v @ h))
                x = hidden[layer] = z * h + (1 - z) * v
            outputs[b, k] = w["output_weight"] @ x + w["output_bias"]
            y_before = outputs[b, k] if feedback is None else feedback[b, k]
        ends[b] = np.concatenate([y_before, *hidden])
    return outputs, ends


@pytest.mark.parametrize(("layers", "m", "n"), [(1, 3, 2), (2, 3, 2), (3, 3, 2), (2, 0, 1)])
@pytest.mark.parametrize("measured", [False, True], ids=["own", "measured"])
def test_rollout_and_final_state_follow_the_equations(layers: int, m: int, n: int, measured: bool) -> None:
    predictor = built(layers, m, n)
    u, state = noise(3, 12, m, seed=3), noise(3, predictor.layout.size, seed=4)
    feedback = noise(3, 12, n, seed=5) if measured else None
    outputs, end = predictor.rollout(u, state, feedback)
    want = gru_rollout(weights(predictor), u.numpy(), state.numpy(), None if feedback is None else feedback.numpy())
    close(outputs.detach(), want[0])
    close(end.detach(), want[1])
    close(predictor.readout(end, u[:, -1]).detach(), want[0][:, -1])
    first, middle = predictor.rollout(u[:, :5], state, None if feedback is None else feedback[:, :5])
    second, last = predictor.rollout(u[:, 5:], middle, None if feedback is None else feedback[:, 5:])
    close(torch.cat([first, second], 1).detach(), want[0])
    close(last.detach(), want[1])


def test_layers_are_those_of_torch_where_nothing_is_fed_back() -> None:
    predictor = built(2)
    other = nn.GRU(3, HIDDEN, 2, batch_first=True).double()
    with torch.no_grad():
        predictor.input_weight[0][:, 3:] = 0
        for i in range(2):
            getattr(other, f"weight_ih_l{i}").copy_(predictor.input_weight[i][:, : 3 if i == 0 else HIDDEN])
            getattr(other, f"weight_hh_l{i}").copy_(predictor.recurrent_weight[i])
            getattr(other, f"bias_ih_l{i}").copy_(predictor.bias[i])
            getattr(other, f"bias_hh_l{i}").zero_()
    u, state = noise(3, 12, 3, seed=3), noise(3, predictor.layout.size, seed=4)
    outputs, end = predictor.rollout(u, state)
    top, last = other(u, state[:, 2:].unflatten(-1, (2, HIDDEN)).transpose(0, 1).contiguous())
    close(outputs.detach(), (top @ predictor.output_weight.mT + predictor.output_bias).detach())
    close(end[:, 2:].detach(), last.transpose(0, 1).flatten(1).detach())


class Trained(nn.Module):
    """Predictor and initializer as trained: outputs, final state and total cost."""

    def __init__(self, predictor: Predictor, how: str, **options: int) -> None:
        super().__init__()
        self.predictor = predictor
        self.initializer = INITIALIZERS.get(how)(**options).build(predictor, predictor.problem)

    def forward(self, u_past: Tensor, y_past: Tensor, u: Tensor, y: Tensor, own: bool = True) -> tuple[Tensor, ...]:
        state = self.initializer.initialize(self.predictor, u_past, y_past)
        outputs, end = self.predictor.rollout(u, state, None if own else y)
        cost = prediction_cost(outputs, y)
        if self.initializer.uses_state_cost:
            cost = cost + state_initialization_cost(self.predictor, state, u_past[..., -1, :], y_past[..., -1, :])
        return outputs, end, cost


@pytest.mark.parametrize("own", [True, False], ids=["own", "measured"])
@pytest.mark.parametrize(("how", "options"), [("Washout", {}), ("MLP", {"hidden": 2}), ("RNN", {"hidden": 2})])
def test_gradient_is_the_finite_difference(how: str, options: dict[str, int], own: bool) -> None:
    """Through initializer and run, with respect to every weight and the inputs."""
    model = vivid(Trained(built(2, 2, 1, hidden=2), how, history=4, **options))
    names = [n for n, _ in model.named_parameters()]
    u_past, u = noise(2, 4, 2, seed=1).requires_grad_(), noise(2, 4, 2, seed=3).requires_grad_()
    y_past, y = noise(2, 4, 1, seed=2), noise(2, 4, 1, seed=4)

    def run(u_past: Tensor, u: Tensor, *values: Tensor) -> tuple[Tensor, ...]:
        return functional_call(model, dict(zip(names, values, strict=True)), (u_past, y_past, u, y, own))

    values = [p.detach().clone().requires_grad_() for p in model.parameters()]
    assert torch.autograd.gradcheck(run, (u_past, u, *values))


def test_gradient_of_the_state_is_the_finite_difference() -> None:
    predictor = built(2, 2, 1, hidden=2)
    u, state = noise(2, 4, 2, seed=3), noise(2, predictor.layout.size, seed=4).requires_grad_()
    for feedback in (None, noise(2, 4, 1, seed=5)):
        assert torch.autograd.gradcheck(lambda s: predictor.rollout(u, s, feedback), state)  # noqa: B023


@pytest.mark.parametrize(("layers", "how", "batch"), [(1, "MLP", 64), (2, "Washout", 7), (2, "RNN", 64)])
def test_training_in_a_group_changes_no_bit(layers: int, how: str, batch: int) -> None:
    models = []
    for seed in range(3):
        torch.manual_seed(seed)
        predictor = PREDICTORS.get("GRU")(layers=layers, hidden=50).build(Problem.plain(4, 1, 40, TAU))
        models.append(Trained(predictor, how, history=TAU))
    shapes = [(TAU, 4), (TAU, 1), (40, 4), (40, 1)]
    data = [noise(3, batch, *shape, seed=i).float() for i, shape in enumerate(shapes)]

    def step(members: list[int]) -> tuple[Tensor, dict[str, Tensor]]:
        stacked = {
            n: torch.stack([models[i].get_parameter(n) for i in members]).detach().requires_grad_()
            for n, _ in models[0].named_parameters()
        }
        outputs, _, cost = functional_call(models[0], stacked, tuple(x[members] for x in data))
        cost.sum().backward()
        return outputs.detach(), {n: p.grad for n, p in stacked.items()}

    outputs, gradients = step([0, 1, 2])
    assert all((g.abs().flatten(1).sum(1) > 0).all() for g in gradients.values())
    for i in range(3):
        alone, own = step([i])
        assert torch.equal(alone[0], outputs[i])
        assert [n for n in own if not torch.equal(own[n][0], gradients[n][i])] == []
        torch.testing.assert_close(models[i](*(x[i] for x in data))[0], outputs[i], rtol=1e-5, atol=1e-6)


def test_weight_count_and_biases() -> None:
    """Three gates a layer, W (H × K), U (H × H) and b, and the read-out; at first the update gates keep the state."""
    m, n, h = 4, 3, 50
    gates = lambda k: 3 * (h * k + h * h + h)  # noqa: E731
    predictor = PREDICTORS.get("GRU")(layers=2, hidden=h).build(Problem.plain(m, n, 40, TAU))
    assert predictor.weight_count() == gates(m + n) + gates(h) + n * h + n
    assert predictor.layout.sizes == (n, 2 * h, 0)
    assert all(bias.unflatten(0, (3, h)).mean(1).tolist() == [0, 1, 0] for bias in predictor.bias)
