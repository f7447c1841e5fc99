"""The TCN against a plain-numpy transcription: convolutions as sums over taps, the free run from scratch every step."""

import numpy as np
import oracle
import pytest
import torch
from networks import close, noise, vivid, weights

from registry import PREDICTORS
from registry.contracts import Predictor, Problem

SHAPES = [(1, 3, 2, 2), (2, 3, 2, 2), (3, 2, 3, 1), (2, 0, 2, 1)]


def built(
    layers: int = 2, m: int = 3, kernel: int = 2, n: int = 2, hidden: int = 4, mode: str = "parallel"
) -> Predictor:
    entry = PREDICTORS.get("TCN")(layers=layers, hidden=hidden, kernel=kernel, mode=mode)
    return vivid(entry.build(Problem.plain(m, n, 12, 5)))


def convolution(w: oracle.Weights, name: str, x, dilation: int):
    """(N, c) → (N, width); what is before the first sample counts as none, and is not looked at by the caller."""
    taps, y = w[f"{name}.weight"], []
    for k in range(len(x)):
        y.append(w[f"{name}.bias"] + sum(taps[j] @ x[k - j * dilation] for j in range(len(taps)) if k >= j * dilation))
    return np.array(y)


def network(w: oracle.Weights, x):
    """Output (n,) at the last of the samples (N, m + n)."""
    for i in range(sum(name.endswith("first.bias") for name in w)):
        inner = np.maximum(convolution(w, f"blocks.{i}.first", x, 2**i), 0)
        inner = np.maximum(convolution(w, f"blocks.{i}.second", inner, 2**i), 0)
        skip = w.get(f"blocks.{i}.skip")
        x = np.maximum((x if skip is None else x @ skip.T) + inner, 0)
    return w["output_weight"] @ x[-1] + w["output_bias"]


def tcn(w: oracle.Weights, field: int, past_u, past_y, u, y=None):
    """One window: histories (τ, m), (τ, n), inputs (T, m), measured outputs (T, n) or None → outputs (T, n)."""
    short = max(0, field - len(past_u))
    us, ys = [past_u[0]] * short + [*past_u, *u], [past_y[0]] * short + [*past_y]
    predicted = []
    for k in range(len(us) - len(u), len(us)):
        x = np.array([np.concatenate([us[j], ys[j - 1]]) for j in range(k - field + 1, k + 1)])
        predicted.append(network(w, x))
        ys.append(predicted[-1] if y is None else y[len(predicted) - 1])
    return np.array(predicted)


@pytest.mark.parametrize(("layers", "m", "kernel", "n"), SHAPES)
@pytest.mark.parametrize("measured", [False, True], ids=["own", "measured"])
@pytest.mark.parametrize("tau", [2, 30])
def test_runs_follow_the_equations(layers: int, m: int, kernel: int, n: int, measured: bool, tau: int) -> None:
    predictor = built(layers, m, kernel, n)
    assert predictor.history == 1 + 2 * (kernel - 1) * (2**layers - 1)
    past_u, past_y, u, y = (noise(3, *s, seed=i) for i, s in enumerate([(tau, m), (tau, n), (9, m), (9, n)]))
    feedback, state = y if measured else None, predictor.init_buffers(past_u, past_y)
    assert state.shape[-1] == predictor.layout.size
    windows = zip(past_u.numpy(), past_y.numpy(), u.numpy(), y.numpy(), strict=True)
    w = weights(predictor)
    want = np.array([tcn(w, predictor.history, *d[:3], d[3] if measured else None) for d in windows])
    outputs, end = predictor.rollout(u, state, feedback)
    close(outputs, want)
    sequence = torch.cat([past_y, y if measured else torch.from_numpy(want)], 1)
    if tau > predictor.history:
        close(end, predictor.init_buffers(torch.cat([past_u, u], 1), sequence))


def test_series_parallel_training_looks_at_one_step_predictions() -> None:
    predictor, free = built(mode="series-parallel"), built()
    u, y, state = noise(2, 9, 3, seed=1), noise(2, 9, 2, seed=2), noise(2, predictor.layout.size, seed=4)
    assert torch.equal(predictor.training_rollout(u, y, state), predictor.rollout(u, state, y)[0])
    assert torch.equal(free.training_rollout(u, y, state), free.rollout(u, state)[0])
    assert not torch.allclose(free.training_rollout(u, y, state), predictor.training_rollout(u, y, state))
