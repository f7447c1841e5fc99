"""Balls that fall: nothing drives them, some recordings are shorter than a spectrum, some hold no noise at all."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bench.diagnose import diagnose, extend, load
from bench.diagnose.select.catalogue import admissible
from registry.dynamics import InputEffect
from registry.errors import BenchError

MASS, DRAG, RATE = 0.2, 0.03, 100
SHORT, LONG = {3: 0.75, 4: 0.88, 5: 0.97, 6: 1.05}, {20: 1.8, 35: 2.4, 50: 2.9, 70: 3.4}
"""Height [m] and time to the ground [s]."""
DESCRIPTION = f"""name = "balls"
system = "falling_body"
rate_hz = {RATE}
files = "*.csv"
time = "t"

[signals]
displacement = {{columns = ["h"], unit = "m"}}
SPEED
[physics]
mass = {MASS}
gravity = 9.81
"""


def balls(folder, heights, drag=DRAG, noise=0.0, speed=True):
    """A folder of balls with the force −c |v| v, integrated by another solver."""
    rng, width = np.random.default_rng(0), 2 if speed else 1

    def fall(t, x):
        return x[1], -9.81 - drag / MASS * abs(x[1]) * x[1]

    for i, (height, end) in enumerate(heights.items()):
        t = np.arange(round(end * RATE)) / RATE
        x = solve_ivp(fall, (0, t[-1]), (height, 0), t_eval=t, rtol=1e-10, atol=1e-12).y.T
        table = np.column_stack([t, (x + rng.normal(size=x.shape) * noise)[:, :width]])
        header = ",".join(("t", "h", "v")[: 1 + width])
        np.savetxt(folder / f"ball_{i}.csv", table, "%.9g", ",", header=header, comments="")
    line = 'speed = {columns = ["v"], unit = "m/s"}\n' if speed else ""
    (folder / "dataset.toml").write_text(DESCRIPTION.replace("SPEED\n", line))
    return folder


def check(found):
    assert [e.id for e in found.effects] == ["quadratic_drag"] and found.verdict == "named"
    c = found.effects[0].parameters["c"]
    assert c.low < DRAG < c.high and c.value == pytest.approx(DRAG, rel=0.02)


@pytest.mark.parametrize(("heights", "noise"), [(SHORT, 0.0), (SHORT, 0.002), (LONG, 0.0)])
def test_the_drag_of_a_ball_is_named(tmp_path, heights, noise):
    found, _ = diagnose(balls(tmp_path, heights, noise=noise), brief=True)
    check(found)
    for group, floor in found.noise_floor.items():
        assert floor.rmse > noise  # which is the error of the measurement at the end alone
        assert found.error.extended[group].rmse < 1.5 * floor.rmse + 1e-5 * found.error.nominal[group].rmse


@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_nothing_is_missing_in_the_vacuum(tmp_path, noise):
    found, _ = diagnose(balls(tmp_path, SHORT, drag=0.0, noise=noise), brief=True)
    assert found.verdict == "nothing" and not found.unexplained.follows


@pytest.mark.slow
def test_the_height_alone_suffices(tmp_path):
    heights, catalogue = {10: 1.4, 12: 1.5, 14: 1.6}, ("quadratic_drag", "input_delay")
    found, _ = diagnose(balls(tmp_path, heights, noise=0.002, speed=False), brief=True, catalogue=catalogue)
    check(found)


def test_a_delay_of_no_input_is_told(tmp_path):
    subject = load(balls(tmp_path, SHORT))
    with pytest.raises(BenchError, match="input_delay does not fit falling_body: it acts on an input"):
        extend(subject, subject.model, ["input_delay"])
    kinds = dict(admissible(subject, subject.model, None))
    assert "quadratic_drag" in kinds and not any(issubclass(k, InputEffect) for k in kinds.values())
