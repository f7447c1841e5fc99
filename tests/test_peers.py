"""The predictors of elsewhere: what they compute, beside plain loops; how they train and what they refuse."""

import sys

import numpy as np
import pytest
import torch
from conftest import Toy
from networks import noise

from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse
from bench.training.run import run_group
from registry.contracts import Problem
from registry.core import PREDICTORS
from registry.errors import BenchError


def test_the_lstm_of_pytorch_runs_from_its_state() -> None:
    torch.manual_seed(0)
    p = PREDICTORS.get("torch LSTM")(layers=2, hidden=5).build(Problem.plain(3, 2, 9, 4)).double()
    u, state = noise(4, 9, 3, seed=1), noise(4, 20, seed=2)
    outputs, end = p.rollout(u, state)
    w = {k: v.detach().numpy() for k, v in p.state_dict().items()}
    h, c = (list(x) for x in state.numpy().reshape(4, 2, 2, 5).transpose(1, 2, 0, 3))
    sigma = lambda x: 1 / (1 + np.exp(-x))  # noqa: E731
    for k in range(9):
        x = u[:, k].numpy()
        for i in range(2):
            g = x @ w[f"network.weight_ih_l{i}"].T + w[f"network.bias_ih_l{i}"]
            g = g + h[i] @ w[f"network.weight_hh_l{i}"].T + w[f"network.bias_hh_l{i}"]
            gate_i, gate_f, gate_c, gate_o = np.split(g, 4, axis=1)
            c[i] = sigma(gate_f) * c[i] + sigma(gate_i) * np.tanh(gate_c)
            x = h[i] = sigma(gate_o) * np.tanh(c[i])
        expected = x @ w["head.weight"].T + w["head.bias"]
        np.testing.assert_allclose(outputs[:, k].detach().numpy(), expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(end.detach().numpy(), np.concatenate([*h, *c], 1), rtol=1e-12, atol=1e-12)
    _, middle = p.rollout(u[:, :4], state)
    np.testing.assert_allclose(p.rollout(u[:, 4:], middle)[0].detach(), outputs[:, 4:].detach(), rtol=1e-12)


def known(u: np.ndarray, start: tuple[float, float]) -> np.ndarray:
    """y_k = .6 y_{k−1} − .2 y_{k−2} + .3 u_k − .1 u_{k−1} y_{k−1} + .05 y_{k−1}³."""
    y = [*start]
    for k in range(2, len(u)):
        y.append(0.6 * y[-1] - 0.2 * y[-2] + 0.3 * u[k] - 0.1 * u[k - 1] * y[-1] + 0.05 * y[-1] ** 3)
    return np.array(y)


def test_pysindy_finds_a_known_polynomial_and_simulates_it() -> None:
    pytest.importorskip("pysindy", reason="PySINDy is not installed: the extra `peers`")
    p = PREDICTORS.get("PySINDy")(delays=2, degree=3, threshold=0.02, ridge=0.0).build(Problem.plain(1, 1, 20, 4))
    p = p.double()
    u = noise(40, 24, 1, seed=3)
    y = torch.tensor(np.stack([known(w[:, 0].numpy(), (0.1 * i / 40, 0.2)) for i, w in enumerate(u)])).unsqueeze(-1)
    p.fit(u[:, :4], y[:, :4], u[:, 4:], y[:, 4:])
    assert p.weight_count() == 5
    kept = {
        tuple(map(int, p.powers[i])): round(float(p.coefficients[0, i]), 6) for i in p.coefficients[0].nonzero()[:, 0]
    }
    assert kept == {  # columns: u_k, u_{k−1}, y_{k−1}, y_{k−2}
        (1, 0, 0, 0): 0.3,
        (0, 0, 1, 0): 0.6,
        (0, 0, 0, 1): -0.2,
        (0, 1, 1, 0): -0.1,
        (0, 0, 3, 0): 0.05,
    }
    outputs, _ = p.rollout(u[:, 4:], p.init_buffers(u[:, :4], y[:, :4]))
    torch.testing.assert_close(outputs, y[:, 4:], rtol=1e-8, atol=1e-8)


def test_what_cannot_be_and_a_missing_package_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BenchError, match="fewer delays"):
        PREDICTORS.get("PySINDy")(delays=20, degree=5).build(Problem.plain(1, 1, 20, 20))
    with pytest.raises(BenchError, match="there are none"):
        PREDICTORS.get("torch LSTM")().build(Problem.plain(0, 1, 20, 4))
    p = PREDICTORS.get("PySINDy")().build(Problem.plain(1, 1, 20, 4))
    monkeypatch.setitem(sys.modules, "pysindy", None)
    with pytest.raises(BenchError, match="pip install pysindy"):
        p.fit(*(torch.zeros(2, n, 1) for n in (4, 4, 20, 20)))


@pytest.mark.parametrize("spec", ["torch LSTM: 1x8 - Washout: 60", "torch LSTM: 2x8 - MLP: 6x10", "PySINDy"])
def test_it_trains_like_any_other(spec: str) -> None:
    if spec == "PySINDy":
        pytest.importorskip("pysindy", reason="PySINDy is not installed: the extra `peers`")
    training = Training(updates=900, evaluate_every=100, batch=32)
    found = run_group([RunConfig(*parse(s), Toy(), horizon=20, training=training, simulate=True) for s in (spec,)])
    none = run_group([RunConfig(*parse("constant"), Toy(), horizon=20, training=training)])
    error, least = (r[0].summary["metrics"]["rmsse.euler_rates"] for r in (found, none))
    assert error < 0.6 * least
    assert any(name.startswith("simulation.") for name in found[0].summary["metrics"])
