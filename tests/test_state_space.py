"""LRU, SUBNET with its encoder and the neural ODE against plain-numpy transcriptions of their equations."""

from pathlib import Path

import numpy as np
import oracle
import pytest
import torch
from conftest import Toy
from networks import close, noise, vivid, weights

from bench.execution import engine
from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse, write
from bench.records import record
from registry import INITIALIZERS, PREDICTORS
from registry.contracts import Channel, Predictor, Problem
from registry.predictors.lru import scan
from registry.state_cost import state_initialization_cost

TAU, HIDDEN, RATE = 5, 4, 50.0
NAMES = ["LRU", "SUBNET", "Neural ODE"]
over = pytest.mark.parametrize("name", NAMES, ids=lambda n: n.replace(" ", ""))


def built(name: str, m: int = 3, n: int = 2, layers: int = 2, **options: object) -> Predictor:
    torch.manual_seed(7)
    return vivid(PREDICTORS.get(name)(layers=layers, hidden=HIDDEN, **options).build(Problem.plain(m, n, 12, TAU)))


# ------------------------------------------------------------------------------------------------ transcriptions


def lru(w: oracle.Weights, inputs, states):
    """One window: inputs (T, m), states (2·L·H,) → outputs (T, n), states at the end."""
    layers = sum(name.endswith("log_phase") for name in w)
    real, imaginary = states.reshape(2, layers, HIDDEN)
    s, outputs = list(real + 1j * imaginary), []
    for u in inputs:
        h = w["input_weight"] @ u + w["input_bias"]
        for i in range(layers):
            own = {name.partition(f"stack.{i}.")[2]: value for name, value in w.items() if f"stack.{i}." in name}
            pole = np.exp(-np.exp(own["log_damping"])) * np.exp(1j * np.exp(own["log_phase"]))
            b, c = (own[k][0] + 1j * own[k][1] for k in ("drive", "read"))
            s[i] = pole * s[i] + np.exp(own["log_gain"]) * (b @ h)
            z = np.real(c @ s[i]) + own["through"] * h
            z = z / 2 * (1 + np.array([float(torch.erf(torch.tensor(x / np.sqrt(2)))) for x in z]))
            value, gate = (own["gate_weight"][j] @ z + own["gate_bias"][j] for j in (0, 1))
            h = h + value * oracle.sigma(gate)
        outputs.append(w["output_weight"] @ h + w["output_bias"])
    return np.array(outputs), np.concatenate([np.real(s).ravel(), np.imag(s).ravel()])


def bypassed(w: oracle.Weights, name: str, x):
    count = sum(key.startswith(f"{name}.bias.") for key in w)
    y = x
    for i in range(count):
        y = w[f"{name}.weight.{i}"] @ (np.tanh(y) if i else y) + w[f"{name}.bias.{i}"]
    return y + w[f"{name}.linear"] @ x


def subnet(w: oracle.Weights, inputs, states):
    """As `lru`, of x_k = f(x_{k−1}, u_k), ŷ_k = h(x_k)."""
    outputs = []
    for u in inputs:
        states = bypassed(w, "transition", np.concatenate([states, u]))
        outputs.append(bypassed(w, "output", states))
    return np.array(outputs), states


def ode(w: oracle.Weights, rate_of, held: bool, pace: float, inputs, states, feedback=None):
    """As `lru`, of a neural ODE; ``rate_of`` (x, learned) → dx/dt."""
    m = inputs.shape[1]
    before, x, outputs = states[:m], states[m:], []
    n = len(w["output_scaler.scale"])

    def slope(x, u):
        y = np.concatenate([x, u])
        count = sum(key.startswith("bias.") for key in w)
        for i in range(count):
            y = w[f"weight.{i}"] @ (np.tanh(y) if i else y) + w[f"bias.{i}"]
        return rate_of(x, pace * y)

    for k, u in enumerate(inputs):
        at = lambda share, u=u: before if held else (1 - share) * before + share * u  # noqa: E731, B023
        dt = 1 / RATE
        k1 = slope(x, at(0))
        k2 = slope(x + dt / 2 * k1, at(0.5))
        k3 = slope(x + dt / 2 * k2, at(0.5))
        k4 = slope(x + dt * k3, at(1))
        x = x + dt * (k1 / 6 + k2 / 3 + k3 / 3 + k4 / 6)
        outputs.append(x[:n])
        x = x if feedback is None else np.concatenate([feedback[k], x[n:]])
        before = u
    return np.array(outputs), np.concatenate([before, x])


@pytest.mark.parametrize(("name", "run"), [("LRU", lru), ("SUBNET", subnet)])
@pytest.mark.parametrize(("layers", "m", "n"), [(1, 3, 2), (3, 2, 1), (2, 0, 1)])
def test_runs_follow_the_equations(name: str, run, layers: int, m: int, n: int) -> None:
    predictor = built(name, m, n, layers)
    u, state = noise(3, 11, m, seed=3), noise(3, predictor.layout.size, seed=4)
    outputs, end = predictor.rollout(u, state)
    for i in range(3):
        want, want_end = run(weights(predictor), u[i].numpy(), state[i].numpy())
        close(outputs[i], want)
        close(end[i], want_end)


CART = (Channel("displacement.q", "m"), Channel("speed.q", "m/s"))
PUSH = (Channel("force", "N"),)


@pytest.mark.parametrize("held", [False, True], ids=["linear", "held"])
@pytest.mark.parametrize("measured", [False, True], ids=["own", "measured"])
@pytest.mark.parametrize("outputs", [CART, CART[:1], CART[1:], (Channel("level.h", "V"),)], ids=len)
def test_a_neural_ode_follows_its_equations(outputs: tuple[Channel, ...], measured: bool, held: bool) -> None:
    """Speed measured, speed a state of its own, no pose at all: what is known and what is learned."""
    problem = Problem(PUSH, outputs, 12, TAU, rate=RATE, input_hold="previous" if held else "linear")
    predictor = vivid(PREDICTORS.get("Neural ODE")(hidden=HIDDEN, latent=1, pace=0.2).build(problem))
    n = len(outputs)
    offset, scale = (torch.tensor(x[:n], dtype=torch.float64) for x in ([0.3, -0.2], [2.0, 5.0]))
    predictor.output_scaler.set(offset, scale)
    pace = 0.2 * RATE
    rate_of = {
        ("displacement.q", "speed.q"): lambda x, f: np.array([(5 * x[1] - 0.2) / 2, f[0], f[1]]),
        ("displacement.q",): lambda x, f: np.array([pace * x[1], f[0], f[1]]),
    }.get(tuple(c.name for c in outputs), lambda x, f: f)
    u, state, y = noise(2, 9, 1, seed=3), noise(2, predictor.layout.size, seed=4), noise(2, 9, n, seed=5)
    got, end = predictor.rollout(u, state, y if measured else None)
    for i in range(2):
        fed = y[i].numpy() if measured else None
        want, want_end = ode(weights(predictor), rate_of, held, pace, u[i].numpy(), state[i].numpy(), fed)
        close(got[i], want)
        close(end[i], want_end)


def test_what_is_known_of_a_neural_ode_can_be_left_out() -> None:
    problem = Problem(PUSH, CART, 12, TAU, rate=RATE)
    entry = PREDICTORS.get("Neural ODE")
    known, free = (entry(kinematics=k).build(problem) for k in (True, False))
    assert (known.learned, free.learned) == ([1, 2, 3], [0, 1, 2, 3])


def test_the_scan_is_the_recurrence() -> None:
    pole, driven = torch.complex(*noise(2, 3, seed=1).tanh()), torch.complex(*noise(2, 4, 13, 3, seed=2))
    state, states = torch.zeros(4, 3, dtype=torch.complex128), []
    for d in driven.unbind(1):
        state = pole * state + d
        states.append(state)
    close(scan(pole, driven), torch.stack(states, 1))


def test_poles_start_in_their_ring() -> None:
    entry = PREDICTORS.get("LRU")(layers=1, hidden=500, r_min=0.6, r_max=0.9, max_phase=0.5)
    layer = entry.build(Problem.plain(1, 1, 12, TAU)).stack[0]
    pole = torch.exp(torch.complex(-layer.log_damping.exp(), layer.log_phase.exp())).detach()
    assert 0.6 <= pole.abs().min() < 0.62 and 0.88 < pole.abs().max() <= 0.9
    assert pole.angle().min() >= 0 and 0.45 < pole.angle().max() <= 0.5
    close(layer.log_gain.exp().detach(), (1 - pole.abs() ** 2).sqrt(), rtol=1e-5)


@pytest.mark.parametrize("name", ["SUBNET", "LSTM", "Neural ODE"])
def test_the_encoder_is_a_network_beside_a_linear_map(name: str) -> None:
    predictor = built(name)
    torch.manual_seed(8)
    encoder = vivid(INITIALIZERS.get("Encoder")(hidden=6, history=TAU).build(predictor, predictor.problem))
    u, y = noise(3, TAU + 2, 3, seed=1), noise(3, TAU + 2, 2, seed=2)  # longer than τ: only the end counts
    state = encoder.initialize(predictor, u, y)
    assert state.shape[-1] == predictor.layout.size and not encoder.uses_state_cost
    hidden, buffer = predictor.layout.hidden, predictor.layout.buffer
    for i in range(3):
        x = np.concatenate([u[i, 2:].numpy().ravel(), y[i, 2:].numpy().ravel()])
        want = bypassed(weights(encoder), "network", x)
        want[:hidden] = np.tanh(want[:hidden])
        close(state[i, buffer:], want)
        close(state[i, :buffer], predictor.init_buffers(u[i : i + 1], y[i : i + 1])[0].detach())


# ----------------------------------------------------------------------------------------------------- contracts


@pytest.mark.parametrize("name", ["LRU", "SUBNET"])
def test_the_readout_is_the_output_of_the_state(name: str) -> None:
    """ŷ_{k0} of the state after a run is the run's last output; a neural ODE starts at the measured one."""
    predictor = built(name)
    u, state = noise(2, 6, 3, seed=3), noise(2, predictor.layout.size, seed=4)
    outputs, end = predictor.rollout(u, state)
    read = predictor.readout(end, u[:, -1])
    assert read is not None
    close(read, outputs[:, -1].detach())
    y = noise(2, 2, seed=5)
    want = (read - y).norm(dim=-1).mean().item()
    assert state_initialization_cost(predictor, end, u[:, -1], y).item() == pytest.approx(want)


@pytest.mark.parametrize(
    "spec", ["LRU: 1x8 - MLP: 8x10", "SUBNET: 1x8 - Encoder: 8x10", "Neural ODE: 1x8 - MLP: 8x10", "TCN: 2x8"]
)
def test_they_learn(spec: str, tmp_path: Path) -> None:
    predictor, initializer = parse(spec)
    assert write(predictor, initializer) == spec
    training = Training(updates=150, evaluate_every=50, batch=32)
    config = RunConfig(predictor, initializer, Toy(), horizon=6, training=training)
    (learnt,) = engine.execute(engine.plan([config], tmp_path), tmp_path)
    assert learnt.summary["status"] == "finished"
    assert learnt.curve.validation_loss.iloc[-1] < 0.7 * learnt.curve.validation_loss.iloc[0]
    assert record.verify(learnt) == []
