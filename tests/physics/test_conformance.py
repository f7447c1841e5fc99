"""Every effect of the catalogue by the public conformance tests: a new one is proven as soon as it is registered."""

from typing import Any

import pytest
import torch
from torch import Tensor

from registry.conformance import EffectConformance
from registry.core import EFFECTS
from registry.dynamics import Motion, tensor
from registry.effects.air import LinearDrag
from registry.effects.polynomial import Monomial
from registry.errors import BenchError
from registry.physics.mass_on_rail import MassOnRail
from tests.cranes import Cranes
from tests.servos import Servo

TESTS = [name for name in dir(EffectConformance) if name.startswith("test_")]
SINKING = (0.1, -0.2, 0.35, 1.5, -0.8, -5.0, 0.1, -0.05, 0.2, 0.97, 0.6, -0.7, 0.5)
"""State of a vehicle in its own wake."""

CRANES: dict[str, Any] = {
    "model": lambda self, *effects, **more: Cranes(effects=effects, **more),
    "start": (0.3, -0.2, 0.7, -0.4),
}
MORE: dict[str, dict[str, Any]] = {
    "battery_sag": {"extras": ("time", "battery")},
    "battery_sag, time alone": {"extras": ("time",)},
    "bouc_wen": {"dt": 1e-3},
    "controller_saturation": {
        "model": lambda self, *effects, **more: Servo(effects=effects, **more),
        "start": (0.3, -0.2),
    },
    "force_limit": {"model": lambda self, *effects, **more: Servo(effects=effects, **more), "start": (0.3, -0.2)},
    "gravity_torque": {"model": lambda self, *effects, **more: Servo(effects=effects, **more), "start": (0.3, -0.2)},
    "joint_damping": CRANES,
    "joint_friction": CRANES,
    "overflow": {"dt": 4.0},
    "transport_delay": {"dt": 4.0},
    "vortex_ring_state": {"start": SINKING},
    "wind": {"others": (LinearDrag(0.4, 0.4, 0.4),)},
}
"""What shows an effect where the conformance tests' own state and steps do not."""


def steps(name: str) -> int:
    """Within which a typical effect shows."""
    kind = EFFECTS.get(name)
    if issubclass(kind, Monomial):
        return 2
    return 8 if kind.systems and "quadrotor" not in kind.systems else 5


CATALOGUE = [n for n in EFFECTS.names() if not EFFECTS.get(n).learned]  # what was learned: test_learned_term.py


@pytest.mark.parametrize("case", [*CATALOGUE, *(n for n in MORE if n not in CATALOGUE)])
@pytest.mark.parametrize("test", TESTS)
def test_it_conforms(case: str, test: str) -> None:
    name = case.partition(",")[0]
    given = {"effect": EFFECTS.get(name), "visible_after": steps(name), **MORE.get(case, {})}
    getattr(type(name, (EffectConformance,), given)(), test)()


def test_an_effect_may_need_a_signal_that_its_system_brings(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = EFFECTS.get("joint_damping")
    tests = type("Damping", (EffectConformance,), {"effect": kind, **CRANES})()
    monkeypatch.setattr(kind, "needs", ("pace", "push"))
    tests.test_is_described()
    monkeypatch.setattr(kind, "needs", ("pace", "pull"))
    with pytest.raises(AssertionError, match="a signal that nobody knows"):
        tests.test_is_described()


def test_a_force_whose_axes_differ_in_their_dimensions_does_not_conform(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a diagnosis dies of: zeros like the signal beside a force that has the dimensions of the parameters too."""

    def load(self: LinearDrag, motion: Motion) -> tuple[Tensor, Tensor]:
        speed = motion.air_velocity[..., 0]
        along = -tensor(self.d_x, speed) * speed
        force = torch.stack([along, torch.zeros_like(speed), torch.zeros_like(speed)], dim=-1)
        return force, torch.zeros_like(force)

    tests = type("Drag", (EffectConformance,), {"effect": LinearDrag})()
    monkeypatch.setattr(LinearDrag, "load", load)
    for name in ("test_neutral_is_no_effect", "test_typical_shows", "test_batches", "test_units_do_not_matter"):
        getattr(tests, name)()
    with pytest.raises(RuntimeError, match="stack expects each tensor to be equal size"):
        tests.test_parameters_with_more_dimensions_than_the_signals()


def test_friction_of_a_joint_acts_where_its_motor_does() -> None:
    """By hand: the numbers are in the order of the motors, and what resists the heavy trolley moves the light one."""
    state, rest = torch.tensor([0.0, 0.0, 0.7, -0.4], dtype=torch.float64), torch.zeros(2, dtype=torch.float64)
    damped = Cranes(effects=(EFFECTS.get("joint_damping")(f_1=0.5, f_2=0.2),)).derivative(state, rest)
    assert damped.tolist() == pytest.approx([0.7, -0.4, -0.2 * 0.7 - 0.5 * 0.4 / 2, 0.5 * 0.4 / 3])
    dry = Cranes(effects=(EFFECTS.get("joint_friction")(f_1=0.5, f_2=0.2),)).derivative(state, rest)
    assert dry.tolist() == pytest.approx([0.7, -0.4, -0.2 - 0.5 / 2, 0.5 / 3])
    with pytest.raises(BenchError, match=r"numbers of 1 joint\(s\), and the model 2"):
        Cranes(effects=(EFFECTS.get("joint_friction")(f_1=0.5, f_2=None),))
    with pytest.raises(BenchError, match="is for a class of your own with a motor in each joint"):
        MassOnRail(effects=(EFFECTS.get("joint_friction")(),))
