"""Files in the formats of published data sets that are not at hand, their signals made up."""

from pathlib import Path

import numpy as np
import scipy.io
import scipy.signal

FLIGHTS = 6
"""Of the Pelican: the fewest that can be split."""


def driven(samples: int, inputs: int = 1, outputs: int = 1, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Inputs (m, N) that are smooth, and outputs (n, N) that follow sums of them."""
    rng = np.random.default_rng(seed)
    u = scipy.signal.lfilter([0.1], [1, -0.9], rng.normal(size=(inputs, samples)))
    y = scipy.signal.lfilter([0.05, 0.05], [1, -1.6, 0.7], rng.normal(size=(outputs, inputs)) @ u)
    return u, y + 0.001 * rng.normal(size=y.shape)


def _save(file: Path, **variables: object) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    scipy.io.savemat(file, variables)


def write_missing(folder: Path) -> None:
    """The files of `wiener_hammerstein`, `bouc_wen`, `coupled_drives`, `f16`, `industrial_robot` and `pelican`."""
    u, y = driven(188_000)
    _save(folder / "wiener_hammerstein/WienerHammerBenchMark.mat", uBenchMark=u.T, yBenchMark=y.T, fs=[[51_200.0]])
    for i, name in enumerate(("val_multisine", "val_sinesweep", "_first")):
        u, y = driven(3000, seed=i)
        _save(folder / f"bouc_wen/u{name}.mat", **{f"u{name}": 10 * u})
        _save(folder / f"bouc_wen/y{name}.mat", **{f"y{name}": 1e-3 * y})
    (u, y), (v, z) = driven(500, seed=3), driven(500, seed=4)
    _save(folder / "coupled_drives/DATAUNIF.MAT", u11=u.T, z11=y.T, u12=v.T, z12=z.T)
    for i, name in enumerate(("FullMSine_Level1", "SineSw_Level3", "SineSw_Level4_Validation")):
        u, y = driven(2000, 1, 3, seed=i)
        _save(folder / f"f16/F16Data_{name}.mat", Force=u, Voltage=u, Acceleration=y, Fs=[[400.0]])
    u, y = driven(4 * 606, 6, 6)
    last = {"u_test": u[:, -606:], "y_test": y[:, -606:]}
    file = folder / "industrial_robot/forward_identification_without_raw_data.mat"
    _save(file, u_train=u[:, :-606], y_train=y[:, :-606], **last)
    cells = np.empty((1, FLIGHTS), dtype=object)
    for i in range(FLIGHTS):
        cells[0, i] = _flight(1000, i)
    _save(folder / "pelican/AscTec_Pelican_Flight_Dataset.mat", flights=cells)


def _flight(samples: int, seed: int) -> dict[str, object]:
    """One cell of the Pelican's file: mm, degrees, whole numbers of the motors; rates are those of the angles."""
    rng, t = np.random.default_rng(seed), np.arange(samples) / 100
    waves = np.sin(2 * np.pi * np.outer(rng.uniform(0.2, 1, 6), t) + rng.uniform(0, 6, (6, 1)))
    position, euler = 900 * waves[:3], np.array([[25.0], [30.0], [170.0]]) * waves[3:]
    roll, pitch, _ = np.deg2rad(euler[:, 1:])
    d_roll, d_pitch, d_yaw = np.diff(euler) * 100
    rates = [
        d_roll - np.sin(pitch) * d_yaw,
        np.cos(roll) * d_pitch + np.sin(roll) * np.cos(pitch) * d_yaw,
        np.cos(roll) * np.cos(pitch) * d_yaw - np.sin(roll) * d_pitch,
    ]
    motors = np.round(90 + 40 * np.sin(t + rng.uniform(0, 6, (4, 1)))) + rng.integers(0, 9, (4, samples))
    return {
        "len": samples,
        "Pos": position,
        "Euler": euler,
        "Motors": motors,
        "Motors_CMD": motors,
        "Vel": np.diff(position) * 100,
        "pqr": np.stack(rates),
    }
