"""A magnet that floats under a coil: what is off grows 2.7 times in 40 ms, in the best model too."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from torch import Tensor

from bench.diagnose import compare, diagnose
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.simulate.free_run import followed, free_run, groups
from bench.diagnose.simulate.multiple_shooting import _Runs, multiple_shooting
from registry.contracts import Channel, Recording
from registry.core import EFFECTS
from registry.dynamics import PhysicsModel, constant, tensor
from registry.physics.state_space import Mechanical
from registry.units import Signal
from tests.diagnose.machines_of_any_size import cart, lag

RATE, MASS, MAGNETIC, DAMPING, NOISE = 400.0, 1e-3, 4e-3, 0.03, 1e-5
CURRENT, PLACE = 0.0223, 0.0142
"""Where K i²/y² carries the weight [A, m]."""


@dataclass(frozen=True)
class Magnet(Mechanical):
    """A magnet under a coil; the displacement is its distance, downwards."""

    mass: Any = constant(MASS, "m", "kg", low=1e-9)
    magnetic: Any = constant(1.5 * MAGNETIC, "K", "N m^2/A^2", low=1e-12, uncertainty=0.5)
    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("displacement.q", "m"), Channel("speed.q", "m/s"))
    input_signals: ClassVar[tuple[str, ...]] = ("current",)
    signals: ClassVar[dict[str, Signal]] = {"current": Signal("A", ("",))}
    equation: ClassVar[str] = "m d²y/dt² = m g − K i²/y²"

    def own_force(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Weight less the pull of the coil (…, 1) [N]."""
        mass, k = (tensor(v, state).unsqueeze(-1) for v in (self.mass, self.magnetic))
        return 9.81 * mass - k * inputs[..., :1] ** 2 / state[..., :1].clamp(min=1e-3) ** 2


def floated(seed: int, damping: float = DAMPING) -> Recording:
    """6 s on a controller that follows steps; eddy currents damp the motion."""
    rng, fine = np.random.default_rng(seed), 20
    y, v, wanted, out = PLACE, 0.0, PLACE, np.empty((2400, 3))
    for k in range(len(out)):
        if k % 40 == 0:
            wanted = PLACE + 7e-4 * rng.uniform(-1, 1)
        i = float(np.clip(CURRENT + 8.0 * (y + NOISE * rng.normal() - wanted) + 0.12 * v, 0.002, 0.06))
        out[k] = y, v, i
        for _ in range(fine):
            v += (9.81 - (MAGNETIC * i**2 / y**2 + damping * v) / MASS) / RATE / fine
            y += v / RATE / fine
    states = out[:, :2] + rng.normal(size=(len(out), 2)) * (NOISE, 30 * NOISE)
    valid = np.ones(len(out), dtype=bool)
    return Recording(f"run_{seed}", RATE, out[:, 2:], states, (Channel("current", "A"),), Magnet.state_channels, valid)


def test_what_no_model_can_follow_is_neither_judged_nor_fitted_by() -> None:
    """Half a second would be a factor of 3·10⁵: fits overflowed, or named effects whose runs diverge."""
    model = Magnet(input_hold="previous")
    logs = tuple(log_of(floated(seed), model, "current") for seed in range(5))
    names, known = tuple(log.name for log in logs), {"mass": 0.02, "magnetic": 0.5}
    signals = ("current", "displacement", "speed")
    subject = Subject("magnet", model, logs, names[:3], names[3:], signals=signals, uncertainty=known)
    found, extended = diagnose(subject)
    (effect,) = found.effects
    assert effect.id == "viscous_friction" and effect.parameters["f_v"].value == pytest.approx(DAMPING, rel=0.1)
    horizons = {e.horizon_s for e in found.error.extended.values()}
    assert max(horizons) < 0.3
    for name, error in found.error.extended.items():
        assert error.rmse < 1.5 * found.noise_floor[name].rmse
    asked = compare(subject, {"extended": extended}, horizon_s=0.5)
    assert asked.horizon_s[-1] == pytest.approx(0.5) and asked.lost_s is None


def test_shooting_survives_runs_that_overflow() -> None:
    """A spring that pushes away with the cube of the place takes a run to infinity within half a second."""
    model = Magnet(magnetic=MAGNETIC, input_hold="previous", effects=(EFFECTS.get("cubic_stiffness")(k_3=-3e4),))
    log = log_of(floated(0, damping=0.0), model, "current")
    subject = Subject("magnet", model, (log,), (log.name,), (), signals=("current", "displacement", "speed"))
    ends = free_run(model, [log], [np.arange(0, 2000, 100)], 200)
    assert not torch.isfinite(ends).all()
    shot = multiple_shooting(model, subject, [log.name])
    assert np.isfinite(shot.after) and np.isfinite(shot.covariance).all()
    assert abs(shot.model.effects[0].k_3) < 0.1 * 3e4


def test_a_number_by_which_runs_diverge_at_the_least_step_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a mirror of micrometres one step of a hysteretic stiffness led to 1e200, and its covariance never ended."""
    of, errors, inverse = cart(lag), _Runs.errors, np.linalg.pinv

    def diverging(runs: _Runs, model: PhysicsModel) -> np.ndarray:
        out = errors(runs, model)
        if out.ndim > 3:  # of many models: that which has another mass
            out[1] = 1e200
        return out

    def finite(matrix: np.ndarray) -> np.ndarray:
        assert np.isfinite(matrix).all()  # else LAPACK goes round in circles
        return np.asarray(inverse(matrix))

    monkeypatch.setattr(_Runs, "errors", diverging)
    monkeypatch.setattr(np.linalg, "pinv", finite)
    shot = multiple_shooting(replace(of.model, damping=5.0), of, of.training)
    assert shot.model.mass == of.model.mass and shot.model.damping == pytest.approx(6.0, rel=0.2)
    spread = dict(zip([e.name for e in shot.free], np.diag(shot.covariance), strict=True))
    assert spread["mass"] == np.inf and np.isfinite(spread["damping"])


def test_runs_tell_as_long_as_one_group_is_nearer_than_its_mean() -> None:
    channels = [Channel("angle.a", "rad"), *(Channel(f"attitude.{c}", "1") for c in "xyzw")]
    turns = torch.tensor([[0.0, 0, 0.6, 0.8], [0.0, 0, -0.6, -0.8], [0.0, 0, -0.6, 0.8]])
    measured = torch.cat([torch.tensor([[-1.0], [0.0], [1.0]]), turns], dim=1).unsqueeze(0)
    of = groups(channels, [True] * 5)
    sure, lost = [0.0, 0.0], [9.0, 9.0]
    assert followed(torch.tensor([sure, sure, sure, [0.0, 9.0], lost, sure]), measured, of) == 3
    assert followed(torch.tensor([sure, lost, lost]), measured, of) == 1
    assert followed(torch.tensor([sure, [float("inf"), 1.5]]), measured, of) == 1
    # Of q, −q and its inverse the mean lies between; all but half a turn of 74 deg is spread.
    assert followed(torch.tensor([sure, sure, [9.0, 1.0], [9.0, 2.5]]), measured, of) == 2
