import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import torch
from conftest import Toy

from bench.experiment.config import RunConfig
from bench.experiment.notation import parse
from bench.speed.networks import channels
from bench.training.data import prepare, window_starts
from registry.contracts import Channel, Dataset, Recording, RecordingSet, Split
from registry.errors import BenchError

CONFIG = RunConfig(*parse("LSTM: 1x5 - MLP: 6x10"), Toy(), horizon=7, test_stride=3)


def recording(name: str, values: np.ndarray, valid: np.ndarray | None = None) -> Recording:
    n = len(values)
    u = np.arange(n, dtype=float)[:, None] + 1000 * values[0]
    mask = np.ones(n, bool) if valid is None else valid
    return Recording(
        name,
        100.0,
        u,
        values[:, None],
        (Channel("pilot.a", "1"),),
        (Channel("euler_rates.roll", "rad/s"),),
        mask,
    )


def test_windows_touch_no_invalid_sample() -> None:
    valid = np.ones(50, bool)
    valid[[20, 33]] = False
    expected = [s for s in range(0, 50 - 8 + 1) if valid[s : s + 8].all()]
    assert window_starts(valid, 8, 1).tolist() == expected
    assert window_starts(valid[:7], 8, 1).size == 0


def test_every_history_is_judged_from_the_same_starts() -> None:
    """k0, the last sample of history, is the same whatever τ (but where a longer history has no room)."""
    k0 = {}
    for tau in (4, 10, 23):
        predictor, initializer = parse(f"LSTM: 1x5 - MLP: 6x{tau}")
        data = prepare(replace(CONFIG, predictor=predictor, initializer=initializer))
        k0[tau] = set((data.test.starts + tau - 1).tolist())
    assert k0[10] <= k0[4] and k0[23] <= k0[10] and len(k0[23]) > len(k0[4]) - 8


def test_vehicles_at_rest_are_not_taken_for_overlapping_recordings() -> None:
    rng = np.random.default_rng(0)
    flights = []
    for name in ("a", "b", "c"):
        flight = recording(name, rng.normal(size=300))
        flight.inputs[:80], flight.outputs[:80] = 0.0, 0.0
        flights.append(flight)
    prepare(replace(CONFIG, dataset=Parts(*flights)))


def test_windows_stay_inside_their_recording_and_part() -> None:
    data = prepare(CONFIG)
    ends = np.cumsum([400] * 5)
    for part, names in (("train", data.split.train), ("validation", data.split.validation), ("test", data.split.test)):
        windows = getattr(data, part)
        first = windows.starts.numpy()
        last = first + 10 + 7 - 1
        inside = np.searchsorted(ends, first, side="right")
        assert (inside == np.searchsorted(ends, last, side="right")).all()
        assert {data.names[i] for i in inside} == set(names)


def test_history_and_horizon_are_adjacent() -> None:
    data = prepare(CONFIG)
    start = int(data.train.starts[5])
    u_history, y_history, u, y = data.gather(torch.tensor([start]))
    assert torch.equal(torch.cat([u_history, u], 1)[0], data.inputs[start : start + 17])
    assert torch.equal(torch.cat([y_history, y], 1)[0], data.outputs[start : start + 17])
    assert y_history.shape == (1, 10, 3) and y.shape == (1, 7, 3)


def test_scalers_see_the_training_part_only() -> None:
    data = prepare(CONFIG)
    train = torch.cat([data.outputs[i * 400 : (i + 1) * 400] for i in range(3)]).double()
    assert torch.allclose(data.output_scale[0], train.mean(0).float(), atol=1e-6)
    assert torch.allclose(data.output_scale[1], train.std(0, correction=0).float(), atol=1e-6)


def test_miso_picks_one_output() -> None:
    data = prepare(replace(CONFIG, outputs=("euler_rates.pitch",)))
    assert [c.name for c in data.output_channels] == ["euler_rates.pitch"]
    assert torch.equal(data.outputs[:, 0], prepare(CONFIG).outputs[:, 1])


def test_a_split_by_name_is_obeyed_and_a_wrong_one_refused() -> None:
    data = prepare(replace(CONFIG, test=("toy_0",)))
    assert data.split.test == ("toy_0",) and "toy_0" not in data.split.train
    with pytest.raises(BenchError, match="did you mean toy_"):
        prepare(replace(CONFIG, test=("toi_1",)))
    with pytest.raises(BenchError, match="both train and test"):
        prepare(replace(CONFIG, train=("toy_1", "toy_2"), test=("toy_1",)))
    with pytest.raises(BenchError, match="shorten the horizon"):
        prepare(replace(CONFIG, horizon=500))


class Parts(Dataset):
    """Recordings given at construction."""

    inputs = ("pilot",)
    targets = ("euler_rates",)

    def __init__(self, *recordings: Recording) -> None:
        self.recordings = recordings

    def read(self) -> RecordingSet:
        return RecordingSet(self.recordings, ())

    def split(self, names: list[str]) -> Split:  # type: ignore[override]
        return Split((names[0],), (names[1],), (names[2],))


def test_duplicates_are_dropped_and_named() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 100))
    loaded = Parts(recording("a", a), recording("copy", a), recording("b", b)).load()
    assert loaded.names == ["a", "b"]
    assert [(f.recording, f.kind) for f in loaded.findings] == [("copy", "duplicate")]
    assert "a" in loaded.findings[0].detail


def test_overlapping_recordings_on_two_sides_are_refused_even_shifted() -> None:
    rng = np.random.default_rng(0)
    long = rng.normal(size=400)
    whole = recording("whole", long)
    late = replace(whole, name="late", inputs=whole.inputs[150:], outputs=whole.outputs[150:], valid=whole.valid[150:])
    other = recording("other", rng.normal(size=300))
    dataset = Parts(whole, other, late)
    with pytest.raises(BenchError, match=r"whole .* and late .* share"):
        prepare(replace(CONFIG, dataset=dataset))
    apart = Parts(whole, other, recording("late", rng.normal(size=300)))
    prepare(replace(CONFIG, dataset=apart))


def test_a_window_holds_the_samples_of_the_recording() -> None:
    data = prepare(CONFIG)
    u_history, y_history, u, y = data.gather(data.validation.starts[[0, 5]])
    (validation,) = (r for r in Toy().load().recordings if r.name in data.split.validation)
    for i, start in ((0, 0), (1, 15)):
        for name, parts in (("inputs", (u_history, u)), ("outputs", (y_history, y))):
            measured = getattr(validation, name)[start : start + 17]
            np.testing.assert_allclose(torch.cat([p[i] for p in parts]), measured, rtol=1e-6)


def test_runs_of_one_kind_share_their_windows() -> None:
    assert prepare(CONFIG) is prepare(replace(CONFIG, seed=3, predictor=parse("MLFC: 2x9 - MLP: 6x10")[0]))
    assert prepare(CONFIG) is not prepare(replace(CONFIG, horizon=8))


@dataclass(frozen=True)
class Long(Dataset):
    """1.4 M samples of noise in 54 recordings, four inputs and 13 outputs."""

    inputs: ClassVar[tuple[str, ...]] = ("rotor_speed",)

    def read(self) -> RecordingSet:
        rng, n = np.random.default_rng(0), 26_000
        u, y = channels("rotor_speed"), channels("position", "attitude", "velocity", "body_rates")
        return RecordingSet(
            tuple(
                Recording(f"r{i:02}", 100.0, rng.normal(size=(n, 4)), rng.normal(size=(n, 13)), u, y, np.ones(n, bool))
                for i in range(54)
            ),
            (),
        )

    def split(self, names: Sequence[str]) -> Split:
        return Split(tuple(names[:40]), tuple(names[40:47]), tuple(names[47:]))


@pytest.mark.slow
def test_a_long_campaign_loads_and_windows_in_seconds_and_little_memory() -> None:
    """In a process of its own: digest, split with its check for overlap, windows and scalers."""
    code = (
        "import resource, sys, time; sys.path.insert(0, sys.argv[1]); import test_data as t; "
        "from bench.training.split import digest, load; started = time.process_time(); "
        "config = t.replace(t.CONFIG, dataset=t.Long(), horizon=190, test_stride=10); "
        "load(config.dataset); digest(config.dataset); data = t.prepare(config); data.gather(data.train.starts[:256]); "
        "print(time.process_time() - started, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(Path(__file__).parent)], capture_output=True, text=True)
    seconds, megabytes = map(float, done.stdout.split())
    assert seconds < 10 and megabytes < 1500, done.stderr
