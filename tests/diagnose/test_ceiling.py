"""A network around a model, against systems whose truth is known: something hidden, nothing hidden, a gust."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import torch
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from bench.cli import cli
from bench.diagnose.ceiling import ceiling as steps
from bench.diagnose.ceiling import examples, findings, network, scaling
from bench.diagnose.ceiling.ceiling import Ceiling, ceiling, informed
from bench.diagnose.ceiling.deviation import corrected, deviation
from bench.diagnose.ceiling.findings import Compared
from bench.diagnose.compare import Repetition, compare
from bench.diagnose.evidence import Predictable
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.report import page
from bench.diagnose.report.ceiling_words import sentences
from bench.diagnose.result import schema
from bench.diagnose.settings import CEILING
from bench.diagnose.simulate.free_run import Group
from registry.contracts import Channel, Recording
from registry.errors import BenchError
from registry.physics.oscillator import Oscillator
from tests.diagnose import samples, swinging

RATE, FINE, HARDER = 100.0, 4, 8000.0
MODEL = Oscillator(mass=1.0, damping=0.5, stiffness=100.0)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """A training of seconds."""
    small = replace(CEILING, seeds=1, updates=500, windows=1500)
    for module in (steps, examples, findings, network, scaling):
        if hasattr(module, "CEILING"):
            monkeypatch.setattr(module, "CEILING", small)


def rates(x: np.ndarray, force: np.ndarray, harder: float) -> np.ndarray:
    """Of displacement and speed (2, …) of 1 kg on a spring that hardens."""
    return np.stack([x[1], force - 0.5 * x[1] - 100 * x[0] - harder * x[0] ** 3])


def run(start: np.ndarray, force: np.ndarray, harder: float) -> np.ndarray:
    """States (N, 2, …) from a start (2, …) under a force (N, …) that is linear between samples; Runge and Kutta."""
    out, x, h = [start], start, 1 / RATE / FINE
    for before, after in pairwise(force):
        for k in range(FINE):
            u0, um, u1 = (before + (after - before) * (k + s) / FINE for s in (0, 0.5, 1))
            k1 = rates(x, u0, harder)
            k2 = rates(x + h / 2 * k1, um, harder)
            k3 = rates(x + h / 2 * k2, um, harder)
            x = x + h / 6 * (k1 + 2 * (k2 + k3) + rates(x + h * k3, u1, harder))
        out.append(x)
    return np.stack(out)


def swung(harder: float, noise: float = 2e-3, gust: float = 0.0, count: int = 8) -> Subject:
    """Recordings of 15 s, the last three held out; a gust is a force that nobody logged and that wanders slowly."""
    rng, samples_ = np.random.default_rng(1), int(15 * RATE)
    smooth = np.hanning(21)  # nothing fast that would pass for noise of the force
    force = np.stack([np.convolve(rng.normal(size=samples_ + 20), smooth, "valid") for _ in range(count)])
    pushed = np.zeros_like(force)
    for i in range(count):
        for k in range(1, samples_):
            pushed[i, k] = 0.99 * pushed[i, k - 1] + gust * rng.normal()
    force = 10 * force / force.std()
    states = run(rng.normal(size=(2, count)) * [[0.02], [0.2]], (force + pushed).T, harder)  # (N, 2, count)
    logs = []
    for i in range(count):
        x = states[..., i] + noise * states.std((0, 2)) * rng.normal(size=states[..., i].shape)
        channels = (Channel("force", "N"),)
        made = Recording(
            f"run_{i}", RATE, force[i][:, None], x, channels, MODEL.state_channels, np.ones(samples_, bool)
        )
        logs.append(log_of(made, MODEL, "force"))
    names = [log.name for log in logs]
    signals = ("displacement", "speed", "force")
    return Subject("swung", MODEL, tuple(logs), tuple(names[:-3]), tuple(names[-3:]), None, {}, {}, signals)


def attainable(subject: Subject, harder: float, horizon: int = 50) -> np.ndarray:
    """Rms errors of displacement and speed that the true simulator makes from measured starts."""
    off = []
    for log in subject.of(subject.held_out):
        x, force = log.states.numpy(), log.inputs.numpy()[:, 0]
        at = np.arange(10, len(x) - horizon - 1, 9)
        windows = force[at[:, None] + np.arange(horizon + 1)].T
        off.append(run(x[at].T, windows, harder)[-1].T - x[at + horizon])
    return np.sqrt(np.square(np.concatenate(off)).mean(0))


def of_group(found: Ceiling, group: str) -> Predictable:
    return next(f for f in found.findings if f.group == group)


@pytest.mark.usefixtures("quick")
def test_a_hidden_effect_is_predicted_and_said_to_be_missing() -> None:
    subject = swung(HARDER)
    found = ceiling(subject)
    best, speed, place = attainable(subject, HARDER), of_group(found, "speed"), of_group(found, "displacement")
    assert place.model > 4 * best[0] and speed.model > 4 * best[1]
    assert place.network < 0.3 * place.model and speed.network < 0.3 * speed.model
    assert speed.network > 0.8 * best[1]  # nothing looks ahead
    assert speed.finding == "missing" and speed.own and not place.own
    assert sentences(found.findings)[0].endswith("something is still missing, in speed.")


@pytest.mark.usefixtures("quick")
def test_around_the_true_model_little_is_left() -> None:
    subject = swung(0.0)
    speed = of_group(ceiling(subject), "speed")
    assert speed.finding == "little"
    assert speed.network == pytest.approx(attainable(subject, 0.0)[1], rel=0.3)
    assert speed.model == pytest.approx(attainable(subject, 0.0)[1], rel=0.1)


@pytest.mark.usefixtures("quick")
def test_what_an_observer_tells_as_well_is_not_called_missing() -> None:
    speed = of_group(ceiling(swung(0.0, gust=0.1)), "speed")
    assert speed.model > 3 * speed.floor and speed.observer < 0.9 * speed.model
    assert speed.finding in ("slow", "open", "little")


def held(gust: float = 10.0, count: int = 8) -> Subject:
    """A mass that a controller holds by the logged force, against one that nobody logged and that changes quickly."""
    rng, samples_, h = np.random.default_rng(1), int(15 * RATE), 1 / RATE / FINE
    x, pushed, states, forces = np.zeros((2, count)), np.zeros(count), [], []
    for _ in range(samples_):
        force = rng.normal(0, 8, count) - 60 * x[0] - 12 * x[1]  # of sensors, whose noise hides what it answers
        states.append(x)
        forces.append(force)
        for _ in range(FINE):
            pushed = (1 - 10 * h) * pushed + gust * h**0.5 * rng.normal(size=count)
            x = x + h * np.stack([x[1], force + pushed - 0.5 * x[1] - MODEL.stiffness * x[0]])
    made = np.stack(states, axis=1).transpose(2, 1, 0)  # (count, N, 2)
    made = made + 1e-4 * made.std((0, 1)) * rng.normal(size=made.shape)
    model, applied = replace(MODEL, input_hold="previous"), np.stack(forces)
    logs = tuple(
        log_of(
            Recording(
                f"run_{i}",
                RATE,
                applied[:, i : i + 1],
                made[i],
                (Channel("force", "N"),),
                MODEL.state_channels,
                np.ones(samples_, bool),
            ),
            model,
            "force",
        )
        for i in range(count)
    )
    names, signals = tuple(log.name for log in logs), ("displacement", "speed", "force")
    return Subject("held", model, logs, names[:-3], names[-3:], None, {}, {}, signals)


@pytest.mark.usefixtures("quick")
def test_what_a_controller_brings_back_is_not_called_missing() -> None:
    """The model is the true one, and forecasts badly: what disturbs follows no signal. A network knows the loop."""
    speed = of_group(ceiling(held()), "speed")
    assert speed.network < 0.75 * min(speed.model, speed.observer)
    assert speed.autoregression < 1.2 * speed.network
    assert speed.finding == "autoregression"


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("kind", "never"),
    [
        ("clean", {"missing", "slow", "open", "worse"}),
        ("sampled", {"missing", "slow", "open", "worse"}),
        ("gust", {"missing", "little"}),
        ("rubbing", {"little", "slow", "open", "worse"}),
        ("wave", {"little", "slow", "open", "worse"}),
    ],
)
def test_eight_sets_of_a_kind_are_judged_alike(kind: str, never: set[str]) -> None:
    found = [of_group(ceiling(swinging.subject(kind, 200 + n)), "speed").finding for n in range(8)]
    assert not set(found) & never, found


@pytest.mark.usefixtures("quick")
def test_it_stands_beside_the_lines_of_compare_and_is_the_same_each_time() -> None:
    subject = swung(HARDER, count=6)
    found, known = ceiling(subject), compare(subject)
    for line, same in (("extended", "nominal"), ("floor", "floor"), ("disturbance", "disturbance")):
        for group in ("displacement", "speed"):
            here, there = found.curves[group].lines[line], known.lines[same][group]
            assert here.rmse == pytest.approx(there.rmse, rel=1e-12) and here.low == pytest.approx(there.low, rel=1e-12)
    assert ceiling(subject).error == found.error


def test_nothing_is_learned_from_recordings_that_are_held_out(quick: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network, "CEILING", replace(CEILING, seeds=1, updates=20))
    trained: list[torch.Tensor] = []
    learned = network.Networks.learned

    def kept(*given: object) -> network.Networks:
        made = learned(*given)  # type: ignore[arg-type]
        trained.append(torch.cat([p.detach().flatten() for p in made.models[0].parameters()]))
        return made

    monkeypatch.setattr(steps.Networks, "learned", kept)
    subject = swung(HARDER)
    other = swung(2 * HARDER)
    held = [o if s.name in subject.held_out else s for s, o in zip(subject.logs, other.logs, strict=True)]
    taught = [o if s.name == subject.training[0] else s for s, o in zip(subject.logs, other.logs, strict=True)]
    for logs in (subject.logs, held, taught):
        ceiling(replace(subject, logs=tuple(logs), timed=True))
    assert torch.equal(trained[0], trained[1])
    assert not torch.equal(trained[0], trained[2])


def test_recordings_that_are_too_short_are_said() -> None:
    subject = swung(HARDER)
    with pytest.raises(BenchError, match="too short or too few for a network"):
        ceiling(replace(subject, training=()))


def test_a_deviation_is_what_is_to_be_added() -> None:
    rng, groups = (
        np.random.default_rng(0),
        [Group("velocity", "m/s", (0, 1, 2)), Group("attitude", "rad", (3, 4, 5, 6))],
    )
    first, turn = Rotation.random(20, random_state=1), Rotation.from_rotvec(rng.normal(size=(20, 3)) * 0.4)
    a = np.concatenate([rng.normal(size=(20, 3)), first.as_quat()], axis=1)
    b = np.concatenate([rng.normal(size=(20, 3)), (turn * first).as_quat()], axis=1)
    off = deviation(torch.from_numpy(a), torch.from_numpy(b), groups)
    size = np.linalg.norm(turn.as_rotvec(), axis=1)
    sign = np.sign((b[:, 3:] * a[:, 3:]).sum(1))[:, None]
    expected = sign * turn.as_rotvec() * (2 * np.sin(size / 2) / size)[:, None]
    assert off[:, 3:].numpy() == pytest.approx(expected)  # about the world's axes
    back = corrected(torch.from_numpy(a), off, groups).numpy()
    assert back[:, :3] == pytest.approx(b[:, :3])
    assert (Rotation.from_quat(back[:, 3:]) * (turn * first).inv()).magnitude() == pytest.approx(np.zeros(20), abs=1e-7)


@pytest.mark.parametrize(
    ("model", "observer", "auto", "network_", "floor", "expected"),
    [
        (1.0, 1.0, 10.0, 0.3, 0.1, "missing"),
        (1.0, 0.35, 10.0, 0.3, 0.1, "slow"),  # an observer tells it as well
        (1.0, 0.35, 0.3, 0.3, 0.1, "slow"),
        (1.0, 1.0, 10.0, 0.95, 0.1, "little"),
        (1.0, 1.0, 10.0, 1.3, 0.1, "worse"),
        (1.0, 1.0, 10.0, 0.79, 0.1, "open"),  # 0.8 is within its interval
        (1.3, 1.3, 10.0, 0.3, 1.0, "little"),  # a better known start saves as much
        (2.0, 2.0, 10.0, 1.55, 1.0, "open"),
        (1.0, 1.0, 0.35, 0.3, 0.1, "autoregression"),  # what a controller holds comes back whatever the physics
        (1.0, 1.0, 0.5, 0.3, 0.1, "missing"),
        (1.0, 1.0, 0.35, 0.95, 0.1, "little"),
    ],
)
def test_what_follows_from_errors(
    model: float, observer: float, auto: float, network_: float, floor: float, expected: str
) -> None:
    rng = np.random.default_rng(3)
    own = rng.chisquare(6, size=(200, 1)) / 6
    unit = np.arange(200) // 10
    draws = rng.multinomial(20, np.full(20, 1 / 20), size=1000).astype(float)
    jitter = rng.chisquare(6, size=(200, 1)) / 6
    squared = {
        "extended": model**2 * own,
        "disturbance": observer**2 * own,
        "network": network_**2 * jitter,
        "floor": np.full((200, 1), floor**2),
        "still": np.full((200, 1), 100.0),
        "autoregression": auto**2 * own,
    }
    of = Compared(squared, Repetition(unit, draws, ""), [Group("speed", "m/s", (0,))])
    assert of.finding(0) == expected


def told(finding: str, axes: tuple[str, ...] = ()) -> Predictable:
    return Predictable("body_rates", 0.5, "rad/s", 1.5, 1.4, 1.1, 0.9, 0.05, finding, axes=axes)


def test_sentences_say_where_and_by_how_much() -> None:
    (said,) = sentences([told("missing", ("body_rates.p", "body_rates.q"))])
    assert "body rates after 0.5 s from 85.9 to 51.6 deg/s (floor 2.86)" in said and said.endswith(
        "missing, in body rates p and q."
    )
    assert "in body rates." in sentences([told("missing")])[0]
    assert sentences([replace(told("missing"), own=False)]) == []
    assert len(sentences([told(f) for f in ("missing", "slow", "autoregression", "little", "open", "worse")])) == 6


def test_a_diagnosis_has_it_on_its_page_and_in_its_figures(tmp_path: Path) -> None:
    plain = samples.named()
    page.write(tmp_path / "before.html", plain)
    assert plain.to_json()["ceiling"] is None and "with a network" not in (tmp_path / "before.html").read_text()
    curves = plain.evidence.curves
    findings_ = tuple(
        Predictable(g, 0.5, c.unit, 1.0, 1.0, 1.0, c.lines["extended"].rmse[-1] / 2, 0.001, "missing")
        for g, c in curves.items()
    )
    lines = {g: replace(c, lines={"network": c.lines["extended"]}) for g, c in curves.items()}
    full = informed(plain, Ceiling(lines, findings_, findings_[1:2], ("A note on the network.",)))
    jsonschema.validate(full.to_json(), schema())
    assert full.to_json()["ceiling"]["velocity"]["rmse"] == pytest.approx(samples.EXTENDED["velocity"] / 2)
    page.write(tmp_path / "after.html", full)
    shown = (tmp_path / "after.html").read_text()
    for text in ("with a network", "something is still missing", "A note on the network."):
        assert text in shown


@pytest.fixture
def spring(tmp_path: Path) -> Path:
    """A folder of recordings of the hardening spring."""
    data = tmp_path / "spring"
    data.mkdir()
    for log in swung(HARDER, count=5).logs:
        t = np.arange(len(log)) / RATE
        table = np.column_stack([t, log.states.numpy(), log.inputs.numpy()[:, 0]])
        np.savetxt(data / f"{log.name}.csv", table, delimiter=",", header="t,x,v,f", comments="")
    (data / "dataset.toml").write_text(
        'name = "spring"\nsystem = "oscillator"\nrate_hz = 100\nfiles = "*.csv"\ntime = "t"\ninput = "force"\n'
        '[signals]\ndisplacement = {columns = ["x"], unit = "m"}\nspeed = {columns = ["v"], unit = "m/s"}\n'
        'force = {columns = ["f"], unit = "N"}\n[physics]\nmass = 1.0\ndamping = 0.5\nstiffness = 100.0\n'
    )
    return data


@pytest.mark.usefixtures("quick")
def test_the_command_writes_a_diagnosis_first_and_then_with_the_network(spring: Path) -> None:
    done = CliRunner().invoke(cli, ["diagnose", str(spring), "--ceiling", "--catalogue", "cubic_stiffness"])
    assert done.exit_code == 0, done.output
    assert done.output.count("Wrote ") == 2 and "A network on the same history and inputs" in done.output
    said = json.loads((spring / "diagnosis" / "diagnosis.json").read_text())
    assert said["effects"][0]["id"] == "cubic_stiffness"
    jsonschema.validate(said, schema())
    assert 0 < said["ceiling"]["speed"]["rmse"] < 0.5 * said["error"]["nominal"]["speed"]["rmse"]


def test_ctrl_c_leaves_the_diagnosis_that_was_written(spring: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*given: object, **named: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(steps.Networks, "learned", stopped)
    done = CliRunner().invoke(cli, ["diagnose", str(spring), "--ceiling", "--catalogue", "cubic_stiffness"])
    assert done.exit_code == 130 and "The diagnosis is written" in done.output
    assert json.loads((spring / "diagnosis" / "diagnosis.json").read_text())["ceiling"] is None
