"""The weak form against closed forms, and its shortcuts against the long way."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.signal import savgol_filter

from bench.diagnose.logs.sample import shortened
from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import Log, LogBatch, log_of
from bench.diagnose.regression import test_functions, weak
from bench.diagnose.simulate.roll import roll
from registry.contracts import Channel, Recording
from registry.dynamics import PhysicsModel
from registry.effects.actuation import ActuatorLag, MotorLag
from registry.effects.suspended_load import SuspendedLoad
from registry.physics.lorenz import Lorenz
from registry.physics.oscillator import Oscillator
from registry.physics.quadrotor import Quadrotor
from registry.terms import signals

DT = 0.01
T = np.arange(600) * DT


def test_the_model_is_smoothed_as_the_data_were_and_no_window_touches_an_invalid_sample():
    speed, rate = np.sin(25 * T), 25 * np.cos(25 * (T[:-1] + DT / 2))
    measured = savgol_filter(speed, 21, 2)[:, None]
    valid = torch.ones(len(T), dtype=torch.bool)
    valid[300] = False
    nothing = torch.zeros(len(T), 0, dtype=torch.float64)
    # Test functions look at the length and the mask of a log only.
    log = Log("wave", 1 / DT, torch.from_numpy(measured), (True,), nothing, valid, SimpleNamespace())
    left = {}
    for smoothing in (Smoothing("savgol", 21, 2), Smoothing()):
        tests = test_functions.TestFunctions.over([log], 6, [smoothing])
        integral = tests.integral(0, 0, rate[:, None], DT)
        left[smoothing.kind] = np.abs(tests.increment(0, measured) - integral)[2:-2].max()
        reach = len(smoothing.kernel()) // 2 + 6
        assert (np.abs(tests.centres[0] - 300) >= reach).all()
    assert left["savgol"] < 0.02 * left["none"]


@pytest.mark.parametrize("length", [0.7, torch.tensor([0.25, 2.2], dtype=torch.float64).reshape(2, 1, 1)])
def test_a_swinging_load_that_is_solved_at_once_takes_the_path_of_one_step_after_another(length, monkeypatch):
    flight = torch.from_numpy(np.cumsum(np.random.default_rng(3).normal(size=(2, 403, 13)), axis=1) * 1e-2)
    flight[..., 9] += 1.0
    speeds = 900 + 30 * torch.sin(torch.arange(403.0, dtype=torch.float64)).reshape(1, -1, 1).expand(2, -1, 4)
    model = Quadrotor(effects=(SuspendedLoad(m_l=0.1, l=length, zeta=0.1),))
    stack = LogBatch((), flight, speeds, 0.01)
    at_once = weak.own_states(model, stack)
    monkeypatch.setattr(weak, "solved", lambda *a: None)
    one_by_one = weak.own_states(model, stack)
    assert one_by_one.abs().max() > 0.01
    torch.testing.assert_close(at_once, one_by_one, rtol=1e-11, atol=1e-12)


def test_what_swings_below_is_driven_by_what_rotors_do_and_not_by_what_they_are_told():
    dt, t = 0.005, 0.005 * torch.arange(401, dtype=torch.float64)
    model = Quadrotor(effects=(MotorLag(tau_up=0.08, tau_down=0.08), SuspendedLoad(m_l=0.1, l=0.5, zeta=0.1)))
    told = 900 * (1 + 0.1 * torch.sin(9 * t)[:, None] * torch.tensor([1.0, 1.01, 0.99, 1.0]))
    memory = torch.cat([e.steady(told[None, 0], dt) for e in model.input_effects()], dim=-1)
    level = torch.eye(13, dtype=torch.float64)[9:10]
    flown = roll(model, torch.cat([level, torch.zeros(1, 4), memory], dim=-1), told[None], dt)
    size = len(model.state_channels)
    own = weak.own_states(model, LogBatch((), flown[..., :size], told[None], dt))
    swung = flown[..., size : size + own.shape[-1]]
    assert swung.abs().max() > 0.01
    torch.testing.assert_close(own, swung, rtol=0.01, atol=1e-3 * swung.abs().max().item())


def test_what_a_term_follows_of_the_inputs_is_what_passes_a_lag():
    """A step u of a held force, of which 1 − exp(−t/τ) acts."""
    tau, told = 0.08, torch.cat([torch.zeros(1, 5, 1), torch.ones(1, 40, 1)], dim=1).double()
    model = Oscillator(input_hold="previous", effects=(ActuatorLag(tau=tau),))
    (name,) = signals.input_names(Oscillator, *signals.drive_of(model))
    followed = weak.followed(name, model, LogBatch((), torch.zeros(1, 45, 2).double(), told, DT))
    passed = 1 - tau / DT * -np.diff(np.exp(-DT * np.arange(40) / tau))
    assert followed[0].numpy() == pytest.approx(np.concatenate([np.zeros(5), passed]), abs=1e-6)


BEGIN = [3.0, -4.0, 20.0]


def lorenz(t: float, x: np.ndarray) -> list[float]:
    return [10 * (x[1] - x[0]), x[0] * (28 - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]]


def driven(held: bool):
    """A force that steps or bends every 20 ms, and what it does to m d²q/dt² = u − d dq/dt − k q."""
    forces = np.random.default_rng(5).normal(0, 30, 60)

    def force(t):
        return forces[(t / 0.02 + 1e-9).astype(int)] if held else np.interp(t, 0.02 * np.arange(60), forces)

    return force, lambda t, x: [x[1], force(np.array(t)) - 0.5 * x[1] - 100 * x[0]]


def path_of(equation, begin: list[float], dt: float, samples: int) -> np.ndarray:
    """(N, s), integrated from each sample to the next."""
    path = [np.array(begin)]
    for t in dt * np.arange(samples - 1):
        piece = solve_ivp(equation, (t + 1e-12, t + dt - 1e-12), path[-1], "DOP853", rtol=1e-12, atol=1e-12)
        path.append(piece.y[:, -1])
    return np.array(path)


def logged(model: PhysicsModel, path: np.ndarray, dt: float, force: np.ndarray) -> Log:
    driving = tuple(Channel(f"{n}.u", "N") for n in model.input_signals)
    valid = np.ones(len(path), dtype=bool)
    made = Recording("run", 1 / dt, force[:, : len(driving)], path, driving, model.state_channels, valid)
    return log_of(made, model, *(model.input_signals or [""]))


@pytest.mark.parametrize("system", ["lorenz", "held", "linear"])
def test_mean_rates_tell_the_step_from_one_sample_to_the_next_to_the_fifth_order(system):
    """Against another integrator; those at the mean of the two tell it to the third, as the trapezoidal rule does."""
    force, equation = (None, lorenz) if system == "lorenz" else driven(system == "held")
    model = Lorenz() if force is None else Oscillator(input_hold="previous" if system == "held" else "linear")
    begin, left = BEGIN if force is None else [0.1, 0.0], []
    for dt in (0.01, 0.005):
        x = path_of(equation, begin, dt, round(1 / dt) + 1)
        log = logged(model, x, dt, x if force is None else force(dt * np.arange(len(x)))[:, None])
        stack = LogBatch.of([log])
        rates = weak.mean_rates(model, stack)[0], weak.midpoint_rates(model, stack)[0]
        left.append([np.abs(np.diff(x, axis=0) - dt * r.numpy()).max() for r in rates])
    (mean, middle), (mean_of_half, middle_of_half) = left
    assert mean / mean_of_half == pytest.approx(2**5, rel=0.2)
    assert middle / middle_of_half == pytest.approx(2**3, rel=0.2) and mean < 0.02 * middle


def test_of_what_was_thinned_out_mean_rates_are_those_of_all_samples():
    x = path_of(lorenz, BEGIN, 0.002, 501)
    (thin,) = shortened([logged(Lorenz(), x, 0.002, x)], 1000, 8)
    part = thin.part(slice(7, 40), "part")
    for log, first in ((thin, 0), (part, 7)):
        seen = LogBatch.of([log])
        steps = torch.from_numpy(x[first * 8 :: 8][: len(log)]).diff(dim=0)
        rates = (r(Lorenz(), seen)[0] for r in (weak.mean_rates, weak.midpoint_rates))
        mean, middle = ((steps - log.dt * r).abs().max() for r in rates)
        assert mean < 1e-7 and middle > 1e-3


def test_a_state_that_was_not_measured_does_not_bend():
    """It stands at zero, where a spring pulls nothing."""
    force, equation = driven(held=False)
    x = path_of(equation, [0.1, 0.0], 0.01, 101) * [0.0, 1.0]
    log = replace(logged(Oscillator(), x, 0.01, force(0.01 * np.arange(101))[:, None]), measured=(False, True))
    soft, stiff = (weak.mean_rates(Oscillator(stiffness=k), LogBatch.of([log]))[..., 1] for k in (0.0, 100.0))
    assert torch.equal(soft, stiff)
