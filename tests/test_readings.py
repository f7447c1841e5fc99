"""Options where the paper leaves room, against the transcription of its equations: A_o, full peepholes, increments."""

from functools import partial

import numpy as np
import oracle
import pytest
import torch
from conftest import Toy
from networks import Called, Trained, check_slopes, close, noise, vivid, weights
from test_gradient import assert_equal, group
from test_native import kernel

from bench.experiment.config import RunConfig, Training, changed, to_json
from bench.experiment.notation import parse
from bench.training.data import prepare
from bench.training.model import build_scaled
from registry import INITIALIZERS, PREDICTORS
from registry.contracts import Predictor, Problem
from registry.state_cost import state_initialization_cost

TAU = 10
READINGS = {
    "A_o": ("MLFC", {"output_feedback": True}),
    "full": ("LSTM", {"peepholes": "full"}),
    "full TDL": ("LSTM TDL", {"peepholes": "full", "delays": 3}),
    "increments": ("LSTM", {"increments": True}),
    "increments TDL": ("LSTM TDL", {"increments": True, "delays": 3}),
    "full, increments": ("LSTM", {"peepholes": "full", "increments": True}),
}
over = pytest.mark.parametrize("reading", READINGS)
kernels = pytest.mark.parametrize("used", ["native", "pytorch"])


def built(
    reading: str, layers: int = 2, hidden: int = 4, horizon: int = 12, size: tuple[int, int] = (3, 2)
) -> Predictor:
    name, options = READINGS[reading]
    torch.manual_seed(7)
    predictor = vivid(
        PREDICTORS.get(name)(layers=layers, hidden=hidden, **options).build(Problem.plain(*size, horizon, TAU))
    )
    predictor.set_increments(torch.linspace(0.1, 0.3, size[1]).double())
    return predictor


def transcribed(predictor: Predictor, reading: str):
    name, options = READINGS[reading]
    if name == "MLFC":
        return partial(oracle.mlfc_rollout, weights(predictor))
    return partial(oracle.lstm_rollout, weights(predictor), delays=options.get("delays", 1))


@kernels
@over
@pytest.mark.parametrize("layers", [1, 3])
@pytest.mark.parametrize("measured", [False, True], ids=["own", "measured"])
@pytest.mark.parametrize("steps", [1, 12])
def test_the_equations(reading: str, layers: int, measured: bool, steps: int, used: str) -> None:
    predictor = built(reading, layers)
    u, state = noise(3, steps, 3, seed=3), noise(3, predictor.layout.size, seed=4)
    feedback = noise(3, steps, 2, seed=5) if measured else None
    with kernel(used):
        outputs, end = predictor.rollout(u, state, feedback)
    want, want_end = transcribed(predictor, reading)(
        u.numpy(), state.numpy(), None if feedback is None else feedback.numpy()
    )
    close(outputs, want)
    close(end, want_end)


@kernels
@over
@pytest.mark.parametrize("measured", [False, True], ids=["own", "measured"])
@pytest.mark.parametrize("steps", [1, 4])
def test_gradients_are_finite_differences(reading: str, measured: bool, steps: int, used: str) -> None:
    predictor = built(reading, hidden=2, size=(2, 1))
    feedback = noise(2, steps, 1, seed=5) if measured else None
    u, state = noise(2, steps, 2, seed=3).requires_grad_(), noise(2, predictor.layout.size, seed=4).requires_grad_()
    with kernel(used):
        check_slopes(Called(predictor, predictor.rollout), u, state, feedback)


@over
@pytest.mark.parametrize("how", ["Washout", "MLP"])
def test_gradients_through_initializer_and_state_cost(reading: str, how: str) -> None:
    predictor = built(reading, hidden=2, size=(2, 1))
    options = {} if how == "Washout" else {"hidden": 2}
    pair = Trained(predictor, vivid(INITIALIZERS.get(how)(history=4, **options).build(predictor, predictor.problem)))
    past, ahead = (noise(2, 4, 2, seed=1), noise(2, 4, 1, seed=2)), (noise(2, 3, 2, seed=3), noise(2, 3, 1, seed=4))
    check_slopes(pair, *past, *ahead)


def test_the_state_cost_takes_a_o_off() -> None:
    """c = y_{k0} − A_o y_{k0−1} − B u_{k0}, with both outputs as they were measured."""
    predictor = built("A_o")
    u, y = noise(5, TAU, 3, seed=1), noise(5, TAU, 2, seed=2)
    hidden = noise(5, predictor.layout.hidden, seed=3)
    state = torch.cat([predictor.init_buffers(u, y), hidden], -1)
    found = state_initialization_cost(predictor, state, u[:, -1], y[:, -1])
    known = (x.numpy() for x in (hidden, u[:, -1], y[:, -1], y[:, -2]))
    assert found.item() == pytest.approx(oracle.mlfc_state_cost(weights(predictor), *known), rel=1e-12)


def test_increments_have_no_state_cost() -> None:
    predictor = built("increments")
    assert predictor.readout(noise(2, predictor.layout.size, seed=1), noise(2, 3, seed=2)) is None


@pytest.mark.parametrize("models", [1, 2])
@pytest.mark.parametrize(
    ("spec", "options"),
    [
        ("MLFC: 2x8 - MLP: 9x10", {"output_feedback": True}),
        ("MLFC: 2x8 - Washout: 10", {"output_feedback": True}),
        ("MLFC: 3x8 - MLP: 9x10", {"skip": False}),
        ("MLFC: 2x8 - Washout: 10", {"skip": False, "output_feedback": True}),
        ("LSTM: 2x8 - MLP: 9x10", {"increments": True}),
        ("LSTM TDL: 1x8 - Washout own: 10", {"increments": True}),
    ],
)
def test_the_own_way_back_is_autograds(spec: str, options: dict[str, bool], models: int) -> None:
    with kernel("native"):
        made = group(spec, models, **options)
        assert_equal(made.network, made._batch())


def test_full_peepholes_train_side_by_side_as_alone() -> None:
    with kernel("native"):
        many, alone = (group("LSTM: 1x8 - MLP: 9x10", models=m, peepholes="full") for m in (2, 1))
    assert torch.equal(many.theta[:1], alone.theta)


@kernels
@pytest.mark.parametrize("measured", [False, True], ids=["own", "measured"])
def test_layers_in_series_are_a_fully_connected_network_with_nothing_between_them(measured: bool, used: str) -> None:
    torch.manual_seed(7)
    serial = vivid(PREDICTORS.get("MLFC serial")(layers=3, hidden=4).build(Problem.plain(3, 2, 12, TAU)))
    own, seen = weights(serial), 3 + 2
    for layer, columns in enumerate([slice(0, seen), slice(seen, seen + 4), slice(seen + 4, seen + 8)]):
        full = np.zeros((4, seen + 8))
        full[:, columns] = own[f"input_weight.{layer}"]
        own[f"input_weight.{layer}"] = full
    own["output_weight"] = np.concatenate([np.zeros((2, 8)), own["output_weight"]], 1)
    u, state = noise(3, 12, 3, seed=3), noise(3, serial.layout.size, seed=4)
    feedback = noise(3, 12, 2, seed=5) if measured else None
    with kernel(used):
        outputs, end = serial.rollout(u, state, feedback)
    want, want_end = oracle.mlfc_rollout(own, u.numpy(), state.numpy(), None if feedback is None else feedback.numpy())
    close(outputs, want)
    close(end, want_end)
    before = PREDICTORS.get("MLFC")(layers=3, hidden=4).build(Problem.plain(3, 2, 12, TAU)).weight_count()
    assert before - serial.weight_count() == 4 * (8 + (seen + 4) + (seen + 4)) + 2 * 8


def test_a_diagonal_is_a_full_matrix_without_the_rest() -> None:
    diagonal, full = (
        PREDICTORS.get("LSTM")(layers=2, hidden=4, peepholes=p).build(Problem.plain(3, 2, 9, TAU))
        for p in ("diagonal", "full")
    )
    vivid(diagonal), full.double()
    own = {n: torch.diag_embed(v) if n.startswith("peephole") else v for n, v in diagonal.state_dict().items()}
    full.load_state_dict(own)
    u, state = noise(3, 9, 3, seed=3), noise(3, full.layout.size, seed=4)
    torch.testing.assert_close(full.rollout(u, state), diagonal.rollout(u, state), rtol=1e-12, atol=1e-12)
    assert full.weight_count() - diagonal.weight_count() == 2 * 3 * (4 * 4 - 4)


def test_options_at_their_default_are_in_no_key() -> None:
    """So that runs that were published before there were such options keep theirs."""
    for spec in ("LSTM: 1x8 - MLP: 9x10", "MLFC: 1x8 - MLP: 9x10"):
        config = RunConfig(*parse(spec), Toy(), horizon=6)
        plain = to_json(config, defaults=False)
        assert plain["predictor"].keys() <= {"name", "layers", "hidden"} and "training" not in plain


def test_increments_are_in_units_of_their_own_deviation() -> None:
    config = changed(
        RunConfig(*parse("LSTM: 1x8 - MLP: 9x10"), Toy(), horizon=6, training=Training()),
        {"predictor.increments": "true"},
    )
    data = prepare(config)
    model = build_scaled(config, data)
    training = [r for r in Toy().load().recordings if r.name in data.split.train]
    change = np.concatenate([np.diff(r.outputs, axis=0) for r in training])
    want = np.sqrt((change**2).mean(0)) / model.predictor.output_scaler.scale.numpy()
    np.testing.assert_allclose(model.predictor.increment_scale.numpy(), want, rtol=1e-5)


@pytest.mark.parametrize("reading", ["A_o", "increments", "increments TDL"])
@pytest.mark.parametrize("measured", [False, True], ids=["own", "measured"])
@pytest.mark.parametrize("steps", [1, 5])
def test_a_run_goes_back_from_outputs_and_from_the_state_after_it(reading: str, measured: bool, steps: int) -> None:
    predictor = built(reading)
    u, state = noise(3, steps, 3, seed=3), noise(3, predictor.layout.size, seed=4).requires_grad_()
    feedback = noise(3, steps, 2, seed=5) if measured else None
    with kernel("native"):
        ends = predictor.rollout(u, state, feedback)
        given = [noise(*e.shape, seed=6 + i) for i, e in enumerate(ends)]
        named = dict(predictor.named_parameters())
        want = torch.autograd.grad(ends, [state, *named.values()], given, allow_unused=True, materialize_grads=True)
        with torch.no_grad():
            _, _, back = predictor.rollout_vjp(u, state, feedback)
            d_state, found = back(*(g.clone() for g in given))
    torch.testing.assert_close(d_state, want[0], rtol=1e-12, atol=1e-12)
    for n, g in zip(named, want[1:], strict=True):
        torch.testing.assert_close(found[n], g, rtol=1e-12, atol=1e-12)
