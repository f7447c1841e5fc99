"""Recordings of a cart on a spring that hardens, integrated by SciPy: folders as a user would bring them."""

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

RATE, MASS, DAMPING, STIFFNESS, CUBIC = 50, 0.5, 0.4, 60.0, 400.0
"""Hz, kg, N s/m, N/m, N/m³."""
DESCRIPTION = f"""\
name = "cart"
system = "oscillator"
rate_hz = {RATE}
files = "*.csv"
time = "t"
input = "force"
[signals]
displacement = {{columns = ["x"], unit = "m"}}
speed = {{columns = ["v"], unit = "m/s"}}
force = {{columns = ["f"], unit = "N"}}
[physics]
mass = {MASS}
damping = {DAMPING}
stiffness = {STIFFNESS}
"""


def carts(folder: Path, amplitudes: dict[str, float], seconds: float) -> Path:
    """Recordings by name of a cart on a spring that hardens, driven by a force of these amplitudes [N]."""
    folder.mkdir()
    random, t = np.random.default_rng(3), np.arange(round(seconds * RATE)) / RATE
    for name, amplitude in amplitudes.items():
        tones = 2 * np.pi * random.uniform(0.3, 3.0, 4), random.uniform(0, 6, 4)
        force = amplitude * sum(np.sin(w * t + p) for w, p in zip(*tones, strict=True))

        def rate(at, x, force=force):
            return x[1], (np.interp(at, t, force) - DAMPING * x[1] - STIFFNESS * x[0] - CUBIC * x[0] ** 3) / MASS

        x = solve_ivp(rate, (0, t[-1]), (0.0, 0.0), t_eval=t, max_step=0.02, rtol=1e-7, atol=1e-9).y.T
        x = x + random.normal(size=x.shape) * (2e-4, 2e-3)
        table = np.column_stack([t, x, force])
        np.savetxt(folder / f"{name}.csv", table, "%.9g", ",", header="t,x,v,f", comments="")
    (folder / "dataset.toml").write_text(DESCRIPTION, encoding="utf-8")
    return folder
