"""What Silverbox's drive does between two samples: the named physics with straight lines there, and within the band."""

import csv
import tomllib
from pathlib import Path

import numpy as np
import pytest

from registry.datasets.benchmarks.silverbox import OFFICIAL, QUIET, RATE, band_limited

MODEL = Path(__file__).parents[2] / "results/published/nonlinear_benchmarks/silverbox/model.toml"
START = 49
"""The last of the samples that a simulation may start from."""


def free_run(force: np.ndarray, dt: float, q: float, v: float) -> np.ndarray:
    """Displacements (N,) of the published model by Runge and Kutta, written out here."""
    said = tomllib.loads(MODEL.read_text(encoding="utf-8"))
    (hardening,) = (e["k_3"] for e in said["effects"] if e["id"] == "cubic_stiffness")
    m, d, k = (said["physics"][name] for name in ("mass", "damping", "stiffness"))

    def pull(q: float, v: float, u: float) -> float:
        return (u - d * v - k * q - hardening * q**3) / m

    found = [q]
    for a, b in zip(force[:-1].tolist(), force[1:].tolist(), strict=True):
        w, middle = pull(q, v, a), (a + b) / 2
        v2 = v + dt / 2 * w
        w2 = pull(q + dt / 2 * v, v2, middle)
        v3 = v + dt / 2 * w2
        w3 = pull(q + dt / 2 * v2, v3, middle)
        v4 = v + dt * w3
        q, v = (
            q + dt / 6 * (v + 2 * v2 + 2 * v3 + v4),
            v + dt / 6 * (w + 2 * w2 + 2 * w3 + pull(q + dt * v3, v4, b)),
        )
        found.append(q)
    return np.array(found)


@pytest.mark.data
@pytest.mark.parametrize(
    ("finer", "millivolts"),
    [
        (1, {"multisine_test": 4.14, "arrow": 4.64, "arrow_no_extrapolation": 3.20}),
        (4, {"multisine_test": 0.333, "arrow": 0.430, "arrow_no_extrapolation": 0.358}),
    ],
)
def test_straight_lines_between_samples_are_what_limits_the_named_physics(
    finer: int, millivolts: dict[str, float], bench_data: Path
) -> None:
    """RMSE over the official test parts, at measured samples; both channels are taken from their readings at rest."""
    with (bench_data / "silverbox/SNLS80mV.csv").open() as file:
        table = np.array([(float(row["V1"]), float(row["V2"])) for row in csv.DictReader(file)])
    drive, moved = (table - table[QUIET].mean(axis=0)).T
    force, speed = band_limited(drive, finer) if finer > 1 else drive, band_limited(moved, 1, 1)
    for name, expected in millivolts.items():
        first, last = OFFICIAL[name].start + START, OFFICIAL[name].stop
        told = free_run(force[first * finer : last * finer], 1 / RATE / finer, moved[first], speed[first])[::finer]
        error = 1e3 * np.sqrt(np.mean((told - moved[first:last])[1:] ** 2))
        assert error == pytest.approx(expected, rel=0.01), name
