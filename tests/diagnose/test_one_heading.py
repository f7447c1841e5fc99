"""Wind on flights at one heading, whose rotors lean as well: both push alike; and something unknown turns the body.

By inverse dynamics along sums of sines, as in `test_problems`.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_problems import DT, HUBS, INERTIA, K_F, K_M, MASS, SPINS, Columns, made

from bench.diagnose import discover

LEAN, LEAN_IN_WIND = 0.02, 0.35
"""About body y [rad], which at one heading pushes as about so much more of wind [m/s] along world x would."""


def flight(seed: int, wind: float, linear: float = 0.0, square: float = 0.0, unknown: float = 0.0) -> Columns:
    """A flight of 16 s towards x: drag [kg/s, kg/m], a torque [N m] that goes with the place, wind along x [m/s]."""
    rng, h = np.random.default_rng(seed), DT / 10
    t = np.arange(16000 + 2) * h
    path = np.zeros((len(t), 3))
    for low, high, speed in ((0.5, 1.5, 0.8), (1.5, 3.0, 0.6), (4.0, 7.0, 0.2)):
        w = rng.uniform(low, high, 3)
        path += speed / w * np.sin(t[:, None] * w + rng.uniform(0, 6.3, 3))
    velocity = np.gradient(path, h, axis=0)
    air = velocity - [wind, 0, 0]
    drag = (linear + square * np.linalg.norm(air, axis=1, keepdims=True)) * air / MASS
    pull = np.gradient(velocity, h, axis=0) + drag + np.array([0, 0, 9.81])
    up = pull / np.linalg.norm(pull, axis=1, keepdims=True)
    side = np.cross(up, [1.0, 0, 0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    attitude = Rotation.from_matrix(np.stack([np.cross(side, up), side, up], axis=2))
    attitude *= Rotation.from_rotvec([0, -LEAN, 0])
    turning = (attitude[:-2].inv() * attitude[2:]).as_rotvec() / (2 * h)
    rates = np.concatenate([turning[:1], turning, turning[-1:]])
    torque = INERTIA * np.gradient(rates, h, axis=0) + np.cross(rates, INERTIA * rates)
    torque[:, 1] -= unknown * np.sin(3 * path[:, 0])
    mixer = np.stack([np.ones(4), HUBS[:, 1], -HUBS[:, 0], SPINS * K_M / K_F])
    wrench = np.column_stack([MASS * np.linalg.norm(pull, axis=1), torque])
    speed = np.sqrt(np.maximum(np.linalg.solve(mixer, wrench.T).T / K_F, 0))
    at = slice(1, -1, 10)
    signals = {"position": path, "attitude": attitude.as_quat(), "velocity": velocity, "body_rates": rates}
    noise = {"position": 2e-4, "attitude": 2e-4, "velocity": 0.01, "body_rates": 0.05}
    noisy = {name: x[at] + rng.normal(0, noise[name], x[at].shape) for name, x in signals.items()}
    noisy["attitude"] /= np.linalg.norm(noisy["attitude"], axis=1, keepdims=True)
    return {"t": t[at], **noisy, "rotor_speed": speed[at], "rotor_command": speed[at]}


@pytest.mark.parametrize(
    ("drag", "wind", "hidden"),
    [
        pytest.param("linear_drag", 4.0, {"linear": 0.2, "unknown": 0.02}, marks=pytest.mark.slow),
        ("parasitic_drag", 4.0, {"square": 0.06}),
        pytest.param("linear_drag", 10.0, {"linear": 0.2, "unknown": 0.02}, marks=pytest.mark.slow),
        pytest.param("parasitic_drag", -12.0, {"square": 0.03, "unknown": 0.02}, marks=pytest.mark.slow),
    ],
)
def test_wind_is_found_behind_leaning_rotors_and_another_drag(drag: str, wind: float, hidden: dict[str, float]) -> None:
    """In a gentle wind one exchange that broke its promise had ended the search, and a drag could be no other one
    without the wind. In a strong one neither explains anything alone, and what is unknown in torques is no matter."""
    found = discover(made([flight(500 + i, wind, **hidden) for i in range(4)]))
    numbers = {e.entry.name: e.value for f in found.found for e in f.estimates}
    assert {f.id for f in found.found} == {drag, "wind"}
    assert numbers["w_x"] == pytest.approx(wind + LEAN_IN_WIND, rel=0.05)
