"""The GRU against a plain-numpy transcription of its equations, against `torch.nn.GRU` and finite differences."""

import numpy as np
import oracle
import pytest
import torch
from networks import Trained, check_slopes, close, noise, vivid, weights
from torch import nn

from registry import INITIALIZERS, PREDICTORS
from registry.contracts import Predictor, Problem

TAU, HIDDEN = 10, 4


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
    close(outputs, want[0])
    close(end, want[1])
    close(predictor.readout(end, u[:, -1]), want[0][:, -1])


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
    close(outputs, (top @ predictor.output_weight.mT + predictor.output_bias).detach())
    close(end[:, 2:], last.transpose(0, 1).flatten(1).detach())


@pytest.mark.parametrize(("how", "options"), [("Washout", {}), ("MLP", {"hidden": 2}), ("RNN", {"hidden": 2})])
def test_gradient_is_the_finite_difference(how: str, options: dict[str, int]) -> None:
    """Through initializer and run, with respect to every weight and the inputs."""
    predictor = built(2, 2, 1, hidden=2)
    initializer = INITIALIZERS.get(how)(history=4, **options).build(predictor, predictor.problem)
    u_past, u = noise(2, 4, 2, seed=1).requires_grad_(), noise(2, 4, 2, seed=3).requires_grad_()
    check_slopes(vivid(Trained(predictor, initializer)), u_past, noise(2, 4, 1, seed=2), u, noise(2, 4, 1, seed=4))


def test_weight_count_and_biases() -> None:
    """Three gates a layer, W (H × K), U (H × H) and b, and the read-out; at first the update gates keep the state."""
    m, n, h = 4, 3, 50
    gates = lambda k: 3 * (h * k + h * h + h)  # noqa: E731
    predictor = PREDICTORS.get("GRU")(layers=2, hidden=h).build(Problem.plain(m, n, 40, TAU))
    assert predictor.weight_count() == gates(m + n) + gates(h) + n * h + n
    assert predictor.layout.sizes == (n, 2 * h, 0)
    assert all(bias.unflatten(0, (3, h)).mean(1).tolist() == [0, 1, 0] for bias in predictor.bias)
