"""What an effect saves on held-out recordings, where a few moments of a manoeuvre have nearly all of it."""

import pytest
from simulated_fleet import CUBIC, DRAG, vehicle

from bench.diagnose import diagnose


def test_two_effects_that_act_in_few_moments_are_named(tmp_path):
    """By Student's interval the cubic stiffness saves 62 % (−15 to 138) of the held-out error, which was not sure."""
    size = 0.9794753841052475
    found, _ = diagnose(vehicle(tmp_path / "cart", "two", 1009, size))
    numbers = {e.id: e.parameters for e in found.effects}
    assert found.verdict == "named"
    assert set(numbers) == {"cubic_stiffness", "quadratic_drag"}
    for told, true in ((numbers["cubic_stiffness"]["k_3"], CUBIC), (numbers["quadratic_drag"]["c"], DRAG)):
        assert told.value == pytest.approx(size * true, rel=0.01)
