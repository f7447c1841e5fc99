"""Effects that hide behind one another: behind a constant that was let go."""

from dataclasses import replace

import pytest
from test_problems import flights, made

from bench.diagnose import discover

WIND, DRAG, MUNK = (4.0, -2.0), 0.06, 0.006
CATALOGUE = ["parasitic_drag", "linear_drag", "wind", "munk_moment", "rotor_reaction_torque", "rotational_damping"]


def test_what_a_wind_does_to_torques_is_found_once_the_wind_is() -> None:
    """Before it is, only a huge inertia makes these torques small, and no step leads back from there."""
    subject = made(flights(5, drag=DRAG, wind=WIND, munk=MUNK))
    found = discover(replace(subject, uncertainty={"inertia": 0.3}), CATALOGUE)
    numbers = {e.entry.name: e.value for f in found.found for e in f.estimates}
    assert {f.id for f in found.found} == {"parasitic_drag", "wind", "munk_moment"}
    assert (numbers["w_x"], numbers["w_y"]) == (pytest.approx(WIND[0], rel=0.05), pytest.approx(WIND[1], rel=0.05))
    assert (numbers["m_x"], numbers["m_y"]) == (pytest.approx(MUNK, rel=0.1), pytest.approx(MUNK, rel=0.1))
    assert not any("let go" in n for n in found.notes)
