"""A folder with two recordings of a driven swing."""

from pathlib import Path

import numpy as np

TOML = (
    'name = "swing"\nrate_hz = 100\nfiles = "*.csv"\ntime = "t"\ninput = "force"\n'
    '[signals]\ndisplacement = {columns = ["x"], unit = "m"}\nspeed = {columns = ["v"], unit = "m/s"}\n'
    'force = {columns = ["f"], unit = "N"}\n[physics]\nmass = 1.0\ndamping = 0.5\nstiffness = 100.0\n'
)


def write_swing(data: Path, system: str = "") -> None:
    """Make the folder: run_1.csv and run_2.csv of 4 s at 100 Hz and their dataset.toml, which may name a system."""
    data.mkdir()
    t = np.arange(400) / 100
    for i in (1, 2):
        x, v = np.sin(i * t), i * np.cos(i * t)
        table = np.column_stack([t, x, v, (100 - i * i) * x + 0.5 * v])
        np.savetxt(data / f"run_{i}.csv", table, delimiter=",", header="t,x,v,f", comments="")
    named = TOML.replace("rate_hz", f'system = "{system}"\nrate_hz', 1) if system else TOML
    (data / "dataset.toml").write_text(named)
