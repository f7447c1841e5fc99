"""Every effect of the catalogue by the public conformance tests: a new one is proven as soon as it is registered."""

from typing import Any

import pytest
import torch

from registry.conformance import EffectConformance
from registry.core import EFFECTS
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
    "force_limit": {"model": lambda self, *effects, **more: Servo(effects=effects, **more), "start": (0.3, -0.2)},
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
