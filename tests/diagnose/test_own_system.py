"""A physics model of a user's own file, which nobody registered."""

from pathlib import Path

import pytest

from bench.diagnose.logs.load import physics_class
from registry.core import EFFECTS, PHYSICS
from registry.effects.friction import CoulombFriction
from registry.effects.stiffness import CubicStiffness
from registry.errors import BenchError
from registry.physics.oscillator import Oscillator

CART = """
from dataclasses import dataclass
from typing import Any

from registry.contracts import Channel
from registry.dynamics import constant, tensor
from registry.physics.state_space import Mechanical


@dataclass(frozen=True)
class Cart(Mechanical):
    mass: Any = constant(95.1, "M", "kg", low=1e-6)
    gain: Any = constant(35.15, "g", "N/V")
    state_channels = (Channel("displacement.q", "m"), Channel("speed.q", "m/s"))
    input_signals = ("voltage",)
    equation = "M a = g u"

    def own_force(self, state, inputs):
        return tensor(self.gain, state).unsqueeze(-1) * inputs
"""


def test_effects_of_mechanical_systems_act_in_a_cart_of_ones_own(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(CART)
    cart = physics_class(f"{tmp_path}/mine.py:Cart")
    assert cart.systems() >= {"Cart", "mass_on_rail", "oscillator"}
    made = cart(effects=(CoulombFriction(f_c=1.0), CubicStiffness(k_3=1.0)))
    assert len(made.effects) == 2
    drag = EFFECTS.get("rotor_drag")
    with pytest.raises(BenchError, match=r'does not fit Cart: .* of your own that says alike = \("quadrotor",\)'):
        cart(effects=(drag(),))


@pytest.mark.parametrize(("absent", "says"), [("own_force", "lacks own_force"), ("equation", "lacks equation")])
def test_what_a_class_lacks_is_one_sentence(absent: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(CART.replace(absent, f"other_{absent}"))
    with pytest.raises(BenchError, match=says):
        physics_class(f"{tmp_path}/mine.py:Cart")


def test_a_class_takes_the_effects_of_the_one_it_derives_from() -> None:
    class Torsion(Oscillator):
        """A disc on a wire."""

    assert Torsion.systems() - {"Torsion"} == Oscillator.systems() == {"oscillator"}
    for name in PHYSICS.names():  # those of the suite have the effects that name them
        assert PHYSICS.get(name).systems() == {name}
