"""Predictors and initializers against the plain-numpy transcription of the paper's equations (`oracle`)."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import oracle
import pytest
import torch
from networks import Called, Trained, check_group, check_slopes, close, noise, vivid, weights
from torch import Tensor
from torch.func import functional_call

from registry import INITIALIZERS, PREDICTORS
from registry.contracts import Initializer, Predictor, Problem
from registry.cost import prediction_cost
from registry.state_cost import state_initialization_cost

TAU, HIDDEN = 10, 4


@dataclass(frozen=True)
class Case:
    """A predictor entry and the oracle that reads the same weights."""

    name: str
    layers: int = 1
    n_inputs: int = 3
    n_outputs: int = 2

    @property
    def delays(self) -> int:
        return 10 if self.name == "LSTM TDL" else 1

    @property
    def internal(self) -> int:
        return self.layers * HIDDEN * (1 if self.name == "MLFC" else 2)

    def build(self, **options: object) -> Predictor:
        torch.manual_seed(7)
        entry = PREDICTORS.get(self.name)(layers=self.layers, hidden=HIDDEN, **options)
        predictor = entry.build(Problem.plain(self.n_inputs, self.n_outputs, 12, TAU))
        return vivid(predictor)

    def oracle(self, predictor: Predictor):
        w = weights(predictor)
        if self.name == "MLFC":
            return partial(oracle.mlfc_rollout, w)
        return partial(oracle.lstm_rollout, w, delays=self.delays)

    def history(self, samples: int = 3) -> tuple[Tensor, Tensor]:
        return noise(samples, TAU, self.n_inputs, seed=1), noise(samples, TAU, self.n_outputs, seed=2)

    def __str__(self) -> str:
        return "-".join([self.name.replace(" ", ""), f"{self.layers}x", f"m{self.n_inputs}"])


CASES = [
    *[Case(name, layers) for name in ("LSTM", "LSTM TDL", "MLFC") for layers in (1, 2, 3)],
    *[Case(name, 2, n_inputs=0, n_outputs=1) for name in ("LSTM", "LSTM TDL", "MLFC")],
]
TWO_LAYERS = [c for c in CASES if c.layers == 2 and c.n_inputs]
over = partial(pytest.mark.parametrize, "case", ids=str)


# ------------------------------------------------------------------------------------------------ predictors


@over(CASES)
@pytest.mark.parametrize("measured", [False, True], ids=["own", "measured"])
def test_rollout_and_final_state_follow_the_equations(case: Case, measured: bool) -> None:
    predictor = case.build()
    u, state = noise(3, 12, case.n_inputs, seed=3), noise(3, predictor.layout.size, seed=4)
    feedback = noise(3, 12, case.n_outputs, seed=5) if measured else None
    outputs, end = predictor.rollout(u, state, feedback)
    want, want_end = case.oracle(predictor)(u.numpy(), state.numpy(), None if feedback is None else feedback.numpy())
    close(outputs, want)
    close(end, want_end)


@over(CASES)
def test_layout_counts_buffers_hidden_and_cell_states(case: Case) -> None:
    layout = case.build().layout
    cells = 0 if case.name == "MLFC" else case.layers * HIDDEN
    d = case.delays
    assert (layout.buffer, layout.hidden, layout.cell) == (
        (d - 1) * case.n_inputs + d * case.n_outputs,
        case.layers * HIDDEN,
        cells,
    )


@over(TWO_LAYERS)
def test_strides_and_gradient_recording_change_nothing(case: Case) -> None:
    predictor = case.build()
    u = noise(12, 3, case.n_inputs, seed=3).transpose(0, 1)
    y = noise(12, 3, case.n_outputs, seed=5).transpose(0, 1)
    state = noise(1, predictor.layout.size, seed=4).expand(3, -1)
    for feedback in (None, y):
        with torch.no_grad():
            plain = predictor.rollout(u, state, feedback)
        dense = predictor.rollout(u.contiguous(), state.contiguous(), None if feedback is None else y.contiguous())
        assert all(torch.equal(a, b) for a, b in zip(plain, dense, strict=True))


@over(TWO_LAYERS)
def test_si_in_si_out(case: Case) -> None:
    predictor = case.build()
    (a_u, b_u), (a_y, b_y) = ((noise(n, seed=s), 1 + noise(n, seed=s + 1) ** 2) for n, s in ((3, 11), (2, 13)))
    predictor.input_scaler.set(a_u, b_u)
    predictor.output_scaler.set(a_y, b_y)
    u, state = noise(2, 12, 3, seed=3), noise(2, predictor.layout.size, seed=4)
    want, _ = case.oracle(predictor)(((u - a_u) / b_u).numpy(), state.numpy())
    close(predictor(u, state), want * b_y.numpy() + a_y.numpy())


@over(TWO_LAYERS)
def test_single_precision_is_close_to_the_equations(case: Case) -> None:
    predictor = case.build().float()
    u, state = noise(2, 12, case.n_inputs, seed=3).float(), noise(2, predictor.layout.size, seed=4).float()
    outputs, _ = predictor.rollout(u, state)
    want, _ = case.oracle(predictor)(u.double().numpy(), state.double().numpy())
    assert outputs.dtype == torch.float32
    np.testing.assert_allclose(outputs.detach().numpy(), want, rtol=1e-4, atol=1e-5)


@over(TWO_LAYERS)
def test_nan_in_comes_out(case: Case) -> None:
    predictor = case.build()
    u, state = noise(3, 12, case.n_inputs, seed=3), noise(3, predictor.layout.size, seed=4)
    u[1, 5, 0] = torch.nan
    outputs, end = predictor.rollout(u, state)
    assert outputs[1, 5:].isnan().all() and end[1].isnan().any()
    assert not outputs[1, :5].isnan().any() and not outputs[[0, 2]].isnan().any()
    state[0, -1] = torch.nan
    assert predictor.rollout(u, state)[0][0].isnan().all()


@over(TWO_LAYERS)
def test_fill_takes_the_measured_history(case: Case) -> None:
    predictor, (u, y) = case.build(), case.history()
    close(predictor.init_buffers(u, y), oracle.fill(u.numpy(), y.numpy(), case.delays))


def test_weight_counts() -> None:
    """Counted from the shapes in equations LSTM, LRLayer and layerinput."""
    m, n, h, d = 4, 3, 50, 10
    for layers in (1, 2, 4):
        gates = lambda k: 4 * (h * k + h * h + h) + 3 * h  # noqa: E731  W^i, W^m, b of 4 rows and 3 diagonal W^c
        read_out = n * h + n
        assert count("LSTM", layers, m, n, h) == gates(m + n) + (layers - 1) * gates(h) + read_out
        assert count("LSTM TDL", layers, m, n, h) == gates(d * (m + n)) + (layers - 1) * gates(h) + read_out
        layer = h * h + h * (m + n + (layers - 1) * h) + h  # A^l, B^l, b^l
        assert count("MLFC", layers, m, n, h) == layers * layer + n * layers * h + n * m + n
    predictor = PREDICTORS.get("LSTM")(layers=2, hidden=h).build(Problem.plain(m, n, 40, TAU))
    states = 2 * h + 2 * h
    mlp = INITIALIZERS.get("MLP")(hidden=60, history=TAU).build(predictor, predictor.problem)
    assert mlp.weight_count() == 60 * TAU * (m + n) + 60 + states * 60 + states
    rnn = INITIALIZERS.get("RNN")(hidden=20, history=TAU).build(predictor, predictor.problem)
    assert rnn.weight_count() == 4 * 20 * (m + n + 20 + 1) + 3 * 20 + states * 20 + states
    assert INITIALIZERS.get("Washout")(history=TAU).build(predictor, predictor.problem).weight_count() == 0


def count(name: str, layers: int, m: int, n: int, h: int) -> int:
    return PREDICTORS.get(name)(layers=layers, hidden=h).build(Problem.plain(m, n, 40, TAU)).weight_count()


# ---------------------------------------------------------------------------------------------- initializers


def initializer_for(name: str, predictor: Predictor, **options: object) -> Initializer:
    torch.manual_seed(8)
    built = INITIALIZERS.get(name)(history=TAU, **options).build(predictor, predictor.problem)
    return vivid(built)


@over(CASES)
@pytest.mark.parametrize("feedback", ["measured", "own"])
def test_washout_runs_the_predictor_over_the_history(case: Case, feedback: str) -> None:
    predictor, (u, y) = case.build(), case.history()
    state = initializer_for("Washout", predictor, feedback=feedback).initialize(predictor, u, y)
    run = case.oracle(predictor)
    close(state, oracle.washout(run, case.internal, u.numpy(), y.numpy(), case.delays, own=feedback == "own"))


@over(CASES)
@pytest.mark.parametrize("name", ["MLP", "RNN"])
def test_neural_initializers_follow_the_equations(case: Case, name: str) -> None:
    predictor, (u, y) = case.build(), case.history()
    initializer = initializer_for(name, predictor, hidden=6)
    state = initializer.initialize(predictor, u, y)
    states = oracle.mlp_states if name == "MLP" else oracle.rnn_states
    internal = states(weights(initializer), predictor.layout.hidden, u.numpy(), y.numpy())
    close(state, np.concatenate([oracle.fill(u.numpy(), y.numpy(), case.delays), internal], axis=1))
    assert initializer.uses_state_cost


@over(TWO_LAYERS)
def test_costs_follow_the_equations(case: Case) -> None:
    predictor = case.build()
    state, u, y = noise(5, predictor.layout.size, seed=4), noise(5, case.n_inputs, seed=3), noise(5, 2, seed=5)
    _, h, _ = (x.numpy() for x in predictor.layout.split(state))
    w = weights(predictor)
    if case.name == "MLFC":
        want = oracle.mlfc_state_cost(w, h, u.numpy(), y.numpy())
    else:
        want = oracle.lstm_state_cost(w, h[:, -HIDDEN:], y.numpy())
    assert state_initialization_cost(predictor, state, u, y).item() == pytest.approx(want, rel=1e-12)
    predicted, measured = noise(4, 9, 2, seed=1), noise(4, 9, 2, seed=2)
    want = oracle.prediction_cost(predicted.numpy(), measured.numpy())
    assert prediction_cost(predicted, measured).item() == pytest.approx(want, rel=1e-12)


def test_state_cost_of_a_perfect_read_out_has_a_finite_gradient() -> None:
    """The norm's corner at zero must not turn the weights into NaN."""
    predictor = CASES[0].build()
    state, u = noise(2, predictor.layout.size, seed=4).requires_grad_(), noise(2, 3, seed=3)
    read = predictor.readout(state, u)
    assert read is not None
    (gradient,) = torch.autograd.grad(state_initialization_cost(predictor, state, u, read.detach()), state)
    assert gradient.isfinite().all()


# ------------------------------------------------------------------------------------------------- gradients


def small(name: str, dropout: float = 0.0) -> Predictor:
    options = {"delays": 3} if name == "LSTM TDL" else {}
    entry = PREDICTORS.get(name)(layers=2, hidden=2, dropout=dropout, **options)
    return vivid(entry.build(Problem.plain(2, 1, 4, 4)))


@pytest.mark.parametrize("name", ["LSTM", "LSTM TDL", "MLFC"])
@pytest.mark.parametrize("measured", [False, True], ids=["own", "measured"])
def test_rollout_gradient_with_dropout_is_the_finite_difference(name: str, measured: bool) -> None:
    predictor = small(name, 0.4).train()
    feedback = noise(2, 4, 1, seed=5) if measured else None  # data: needs no gradient
    u, state = noise(2, 4, 2, seed=3).requires_grad_(), noise(2, predictor.layout.size, seed=4).requires_grad_()

    def run(*data: Tensor | None) -> tuple[Tensor, Tensor]:
        torch.manual_seed(3)
        return predictor.rollout(*data)

    check_slopes(Called(predictor, run), u, state, feedback)


@pytest.mark.parametrize("name", ["LSTM", "LSTM TDL", "MLFC"])
@pytest.mark.parametrize("layers", [1, 2])
def test_backward_leaves_the_gradient_it_is_given_alone(name: str, layers: int) -> None:
    """One model and one window: there a view of the incoming gradient is already contiguous."""
    predictor = vivid(PREDICTORS.get(name)(layers=layers, hidden=3).build(Problem.plain(2, 1, 4, TAU)))
    stacked = {f"network.{n}": p[None] for n, p in predictor.named_parameters()}
    state = noise(1, 1, predictor.layout.size, seed=4).requires_grad_()
    ends = functional_call(Called(predictor, predictor.rollout), stacked, (noise(1, 1, 4, 2, seed=3), state))
    given = noise(*ends[0].shape, seed=5), noise(*ends[1].shape, seed=6)
    before = [g.clone() for g in given]
    first, second = (torch.autograd.grad(ends, state, given, retain_graph=True)[0] for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(given, before, strict=True))
    assert torch.equal(first, second)


@pytest.mark.parametrize("name", ["LSTM", "LSTM TDL", "MLFC"])
@pytest.mark.parametrize("how", ["Washout", "MLP", "RNN"])
def test_gradient_through_the_initializer_is_the_finite_difference(name: str, how: str) -> None:
    predictor = small(name)
    options = {} if how == "Washout" else {"hidden": 2}
    initializer = vivid(INITIALIZERS.get(how)(history=4, **options).build(predictor, predictor.problem))
    u_past, y_past = noise(2, 4, 2, seed=1).requires_grad_(), noise(2, 4, 1, seed=2)
    check_slopes(Trained(predictor, initializer), u_past, y_past, noise(2, 3, 2, seed=3), noise(2, 3, 1, seed=4))


# --------------------------------------------------------------------------------------------------- dropout


@pytest.mark.parametrize("name", ["LSTM", "LSTM TDL", "MLFC"])
def test_dropout_acts_in_training_only_and_is_repeatable(name: str) -> None:
    torch.manual_seed(0)
    predictor = vivid(PREDICTORS.get(name)(layers=2, hidden=HIDDEN, dropout=0.3).build(Problem.plain(3, 2, 12, TAU)))
    u, state = noise(3, 12, 3, seed=3), noise(3, predictor.layout.size, seed=4)
    predictor.eval()
    want, _ = Case(name, 2).oracle(predictor)(u.numpy(), state.numpy())
    close(predictor.rollout(u, state)[0], want)
    predictor.train()
    drawn = []
    for seed in (1, 1, 2):
        torch.manual_seed(seed)
        drawn.append(predictor.rollout(u, state)[0])
    assert torch.equal(drawn[0], drawn[1]) and not torch.equal(drawn[0], drawn[2])


# ----------------------------------------------------------------------------------- models trained in a group


GROUPED = [("LSTM", 1, "MLP", 60), ("MLFC", 1, "Washout", None), ("LSTM TDL", 1, "RNN", 50), ("MLFC", 2, "MLP", 60)]


@pytest.mark.parametrize(("name", "layers", "how", "hidden"), GROUPED, ids=lambda v: str(v).replace(" ", ""))
@pytest.mark.parametrize("batch", [64, 7])
def test_training_in_a_group_changes_no_bit(name: str, layers: int, how: str, hidden: int | None, batch: int) -> None:
    """Outputs, cost and gradients of three stacked models are those of three stacks of one."""
    pairs = []
    for seed in range(3):
        torch.manual_seed(seed)
        predictor = PREDICTORS.get(name)(layers=layers, hidden=50).build(Problem.plain(4, 1, 40, TAU))
        initializer = INITIALIZERS.get(how)(history=TAU, **({} if hidden is None else {"hidden": hidden}))
        pairs.append(Trained(predictor, initializer.build(predictor, predictor.problem)))
    check_group(pairs, [(TAU, 4), (TAU, 1), (40, 4), (40, 1)], batch, 1e-6)


# ------------------------------------------------------------------------------------------- honest baselines


def test_constant_keeps_the_last_measured_output() -> None:
    predictor = PREDICTORS.get("constant")().build(Problem.plain(3, 2, 12, TAU)).double()
    u, y = noise(4, TAU, 3, seed=1), noise(4, TAU, 2, seed=2)
    outputs, _ = predictor.rollout(noise(4, 12, 3, seed=3), predictor.init_buffers(u, y))
    assert torch.equal(outputs, y[:, -1:].expand(4, 12, 2)) and predictor.weight_count() == 0


def driven(samples: int, steps: int, seed: int) -> tuple[Tensor, Tensor]:
    """y_k = F y_{k-1} + G y_{k-2} + P u_k + Q u_{k-1}, a stable system that looks two samples back."""
    f, g = torch.tensor([[0.6, 0.2], [-0.3, 0.5]]).double(), torch.tensor([[0.1, -0.1], [0.2, -0.2]]).double()
    p, q = noise(2, 3, seed=20), noise(2, 3, seed=21)
    u, y = noise(samples, steps, 3, seed=seed), noise(samples, steps, 2, seed=seed + 1)
    for k in range(2, steps):
        y[:, k] = y[:, k - 1] @ f.T + y[:, k - 2] @ g.T + u[:, k] @ p.T + u[:, k - 1] @ q.T
    return u, y


def test_linear_recovers_a_linear_system_and_is_causal() -> None:
    horizon, tau = 8, 4
    predictor = PREDICTORS.get("linear")(ridge=1e-10).build(Problem.plain(3, 2, horizon, tau)).double()
    u, y = driven(400, tau + horizon, seed=30)
    predictor.fit(u[:, :tau], y[:, :tau], u[:, tau:], y[:, tau:])
    u, y = driven(20, tau + horizon, seed=40)
    state = predictor.init_buffers(u[:, :tau], y[:, :tau])
    outputs, _ = predictor.rollout(u[:, tau:], state)
    torch.testing.assert_close(outputs, y[:, tau:], rtol=1e-6, atol=1e-6)
    for j in range(horizon):
        pushed = u[:, tau:].clone()
        pushed[:, j] += 1e3
        moved, _ = predictor.rollout(pushed, state)
        assert torch.equal(moved[:, :j], outputs[:, :j]) and not torch.equal(moved[:, j], outputs[:, j])
