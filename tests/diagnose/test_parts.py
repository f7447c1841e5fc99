"""Few long recordings are cut in parts, so that what one of them alone shows is learnt and tested."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bench.diagnose import diagnose
from bench.diagnose.logs.load import load
from bench.diagnose.logs.parts import in_parts

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


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three recordings, of which the second alone, by name the one in the middle, moves far."""
    return carts(tmp_path_factory.mktemp("few") / "carts", {"a": 0.05, "b": 2.0, "c": 0.05}, 40.0)


def test_what_one_of_three_recordings_shows_is_found(three: Path) -> None:
    told, _ = diagnose(three, brief=True)
    assert [e.id for e in told.effects] == ["cubic_stiffness"]
    (number,) = told.effects[0].parameters.values()
    assert number.low < CUBIC < number.high
    assert number.high - number.low < 0.1 * CUBIC


def test_every_recording_is_learnt_from_and_tested(three: Path) -> None:
    whole = load(three)
    cut = in_parts(whole)
    learnt, tested = ({n.split("_")[0] for n in names} for names in (cut.training, cut.held_out))
    assert learnt == tested == {"a", "b", "c"}
    assert not set(cut.training) & set(cut.held_out)
    assert in_parts(cut) is cut
    for log in whole.logs:  # no sample is lost, moved or used twice
        parts = [p for p in cut.logs if p.name.startswith(log.name)]
        for of, own in ((log.states, "states"), (log.inputs, "inputs"), (log.valid, "valid")):
            assert np.array_equal(np.concatenate([getattr(p, own) for p in parts]), of)
        assert np.array_equal(np.concatenate([p.recording.outputs for p in parts]), log.recording.outputs)


@pytest.mark.parametrize(("count", "seconds"), [(6, 40.0), (3, 25.0)], ids=["enough recordings", "too short to cut"])
def test_whole_recordings_are_held_out(tmp_path: Path, count: int, seconds: float) -> None:
    subject = load(carts(tmp_path / "carts", dict.fromkeys("abcdef"[:count], 0.5), seconds))
    assert in_parts(subject).logs is subject.logs
