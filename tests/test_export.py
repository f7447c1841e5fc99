"""Exported models: what the file computes is what the simulator computes, for every system and every effect."""

import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from torch import Tensor

from bench.cli import cli
from bench.diagnose.report import model_file
from bench.export import casadi_file, numpy_file
from bench.export.equations import Equations, equations
from registry.core import EFFECTS, PHYSICS
from registry.dynamics import PhysicsModel
from registry.effects.learned_term import LearnedTerm
from registry.equations.program import ON_NUMBERS, Program
from registry.equations.trace import traced
from registry.errors import BenchError
from registry.physics.quadrotor import Quadrotor
from tests.cranes import Cranes
from tests.servos import Servo

DT, STEPS, BATCH = 0.01, 12, 3
STIFF = {"bouc_wen": 1e-4}
"""Steps [s] of what runs away at `DT`."""
TOGETHER = 5
"""Effects of one model."""
SCALE = {"quadrotor": 450.0, "helicopter": 0.1}
"""Inputs about which a system moves as it is meant to."""


def with_effects(kind: type[PhysicsModel], names: Sequence[str]) -> PhysicsModel:
    """Effects with typical parameters, beside those that they require."""
    needed = [next((r for r in EFFECTS.get(n).requires if EFFECTS.get(r).suits(kind)), n) for n in names]
    wanted = [n for n in dict.fromkeys((*needed, *names)) if n not in kind.provides]
    extras = {"extras": ("battery",)} if "battery_sag" in names else {}
    return kind(effects=tuple(EFFECTS.get(n).typical() for n in wanted), **extras)


def every() -> dict[str, Callable[[], PhysicsModel]]:
    """Every system alone, and every effect of the catalogue in the first system that it suits, a few at a time."""
    found: dict[str, Callable[[], PhysicsModel]] = {}
    left = [n for n in EFFECTS.names() if not EFFECTS.get(n).learned]
    for system, kind in [
        *((name, PHYSICS.get(name)) for name in PHYSICS.names()),
        ("cranes", Cranes),
        ("servo", Servo),
    ]:
        found[system] = kind
        own = [n for n in left if EFFECTS.get(n).suits(kind)]
        left = [n for n in left if n not in own]
        apart = [[n] for n in own if n in STIFF]
        rest = [n for n in own if n not in STIFF]
        for some in (*apart, *(rest[i : i + TOGETHER] for i in range(0, len(rest), TOGETHER))):
            found[f"{system}: {', '.join(some)}"] = partial(with_effects, kind, some)
    assert not left
    return found


SPLINE = LearnedTerm("torque_y", ("pitch",), "spline", (0.01, -0.02, 0.0, 0.03), (-0.4, -0.1, 0.2, 0.5), (-0.5, 0.6))
MOMENT = LearnedTerm("torque_y", ("body_velocity.x",), "linear", (-0.02,), (), (-0.5, 0.6))
WALL = LearnedTerm("world_force_x", ("position.x",), "above", (-2.0, 0.05), (), (-0.5, 0.6))

MODELS = {
    **every(),
    "quadrotor: learned terms": lambda: Quadrotor(effects=(MOMENT, WALL)),
    "oscillator: a learned term": lambda: PHYSICS.get("oscillator")(
        effects=(LearnedTerm("speed.q", ("displacement.q",), "cubic", (-9.0,), (), (-0.5, 0.6)),)
    ),
    "held commands": lambda: replace(with_effects(Quadrotor, ["motor_lag"]), input_hold="previous"),
}


def many() -> PhysicsModel:
    return with_effects(
        Quadrotor, ["rotor_drag", "wind", "ground_effect", "suspended_load", "input_delay", "motor_lag"]
    )


def motion(model: PhysicsModel) -> tuple[Tensor, Tensor]:
    """States (BATCH, s) and inputs (BATCH, STEPS, m) at which something happens."""
    generator, proper = torch.Generator().manual_seed(3), len(model.state_channels)
    width = model.driving_channels + len(model.extras)
    state = 0.8 * torch.rand((BATCH, proper), generator=generator, dtype=torch.float64) - 0.3
    own = state.new_zeros(BATCH, model.internal_size)
    state = model.project(torch.cat([state, own], dim=-1))[:, :proper]
    inputs = 0.6 + torch.rand((BATCH, STEPS, width), generator=generator, dtype=torch.float64)
    return state, SCALE.get(type(model).system_name(), 1.0) * inputs


def imported(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def agrees(found: Any, expected: Tensor) -> bool:
    truth = expected.numpy()
    assert np.isfinite(truth).all()
    return bool(np.abs(np.asarray(found) - truth).max() <= 1e-9 * max(1.0, np.abs(truth).max()))


def in_casadi(made: Equations, state: Tensor, inputs: Tensor) -> np.ndarray:
    """The first state of the batch, step by step through CasADi's functions."""
    functions = casadi_file.functions(made)
    full, out = functions["initial"](state[0].numpy(), inputs[0, 0].numpy()), [state[0].numpy()]
    for before, after in zip(inputs[0].numpy(), inputs[0, 1:].numpy(), strict=False):
        full = functions["step"](full, before, after)
        out.append(np.array(full)[: state.shape[-1], 0])
    return np.array(out)


@pytest.mark.parametrize("name", MODELS)
def test_an_exported_model_moves_as_the_simulator(name: str, tmp_path: Path) -> None:
    model = MODELS[name]()
    dt = next((STIFF[n] for n in STIFF if name.endswith(f": {n}")), DT)
    state, inputs = motion(model)
    made = equations(model, dt)
    module = imported(numpy_file.write(tmp_path / "exported.py", made))
    expected = model.simulate(state, inputs, dt)
    assert agrees(module.simulate(state.numpy(), inputs.numpy()), expected)
    assert list(module.STATES) == [c.name for c in model.state_channels]
    assert len(module.INPUTS) == inputs.shape[-1]
    if importlib.util.find_spec("casadi") is not None:
        assert agrees(in_casadi(made, state, inputs), expected[0])


def test_rates_of_inputs_enter_the_derivative(tmp_path: Path) -> None:
    model = with_effects(Quadrotor, ["rotor_reaction_torque"])
    module = imported(numpy_file.write(tmp_path / "exported.py", equations(model, DT)))
    state, inputs = motion(model)
    rates = 300.0 * torch.randn(inputs.shape[-1], dtype=torch.float64)
    expected = model.derivative(state, inputs[:, 0], rates)
    assert agrees(module.derivative(state.numpy(), inputs[:, 0].numpy(), rates.numpy()), expected)
    assert not agrees(module.derivative(state.numpy(), inputs[:, 0].numpy(), 0 * rates.numpy()), expected)


def test_casadi_functions_are_read_again_and_have_derivatives(tmp_path: Path) -> None:
    casadi = pytest.importorskip("casadi", reason="CasADi is not installed: the extra `export`")
    model = many()
    files = casadi_file.write(tmp_path / "many.casadi", equations(model, DT))
    assert [f.name for f in files] == ["many.casadi", "many_step.casadi", "many_initial.casadi"]
    state, inputs = (v[0] for v in motion(model))
    derivative = casadi.Function.load(str(files[0]))
    body = torch.cat([state, 0.1 * torch.ones(model.internal_size, dtype=torch.float64)])
    slopes = torch.autograd.functional.jacobian(lambda x: model.derivative(x, inputs[0]), body)
    symbol = casadi.SX.sym("x", len(body))
    jacobian = casadi.jacobian(derivative(symbol, inputs[0].numpy(), 0 * inputs[0].numpy()), symbol)
    found = np.array(casadi.Function("j", [symbol], [jacobian])(body.numpy()))
    assert found == pytest.approx(slopes.numpy(), rel=1e-8, abs=1e-8)


def test_the_file_needs_numpy_alone(tmp_path: Path) -> None:
    model_file.write(tmp_path / "model.toml", replace(many(), extras=("time",)))
    done = CliRunner().invoke(cli, ["export-model", str(tmp_path / "model.toml"), "--to", "numpy", "--rate", "50"])
    assert done.exit_code == 0, done.output
    assert "quadrotor with rotor_drag, ground_effect" in done.output
    code = (
        "import sys, numpy as np, model as m\n"
        "x = np.zeros(13); x[9] = 1\n"
        "heavy = sorted({'torch', 'scipy', 'bench'} & set(sys.modules))\n"
        "print(m.DT, m.simulate(x, np.full((5, 4), 450.0)).shape, heavy)"
    )
    env = {k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"}  # the model lies where Python starts
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=env, capture_output=True, text=True, timeout=60
    )
    assert ran.stdout.split("\n")[0] == "0.02 (5, 13) []", ran.stderr


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--to", "numpy", "--out", "flight-model.py"], "use letters, digits and _"),
        (["--to", "numpy", "--out", "model.txt"], "ends in .py"),
        (["--to", "numpy", "--system", "quadrotr"], "did you mean quadrotor"),
    ],
)
def test_a_mistake_is_one_sentence(arguments: list[str], says: str, tmp_path: Path) -> None:
    model_file.write(tmp_path / "model.toml", Quadrotor())
    done = CliRunner().invoke(cli, ["export-model", str(tmp_path / "model.toml"), *arguments])
    assert isinstance(done.exception, BenchError) and says in str(done.exception)


def test_what_cannot_be_written_down_is_said() -> None:
    def branches(x: Tensor) -> Tensor:
        return x if x.sum() > 1 else -x

    with pytest.raises(BenchError, match="cannot be exported"):
        traced(branches, {"x": 2})
    with pytest.raises(BenchError, match="'erfinv' of torch"):
        traced(lambda x: torch.erfinv(x), {"x": 2})


def test_what_is_known_is_computed_beforehand_and_what_is_the_same_once() -> None:
    program = Program()
    x, y = program.given("x", 2)
    assert program("multiply", x, 0.0) == 0.0 and program("add", 0.0, x) is x and program("divide", y, 1.0) is y
    assert program("add", 2.0, 3.0) == 5.0 and program("where", 1.0, x, y) is x
    product = program("multiply", x, y)
    assert program("multiply", x, y) is product
    assert [n.operation for n in program.needed([program("sqrt", product)])] == ["multiply", "sqrt"]


def test_every_operation_is_printed_and_has_the_value_of_numpy() -> None:
    assert set(numpy_file.PRINTED) == set(ON_NUMBERS)
    for name, form in numpy_file.PRINTED.items():
        count = form.count("{}")
        values = (1.3, 0.4, 2.2)[:count]
        value = eval(form.format(*values), {"np": np})  # noqa: S307 (text of our own)
        assert ON_NUMBERS[name](*values) == pytest.approx(float(value))


def test_a_spline_that_was_learned_is_refused_in_a_sentence() -> None:
    with pytest.raises(BenchError, match="a spline cannot be exported"):
        equations(Quadrotor(effects=(SPLINE,)), DT)
