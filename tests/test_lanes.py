"""Compiled rates and steps of models against torch's own, for every system and every effect."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from test_export import MODELS, SCALE, with_effects
from torch import Tensor

from bench.diagnose.logs.subject import Log, LogBatch
from bench.diagnose.regression.parameters import entries, probes, with_values
from bench.diagnose.regression.weak import mean_rates
from bench.diagnose.simulate.free_run import free_run
from bench.diagnose.simulate.unmeasured import completed
from registry.core import EFFECTS
from registry.dynamics import LoadEffect, Motion, PhysicsModel, constant
from registry.effects.learned_term import LearnedTerm
from registry.effects.mechanics.friction import CoulombFriction
from registry.effects.waves.periodic_term import PeriodicTerm
from registry.equations import lanes, models
from registry.physics.helicopter import Helicopter
from registry.physics.mass_on_rail import MassOnRail
from registry.physics.quadrotor import Quadrotor
from registry.physics.tanks import Tanks
from registry.terms import shapes, signals
from registry.terms.shapes import SPLINE

pytestmark = pytest.mark.skipif(not lanes.available(), reason="there is no compiler")
WIDTH = 37
"""Lanes, no multiple of a block."""


@contextmanager
def torch_only() -> Iterator[None]:
    """Without the interpreter, as on a machine without a compiler."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BENCH_KERNEL", "pytorch")
        lanes._interpreter.cache_clear()
        try:
            yield
        finally:
            lanes._interpreter.cache_clear()


def near(found: Tensor, wanted: Tensor) -> bool:
    """Alike in every digit but the last ones, channel by channel."""
    size = wanted.abs().amax(dim=tuple(range(wanted.dim() - 1))) + 1e-300
    return found.shape == wanted.shape and bool(((found - wanted).abs() / size).max() < 1e-12)


def logs_of(model: PhysicsModel, sensed: bool = False) -> list[Log]:
    """Two recordings of nonsense that no equation divides by zero at."""
    generator, width = torch.Generator().manual_seed(3), model.driving_channels + len(model.extras)
    scale = SCALE.get(type(model).system_name(), 1.0)
    size = len(model.state_channels)

    def drawn(n: int, columns: int) -> Tensor:
        return 0.5 + torch.rand(n, columns, generator=generator, dtype=torch.float64)

    return [
        Log(
            name=str(n),
            states=model.project(drawn(n, size)),
            inputs=scale * drawn(n, width),
            rate=1e4 if "bouc_wen" in map(EFFECTS.name_of, map(type, model.effects)) else 100.0,
            valid=torch.ones(n, dtype=torch.bool),
            measured=(True,) * size,
            recording=None,  # nobody asks for it here
            sensed=drawn(n, len(model.sensed_channels)) if sensed else None,
        )
        for n in (WIDTH, WIDTH - 5)
    ]


def several(model: PhysicsModel) -> PhysicsModel:
    """The model and as many others as it has numbers, each with one of them moved."""
    where = entries(model, {})
    return with_values(model, where, probes(where)[0]) if where else model


def both(function: Callable[[], Tensor]) -> tuple[Tensor, Tensor]:
    """What the interpreter makes of it, and torch."""
    with torch.no_grad():
        found = function()
        with torch_only():
            return found, function()


@pytest.mark.parametrize("name", MODELS)
def test_rates_and_free_runs_are_those_of_torch(name: str) -> None:
    model = MODELS[name]()
    model = replace(model, input_hold="linear") if model.input_hold == "previous" else model
    for one in (model, several(model), replace(several(model), input_hold="previous")):
        logs = logs_of(one, sensed=bool(one.sensed_channels))
        width = logs[0].inputs.shape[-1]
        assert models.rates(one, width, True) and models.step(one, width, logs[0].dt)
        assert near(*both(partial(mean_rates, one, LogBatch.of(logs))))
        at, drift = [np.array([3, 9]), np.array([2])], 1e-4 * torch.rand(3, 8, len(one.state_channels)).double()
        for push in (None, drift) if one is model else (None,):
            assert near(*both(partial(free_run, one, logs, at, 8, push)))


def test_states_that_were_not_measured_are_carried_as_torch_carries_them() -> None:
    model = with_effects(Tanks, ["overflow", "dead_zone", "actuator_lag"])
    for one in (model, several(model), replace(several(model), input_hold="previous")):
        logs = [replace(log, measured=(False, True), estimated=(True, False)) for log in logs_of(one)]
        assert models.carried(one, 1, logs[0].dt, (0,))
        found, wanted = both(partial(completed, one, LogBatch.of(logs)))
        torch.testing.assert_close(found, wanted, rtol=1e-9, atol=1e-9)
        assert found[..., 0].diff(dim=-1).abs().max() > 1e-4  # it moves


def test_splines_that_were_learned_are_programs_too() -> None:
    knots, heights = (-0.5, 0.6, 0.9, 1.2, 1.6), (0.3, -1.0, 0.5, 0.8, -0.2)
    learned = LearnedTerm("force_x", ("body_velocity.x", "body_velocity.z"), SPLINE, heights, knots, (0.5, 1.5))
    braked = LearnedTerm("speed.q", ("speed.q",), SPLINE, heights, knots, (0.5, 1.5))
    for model in (replace(Quadrotor(), effects=(learned,)), replace(MassOnRail(), effects=(CoulombFriction(), braked))):
        for one in (model, several(model)):
            logs = logs_of(one)
            assert models.step(one, logs[0].inputs.shape[-1], logs[0].dt)
            assert near(*both(partial(mean_rates, one, LogBatch.of(logs))))
            assert near(*both(partial(free_run, one, logs, [np.array([3, 9]), np.array([2])], 8)))


@pytest.mark.parametrize("kind", [Quadrotor, Helicopter, MassOnRail, Tanks])
def test_whatever_a_learned_term_follows_it_is_a_program(kind: type[PhysicsModel]) -> None:
    """One signal that is left to torch makes every search beside such a term several times slower."""
    (axis, *_), followed = signals.axes_of(kind), signals.available(kind())
    first, *_ = followed
    of_each = {n: shapes.SHAPES["linear"] for n in followed}
    for name, shape in [*of_each.items(), *((first, s) for s in shapes.SHAPES.values())]:
        values = tuple(0.3 - 0.1 * i for i in range(len(shape.parameters)))
        model = replace(kind(), effects=(LearnedTerm(axis, (name,), shape.name, values, (), (0.5, 1.5)),))
        logs = logs_of(model)
        assert models.step(model, logs[0].inputs.shape[-1], logs[0].dt), (name, shape.name)
        assert near(*both(partial(mean_rates, model, LogBatch.of(logs)))), (name, shape.name)


def test_one_program_serves_all_models_alike() -> None:
    """Constants that the first one did not have are not those of the others."""
    first, second = (with_effects(Quadrotor, ["rotor_drag", "mass"]) for _ in range(2))
    second = replace(second, mass=1.7, inertia=(0.02, 0.03, 0.05), effects=(replace(second.effects[0], k_d=3e-4),))
    for model in (first, second):
        assert near(*both(partial(mean_rates, model, LogBatch.of(logs_of(model)))))


@dataclass(frozen=True)
class Odd(LoadEffect):
    """Does what cannot be recorded, or not rightly."""

    strength: Any = constant(1.0, "of it", "N")
    equation: ClassVar[str] = "F = ?"
    act: ClassVar[Callable[[Tensor], Tensor]]

    def load(self, motion: Motion) -> tuple[Tensor, Tensor]:
        none = torch.zeros_like(motion.velocity)
        return none + type(self).act(motion.velocity), none


@pytest.mark.parametrize(
    "act",
    [
        lambda v: torch.from_numpy(np.sin(v.numpy())),  # torch does not see what numpy does
        lambda v: v if v.sum() > 0 else -v,
        torch.erfinv,
        lambda v: v + torch.rand(3),
    ],
    ids=["numpy", "branch", "unknown", "chance"],
)
def test_what_cannot_be_recorded_is_left_to_torch(act: Callable[[Tensor], Tensor], monkeypatch: Any) -> None:
    monkeypatch.setattr(Odd, "act", staticmethod(act), raising=False)
    models._programs.clear()
    monkeypatch.setattr("registry.dynamics.model.EFFECTS.name_of", lambda kind: kind.__name__)
    assert models.rates(Quadrotor(effects=(Odd(),)), 4) is None
    models._programs.clear()


@pytest.mark.parametrize("steps", [0, 4])
def test_of_no_states_there_are_no_results(steps: int) -> None:
    """It had read past an empty tensor: the numbers have one lane, and the states none."""
    model = Quadrotor(extras=("time",))
    size, inputs = len(model.state_channels), model.driving_channels + 1
    program = models.step(model, inputs, 0.01) if steps else models.rates(model, inputs)
    assert program is not None
    for count, width in ((1, 0), (0, 1), (0, 0)):
        state = torch.zeros(count, width, size, dtype=torch.float64)
        shape = (count, width, steps) if steps else (count, width)
        given = [torch.zeros(*shape, n * inputs, dtype=torch.float64) for n in ([3] if steps else [1, 1])]
        assert program(state, *given, steps=steps).shape == (*shape, size)


def test_without_a_compiler_everything_is_left_to_torch() -> None:
    with torch_only():
        assert models.rates(Quadrotor(), 4) is None and models.step(Quadrotor(), 4, 0.01) is None


def test_a_model_with_gradients_is_left_to_torch() -> None:
    mass = torch.tensor(1.0, dtype=torch.float64, requires_grad=True)
    assert models.rates(Quadrotor(mass=mass), 4) is None


def test_a_wave_starts_with_what_its_past_tells() -> None:
    wave = PeriodicTerm(axis="force_x", frequency=2.0)
    model = several(replace(Quadrotor(), effects=(wave, *with_effects(Quadrotor, ["linear_drag"]).effects)))
    logs = logs_of(model)
    assert near(*both(partial(free_run, model, logs, [np.array([20]), np.array([12])], 8)))
