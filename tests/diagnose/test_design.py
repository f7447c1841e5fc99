"""Designed manoeuvres: the criterion against closed forms, signals within limits, and a tie that is told."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.optimize import minimize

from bench.cli.commands.models import parse_limits
from bench.diagnose import design, diagnose
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.manoeuvre import page
from bench.diagnose.manoeuvre.design import _telling_most
from bench.diagnose.manoeuvre.discrimination import scores
from bench.diagnose.manoeuvre.limits import Limit, shown
from bench.diagnose.manoeuvre.rivals import of_diagnosis
from bench.diagnose.manoeuvre.separation import (
    Candidate,
    Distance,
    Windows,
    distance,
    information,
    log_determinant,
    predictions,
)
from bench.diagnose.manoeuvre.stock import KINDS, phrase_of, stock_signals
from bench.diagnose.manoeuvre.waveform import PARAMETERS, multisine, signals
from bench.diagnose.manoeuvre.waveform import _Grid as Grid
from bench.diagnose.regression.parameters import entries
from bench.diagnose.simulate.free_run import groups
from registry.contracts import Channel, Recording
from registry.core import EFFECTS
from registry.errors import BenchError
from registry.physics.mass_on_rail import MassOnRail
from registry.physics.oscillator import Oscillator
from registry.physics.quadrotor import Quadrotor
from registry.physics.quadrotor_pilot import smoothed

DT = 0.01


def recorded(name, model, signal, u, x):
    made = Recording(name, 1 / DT, u[:, None], x, (Channel(signal, "1"),), model.state_channels, np.ones(len(x), bool))
    return log_of(made, model, signal)


# ------------------------------------------------------------------------------------------------ the criterion


def test_the_information_of_a_swing_is_that_of_the_closed_form() -> None:
    """∂v/∂k of an oscillator over a window is −∫ q dt / m, of q = A sin ωt in closed form."""
    amplitude, omega, mass, sigma, steps = 0.3, 7.0, 2.0, 0.05, 40
    t = np.arange(801) * DT
    states = np.stack([amplitude * np.sin(omega * t), amplitude * omega * np.cos(omega * t)], axis=1)
    model = Oscillator(mass=mass, damping=0.0, stiffness=98.0)
    log = recorded("swing", model, "force", np.zeros(len(t)), states)
    speed = tuple(g for g in groups(model.state_channels, log.measured) if g.name == "speed")
    windows = Windows(steps, np.array([steps]), speed, np.array([[1 / sigma]]))
    where = tuple(e for e in entries(model, {"mass": 0, "damping": 0}) if e.name == "stiffness")
    one = Candidate("k", model, where, np.zeros((1, 1)))
    slopes = predictions(one, [log], windows)[1]
    found = information(slopes[None], one.known)[0, 0, 0] / one.scales[0] ** 2
    begin = t[:-steps:steps]
    integral = amplitude / omega * (np.cos(omega * begin) - np.cos(omega * (begin + steps * DT)))
    assert found == pytest.approx(((integral / mass / sigma) ** 2).sum(), rel=2e-3)
    assert log_determinant(information(slopes[None], one.known, 4), [0]) == pytest.approx(
        np.log(4 * found * one.scales[0] ** 2)
    )


def test_the_distance_is_the_least_over_the_rivals_parameters() -> None:
    rng = np.random.default_rng(0)
    away, slopes, half = rng.normal(size=(3, 5, 4)), rng.normal(size=(3, 5, 4, 2)), rng.normal(size=(2, 2))
    known, often = half @ half.T, 3
    found = distance(away, slopes, known, often)
    for w in range(3):

        def loss(delta, w=w):
            left = away[w] - slopes[w] @ delta
            return (left**2).sum() + delta @ known @ delta / often

        assert found.total[w] == pytest.approx(minimize(loss, np.zeros(2), tol=1e-12).fun, rel=1e-8)


def test_a_line_is_told_from_a_constant_by_how_far_apart_its_points_are() -> None:
    """Of y = b x against a free constant, Σ (y − c)² is least at the mean: b² Σ (x − x̄)²."""
    x, b = np.array([-1.0, 0.5, 2.0, 2.5]), 0.7
    found = distance((b * x)[None, :, None], np.ones((1, 4, 1, 1)), np.zeros((1, 1)))
    assert found.total[0] == pytest.approx(b**2 * ((x - x.mean()) ** 2).sum())
    imitated = distance((b * x)[None, :, None], x[None, :, None, None], np.zeros((1, 1)))
    assert imitated.total[0] == pytest.approx(0, abs=1e-9)


def test_what_few_blocks_show_is_worth_less_than_what_all_do() -> None:
    even = Distance(np.full((1, 20), 5.0), np.zeros(1))
    lumped = Distance(np.r_[np.full(2, 50.0), np.zeros(18)][None], np.zeros(1))
    assert scores(even)[0] > 3 > 0 > scores(lumped)[0]
    assert scores(even, often=2)[0] > scores(even)[0] > scores(even, beside=30)[0]


@pytest.mark.parametrize(
    ("limit", "kept", "stock"),
    [(10.0, 3.0, "dead_zone"), (2.5, 2.0, "backlash"), (1.5, 1.0, "dead_zone"), (0.5, 3.0, "dead_zone")],
)
def test_what_tells_most_within_the_limits_is_kept(limit: float, kept: float, stock: str) -> None:
    """A manoeuvre as large as it tells; where all leave the limits there is nothing to choose by but what they tell."""

    class Judge(SimpleNamespace):
        asked = ()

        def inside(self, asked: np.ndarray) -> bool:
            return float(asked.max()) <= limit

        def chances(self, asked: np.ndarray, often: list[int]) -> tuple[np.ndarray, int]:
            return np.full((2, len(often)), float(asked.max()) / 10), 1

    sizes = {"backlash": 2.0, "dead_zone": 3.0}
    others = [(name, np.full((1, 5, 1), size)) for name, size in sizes.items()]
    plan, best, phrase = _telling_most(Judge(), np.full((1, 1, 5, 1), 1.0), others, (10.0, 20.0))  # type: ignore[arg-type]
    assert plan.asked.max() == kept and best is not None
    assert best.asked.max() == sizes[stock] and phrase == phrase_of(stock)


# -------------------------------------------------------------------------------------------------- the signals


def test_signals_stay_within_their_limits_and_rates() -> None:
    limits = (Limit("a", "V", -1.0, 3.0, 8.0, 0.5), Limit("b", "V", 0.0, 2.0))
    z = np.random.default_rng(1).uniform(size=(50, 2 * PARAMETERS))
    found = signals(z, limits, 501, DT, (0.2, 5.0))
    assert found.shape == (50, 501, 2) and (found[:, 0, 0] == 0.5).all()
    for i, limit in enumerate(limits):
        assert limit.low <= found[..., i].min() and found[..., i].max() <= limit.high
    assert np.abs(np.diff(found[..., 0], axis=1)).max() <= 8.0 * DT + 1e-12
    assert np.ptp(found[..., 1]) > 1.8


def test_a_multisine_has_power_in_its_band_alone_and_a_low_crest() -> None:
    grid = Grid(1000, DT, (0.1, 10.0), 2)
    wave = multisine(grid, np.array([1.0]), np.array([4.0]), 0, 1)[0]
    power = np.abs(np.fft.rfft(wave)) ** 2
    at = np.fft.rfftfreq(1000, DT)
    assert power[(at < 0.95) | (at > 4.05)].sum() < 1e-9 * power.sum()
    assert np.abs(wave).max() == pytest.approx(1) and 1 / wave.std() < 2.2  # of cosines in phase: 7.9
    other = multisine(grid, np.array([1.0]), np.array([4.0]), 1, 2)[0]
    mine = multisine(grid, np.array([1.0]), np.array([4.0]), 0, 2)[0]
    assert abs(mine @ other) < 1e-6 * (mine @ mine)


def test_a_manoeuvre_shorter_than_the_slowest_waves_still_gives_each_channel_one_of_its_own() -> None:
    limits = tuple(Limit(name, "m", -1.0, 1.0) for name in "abcd")
    z = np.random.default_rng(2).uniform(size=(8, 4 * PARAMETERS))
    found = signals(z, limits, 101, DT, (0.05, 0.5))  # one second
    assert np.isfinite(found).all()
    grid, band = Grid(101, DT, (0.05, 0.5), 4), (np.array([0.1]), np.array([0.5]))
    waves = np.concatenate([multisine(grid, *band, i, 4) for i in range(4)])
    assert np.abs(np.triu(waves @ waves.T, 1)).max() < 0.05 * np.diag(waves @ waves.T).min()


def test_every_stock_manoeuvre_stays_within_the_limits() -> None:
    limits = (Limit("position.x", "m", -2, 2, 1.0), Limit("position.z", "m", 0.5, 3.0, 1.0, 1.0))
    for kind in {*KINDS.values(), "steps"}:
        found = stock_signals(kind, limits, 1001, DT)
        assert np.ptp(found) > 0.5, kind
        for i, limit in enumerate(limits):
            assert limit.low <= found[..., i].min() and found[..., i].max() <= limit.high
    assert set(KINDS) <= set(EFFECTS.names())


def test_the_pilot_follows_set_points() -> None:
    model = Quadrotor(extras=("time",), effects=(EFFECTS.get("rotor_drag").typical(),))
    asked = np.zeros((1, 601, 4))
    asked[..., 2] = 1.0
    asked[:, 50:, :] = (1.0, -0.5, 1.8, 0.6)
    drives, states = model.pilot().flown(asked, torch.zeros(1, 601, 1, dtype=torch.float64), DT)
    path, last = smoothed(asked, DT), states[0, -1].numpy()
    assert np.abs(states[0, :, :3].numpy() - path[0, :, 0, :3]).max() < 0.25
    assert last[:3] == pytest.approx([1.0, -0.5, 1.8], abs=0.05)
    assert 2 * np.arctan2(last[8], last[9]) == pytest.approx(0.6, abs=0.02)
    assert drives.min() > 0
    speed = np.gradient(path[0, :, 0, 0], DT)
    assert path[0, :, 1, 0] == pytest.approx(speed, abs=0.05)


# ------------------------------------------------------------------------------------------ what a user may say


@pytest.mark.parametrize("text", ["voltage", "voltage=1", "voltage=a:b", "voltage=0:1:0", "v=0:nan", "v=0:1:2:3"])
def test_a_limit_of_another_form_is_one_sentence(text: str) -> None:
    with pytest.raises(BenchError, match="write SIGNAL=LOW:HIGH"):
        parse_limits((text,))


def rail(hidden, inputs, seed=0, samples=1500, noise=(2e-5, 5e-4)):
    """A mass on a rail that another solver moved: a subject of six recordings or more."""
    rng, model, logs = np.random.default_rng(seed), MassOnRail(), []
    for i, u in enumerate(inputs):
        t = np.arange(len(u)) * DT

        def moved(at, x, u=u, t=t):
            return x[1], (35.15065188248547 * np.interp(at, t, u) + hidden(x[1])) / 95.1

        x = solve_ivp(moved, (0, t[-1]), (0, 0), t_eval=t, rtol=1e-8, atol=1e-10, max_step=0.02).y.T
        logs.append(recorded(f"run_{i:02d}", model, "voltage", u, x + rng.normal(size=x.shape) * noise))
    names = [log.name for log in logs]
    held = set(names[1::4])
    return Subject(
        "rail",
        model,
        tuple(logs),
        training=tuple(n for n in names if n not in held),
        held_out=tuple(n for n in names if n in held),
        signals=("displacement", "speed", "voltage"),
    )


def one_way(count=6, samples=1500):
    t = np.arange(samples) * DT
    return [0.9 + 0.1 * np.sin(2 * np.pi * (t / 1.2 + i / count)) for i in range(count)]


@pytest.fixture(scope="module")
def forward() -> Subject:
    return rail(lambda v: -20.0, one_way())


def test_limits_are_those_of_the_recordings_unless_told(forward: Subject) -> None:
    found = shown(forward)
    (voltage,) = found.drives
    assert (voltage.low, voltage.high) == pytest.approx((0.0, 1.0), abs=0.01)
    assert voltage.rate == pytest.approx(0.1 * 2 * np.pi / 1.2, rel=0.02)
    assert 0.8 < found.band[1] < 1.5  # 1 / 1.2 Hz, and what leaks of it
    speed = found.states[1]
    assert speed.low == -speed.high
    told = found.told({"voltage": (-1.0, 2.0, 5.0)}).drives[0]
    assert (told.low, told.high, told.rate) == (-1.0, 2.0, 5.0)
    with pytest.raises(BenchError, match="did you mean voltage"):
        found.told({"voltag": (0.0, 1.0, None)})
    with pytest.raises(BenchError, match="1 is not below 0"):
        found.told({"voltage": (1.0, 0.0, None)})


def test_where_nothing_is_left_to_separate_that_is_said(forward: Subject, tmp_path: Path) -> None:
    file = tmp_path / "diagnosis.json"
    file.write_text(json.dumps({"dataset": "rail", "verdict": "nothing", "effects": []}))
    with pytest.raises(BenchError, match="Nothing is left to separate: the diagnosis of rail says nothing"):
        of_diagnosis(forward, file, forward.model, noise=None)  # type: ignore[arg-type]
    file.write_text("{}")
    with pytest.raises(BenchError, match=r"no diagnosis\.json"):
        of_diagnosis(forward, file, forward.model, noise=None)  # type: ignore[arg-type]
    unseen = replace(forward, logs=tuple(replace(log, estimated=(False, True)) for log in forward.logs))
    with pytest.raises(BenchError, match=r"speed\.q was not measured"):
        design(unseen, candidates=["offset_force", "dead_zone"])
    with pytest.raises(BenchError, match="at least two effects"):
        design(forward, candidates=["offset_force"])


@pytest.mark.slow
def test_a_tie_is_told_by_what_was_designed(forward: Subject, tmp_path: Path) -> None:
    """Driven one way, a constant force looks like dry friction; what is designed is driven through another solver."""
    tied, model = diagnose(forward, brief=True)
    assert tied.verdict == "tie"
    (effect,) = tied.effects
    names = (effect.id, *effect.indistinguishable_from)
    assert "offset_force" in names
    found = design(forward, model, names, limits={"voltage": (-1.0, 1.0, 5.0), "displacement": (-30.0, 30.0, None)})
    assert found.plan.told[:, -1].min() > 0.95
    assert found.stock is not None and found.plan.told.mean() >= found.stock.told.mean()
    page.write_csv(tmp_path / "design.csv", found)
    head, *rows = (tmp_path / "design.csv").read_text().splitlines()
    assert head == "t [s],voltage [1]" and len(rows) == 1001
    u = np.loadtxt(rows, delimiter=",")[:, 1]
    assert "if it is offset force" in page.render(found)
    flown_again = rail(lambda v: -20.0, [*one_way(), *[u] * 3], seed=5)
    told, _ = diagnose(flown_again, brief=True)
    assert told.verdict == "named" and [e.id for e in told.effects] == ["offset_force"]
    assert told.effects[0].indistinguishable_from == ()
