"""A physics model of a user's own file, which nobody registered."""

from pathlib import Path

import numpy as np
import pytest

from bench.diagnose.logs.load import load, physics_class
from bench.diagnose.select.catalogue import admissible
from registry.core import EFFECTS, PHYSICS
from registry.effects.mechanics.friction import CoulombFriction
from registry.effects.mechanics.stiffness import CubicStiffness
from registry.errors import BenchError
from registry.physics.oscillator import Oscillator
from registry.stated import needed
from registry.terms.signals import drive_of

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


@pytest.mark.parametrize("names", [("displacement", "speed"), ("angle", "angle_rate"), ("heading", "yaw_rate")])
def test_effects_of_mechanical_systems_are_looked_for_whatever_the_states_are_called(
    names: tuple[str, str], tmp_path: Path
) -> None:
    path, rate = names
    renamed = CART.replace("displacement.q", f"{path}.q").replace("speed.q", f"{rate}.q")
    (tmp_path / "mine.py").write_text(renamed)
    time = np.linspace(0, 40, 801)
    table = np.column_stack([time, np.sin(time), np.cos(time), np.sin(3 * time)])
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header="t,q,v,u", comments="", fmt="%.6f")
    (tmp_path / "dataset.toml").write_text(f"""
name = "cart"
rate_hz = 20
files = "run.csv"
time = "t"
input = "voltage"
[signals]
{path} = {{columns = ["q"], unit = "m"}}
{rate} = {{columns = ["v"], unit = "m/s"}}
voltage = {{columns = ["u"], unit = "V"}}
""")
    subject = load(tmp_path, f"{tmp_path}/mine.py:Cart")
    offered = {name for name, _ in admissible(subject, subject.model, None)}
    assert offered >= {"coulomb_friction", "quadratic_drag", "cubic_stiffness", "cogging", "actuator_lag"}


def test_drag_of_a_shaft_has_the_unit_of_a_torque_over_a_squared_rate(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(CART.replace('"M", "kg"', '"J", "kg m^2"'))
    shaft = physics_class(f"{tmp_path}/mine.py:Cart")
    assert shaft().effect_unit("kg/m") == "kg m^2/rad"
    assert shaft().effect_unit("N s/m") == "N m s/rad"


def test_a_constant_may_be_called_drive(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(CART.replace("gain", "drive"))
    cart = physics_class(f"{tmp_path}/mine.py:Cart")
    assert needed(cart, "voltage") == ()
    assert drive_of(cart()) == ("voltage", 1)


@pytest.mark.parametrize(("absent", "says"), [("own_force", "lacks own_force"), ("equation", "lacks equation")])
def test_what_a_class_lacks_is_one_sentence(absent: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(CART.replace(absent, f"other_{absent}"))
    with pytest.raises(BenchError, match=says):
        physics_class(f"{tmp_path}/mine.py:Cart")


CHANNELS = '(Channel("displacement.q", "m"), Channel("speed.q", "m/s"))'
DERIVATIVE = "    def derivative(self, state, inputs, input_rates=None):\n        return {}\n\n    def own_force"
FORCE = "return tensor(self.gain, state).unsqueeze(-1) * inputs"


@pytest.mark.parametrize(
    ("was", "becomes", "says"),
    [
        (FORCE, "return self.gian * inputs", r"Cart.derivative, line 19 fails with AttributeError: .*gian"),
        (FORCE, "return tensor(self.gain, state) * inputs", r"with constants \(3,\), one a state: write tensor"),
        (FORCE, "return inputs @ state", r"Cart.derivative, line 19 fails with RuntimeError"),
        (FORCE, "raise SystemExit(0)", r"Cart.derivative, line 19 fails with SystemExit"),
        (FORCE, "return own_force(self, state, inputs)", r"line 19 fails with NameError"),
        (FORCE, "return self.own_force(state, inputs)", r"line 19 fails with RecursionError"),
        ("def own_force(self, state, inputs):", "def own_force(self):", r"Cart.derivative fails with TypeError"),
        ('("voltage",)', '"voltage"', r"input_signals must be a tuple"),
        ('("voltage",)', '("volt",)', r"'volt', which is no signal: did you mean voltage"),
        (
            '(Channel("displacement.q", "m"), Channel("speed.q", "m/s"))',
            "()",
            r"state_channels must be a tuple of Channel",
        ),
        (CHANNELS, '("q", "v")', r"must be a tuple of Channel"),
        ('equation = "M a = g u"', "equation = 3", r"equation must be a text"),
        ("class Cart(Mechanical):", "class Cart(Mechanical)", r"mine.py, line 11 fails with SyntaxError"),
        ("from typing import Any", "from typing import Amy", r"mine.py, line 3 fails with ImportError"),
        ("@dataclass(frozen=True)", "import sys; sys.exit(3)", r"mine.py, line 10 fails with SystemExit: 3"),
        ("@dataclass(frozen=True)", "@dataclass", r"mine.py, line 10 fails with TypeError"),
        (
            "    def own_force",
            DERIVATIVE.format("state[..., :1]"),
            r"derivative makes \(3, 1\) of states \(3, 2\) and inputs \(3, 1\)",
        ),
        (
            "    def own_force",
            DERIVATIVE.format("0.0"),
            r"derivative returns float, where a tensor \(…, 2\) is due",
        ),
        (
            "    def own_force",
            "    def project(self, state):\n        state / 2\n\n    def own_force",
            r"project returns NoneType",
        ),
    ],
)
def test_a_mistake_in_a_class_is_one_sentence_with_its_line(was: str, becomes: str, says: str, tmp_path: Path) -> None:
    assert was in CART
    (tmp_path / "mine.py").write_text(CART.replace(was, becomes, 1))
    with pytest.raises(BenchError, match=says) as error:
        physics_class(f"{tmp_path}/mine.py:Cart")
    assert "\n" not in str(error.value)


def test_a_class_takes_the_effects_of_the_one_it_derives_from() -> None:
    class Torsion(Oscillator):
        """A disc on a wire."""

    assert Torsion.systems() - {"Torsion"} == Oscillator.systems() == {"oscillator"}
    for name in PHYSICS.names():  # those of the suite have the effects that name them
        assert PHYSICS.get(name).systems() == {name}
