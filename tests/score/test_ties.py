"""A hover that does not tell two effects apart, by RotorPy: the answer names both."""

from pathlib import Path

import pytest

from bench.diagnose import discover
from bench.score.cases import DEVELOPMENT, cases, write_folder

pytest.importorskip("rotorpy")


@pytest.mark.parametrize("hidden", ["mass-crazyflie-2", "thrust_scale-crazyflie-1"])
def test_a_rival_is_judged_by_its_best_numbers_and_its_own_noise(hidden: str, tmp_path: Path) -> None:
    """A payload and weak rotors do the same to a hover, once the numbers of either have been fitted to the end.

    After one step from the numbers of the other, a rival seemed to lose a fifth of the forces; and rotors that are
    stronger hand on more of the noise of their speeds to the torques, which does not make a payload of them.
    """
    (case,) = (c for c in cases(DEVELOPMENT) if c.id == f"1-tie-{hidden}")
    write_folder(case, tmp_path / "hover", tmp_path / "flights")
    (found,) = discover(tmp_path / "hover").found
    assert {"mass", "thrust_scale"} <= {found.id, *found.rivals}
