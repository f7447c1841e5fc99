"""Recordings of a cart on a spring that hardens, of the fleet's simulator: folders as a user would bring them."""

from pathlib import Path

import numpy as np
from simulated_fleet import CUBIC, DESCRIPTION, recorded

__all__ = ["CUBIC", "carts"]


def carts(folder: Path, amplitudes: dict[str, float], seconds: float) -> Path:
    """Recordings by name of such a cart, driven by a force of these amplitudes [N]."""
    random = np.random.default_rng(3)
    for name, amplitude in amplitudes.items():
        recorded(folder, name, "cubic_stiffness", random, 1.0, seconds, amplitude)
    (folder / "dataset.toml").write_text(DESCRIPTION.replace("run_*.csv", "*.csv"), encoding="utf-8")
    return folder
