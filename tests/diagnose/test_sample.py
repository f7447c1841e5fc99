"""What is looked at of many or of long recordings: bounded, evenly spread, and said."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bench.diagnose.logs.sample import sampled, shared, shortened
from bench.diagnose.logs.subject import Log, LogBatch, Subject
from bench.diagnose.regression.parameters import Prior
from bench.diagnose.regression.rows import Rows, noise_filters
from bench.diagnose.regression.starting_points import StartingPoints
from bench.diagnose.select.search import Search
from bench.diagnose.settings import FOLDING, READING, SEARCHING
from registry.contracts import Channel, Recording
from registry.physics.oscillator import Oscillator

CHANNELS = Channel("force", "N"), Channel("displacement.q", "m"), Channel("speed.q", "m/s")


def log(name: str, samples: int) -> Log:
    """A recording in which every signal counts the samples."""
    count = np.arange(samples, dtype=float)
    recording = Recording(
        name=name,
        rate=100.0,
        inputs=count[:, None],
        outputs=np.stack([count, count], axis=1),
        input_channels=CHANNELS[:1],
        output_channels=CHANNELS[1:],
        valid=np.ones(samples, dtype=bool),
    )
    states, inputs = torch.from_numpy(recording.outputs), torch.from_numpy(recording.inputs)
    return Log(name, 100.0, states, (True, True), inputs, torch.ones(samples, dtype=torch.bool), recording)


def subject(recordings: int, samples: int) -> Subject:
    """Of every three recordings the last one is held out."""
    logs = tuple(log(f"f{i:04d}", samples) for i in range(recordings))
    names = [x.name for x in logs]
    held_out = tuple(names[2::3])
    return Subject("many", Oscillator(), logs, tuple(n for n in names if n not in held_out), held_out)


def test_states_that_a_recording_holds_as_they_are_take_no_memory_until_they_are_computed_with() -> None:
    one = log("f", 40)
    wide = np.concatenate([np.zeros((40, 1)), one.states.numpy(), np.ones((40, 2))], axis=1)
    five = tuple(Channel(f"x.{i}", "1") for i in range(5))
    whole = replace(
        one, recording=replace(one.recording, outputs=wide, output_channels=five), states=one.states.clone()
    )
    lean = shared(whole)
    assert np.shares_memory(lean.states.numpy(), wide) and torch.equal(lean.states, whole.states)
    turned = replace(whole, states=-whole.states)
    assert shared(turned) is turned
    many = subject(30, READING.enough // 15)
    many = replace(many, logs=tuple(replace(x, states=x.states.T.contiguous().T) for x in many.logs))
    assert not many.logs[0].states.is_contiguous() and all(x.states.is_contiguous() for x in sampled(many).logs)


def moving(name: str, samples: int) -> Log:
    """A recording of an oscillator that swings; its force is noise of .1 N."""
    rng, t = np.random.default_rng([*name.encode()]), np.arange(samples) / 100
    swing = np.stack([np.sin(5 * t), 5 * np.cos(5 * t)], axis=1) + rng.normal(scale=0.01, size=(samples, 2))
    force = rng.normal(scale=0.1, size=(samples, 1))
    made = log(name, samples)
    recording = replace(made.recording, inputs=force, outputs=swing)
    return replace(made, recording=recording, states=torch.from_numpy(swing), inputs=torch.from_numpy(force))


def test_short_recordings_among_long_ones_change_little_of_what_these_say_of_noise_and_motion() -> None:
    """Side by side the short ones are padded: what does not move there is neither noise nor motion."""
    long, short = ([moving(f"{n}{i}", n) for i in range(count)] for n, count in ((2000, 4), (60, 8)))
    searches = []
    for logs in (long, long + short):
        names = tuple(x.name for x in logs)
        searches.append(
            Search(replace(subject(1, 9), logs=tuple(logs), training=names, held_out=()), None, lambda _: None)
        )
    some, all_ = searches
    assert all_.stride == some.stride
    for search in searches:
        assert search.noisy is not None
        drawn = search.stack.samples(search.noisy.inputs - search.stack.inputs)
        assert float(drawn.std()) == pytest.approx(0.1, rel=0.05)
    points = [
        StartingPoints.of(
            Oscillator(), s.stack.samples(s.stack.states), s.stack.samples(s.stack.inputs), s.stack.logs[0]
        )
        for s in searches
    ]
    assert points[1].sizes["speed"] == pytest.approx(points[0].sizes["speed"], rel=0.02)
    rng = np.random.default_rng(3)
    parts = tuple((rng.normal(size=(n, 1)),) for n in (900, 900, 900, 30))
    free = Prior(*(np.zeros(0) for _ in range(4)))
    assert len(noise_filters(Rows(parts, (np.array([0]),), 0, 0.02), free)[0]) == SEARCHING.memory + 1


def test_what_is_enough_stays_as_it_is() -> None:
    some = subject(12, READING.enough // 12)
    assert sampled(some) is some


def test_of_many_recordings_whole_ones_are_taken_evenly_and_said() -> None:
    many = subject(900, 1000)
    some = sampled(many)
    taken = [int(x.name[1:]) for x in some.logs]
    assert 0.97 * READING.enough < sum(map(len, some.logs)) <= READING.enough
    assert {len(x) for x in some.logs} == {1000}
    assert sorted({*some.training, *some.held_out}) == [x.name for x in some.logs]
    assert len(some.training) == 2 * len(some.held_out)
    assert set(some.training) <= set(many.training) and set(some.held_out) <= set(many.held_out)
    assert np.diff(taken).max() <= 2 * len(many.logs) / len(taken)
    assert min(taken) < 10 and max(taken) > 890
    said = some.notes[-1]
    assert "900 recordings were read and checked, and 180 of them" in said and "fitted to 120 and tested on 60" in said


def test_of_a_recording_whose_middle_is_not_valid_a_stretch_is_taken_that_is() -> None:
    one = log("f", 2000)
    valid = torch.ones(2000, dtype=torch.bool)
    valid[700:1300] = False
    (part,) = shortened([replace(one, valid=valid)], 500)
    assert len(part) == 500 and part.valid.all() and part.states[0, 0] == 200  # 200 to 700, nearest to the middle
    valid[:] = False
    assert len(shortened([replace(one, valid=valid)], 500)[0]) == 500


@pytest.mark.parametrize("recordings", [4, 9])
def test_of_long_recordings_the_middle_is_taken_with_all_that_was_measured(recordings: int) -> None:
    long = subject(recordings, 2 * READING.enough // recordings)
    some = sampled(long)
    assert [x.name for x in some.logs] == [x.name for x in long.logs]
    assert sum(map(len, some.logs)) == pytest.approx(READING.enough, abs=recordings)
    for before, x in zip(long.logs, some.logs, strict=True):
        first = int(x.states[0, 0])
        assert abs(first + len(x) / 2 - len(before) / 2) <= 1
        np.testing.assert_array_equal(x.recording.outputs, x.states)
        np.testing.assert_array_equal(x.recording.inputs, x.inputs)
    assert "the middle 50 % of each" in some.notes[-1]


def test_a_stretch_is_long_enough_to_be_learnt_from_however_many_recordings_there_are() -> None:
    some = shortened(subject(300, 3000).logs, 24_000)
    assert sum(map(len, some)) <= 24_000
    assert {len(x) for x in some} == {round(READING.stretch * 100)}


def test_a_sample_left_out_does_not_hide_that_it_is_not_valid() -> None:
    gap = log("gap", 1000)
    gap = replace(gap, valid=torch.arange(1000) != 401)
    (some,) = shortened([gap], 10_000, stride=2)
    assert some.rate == some.recording.rate == 50.0
    np.testing.assert_array_equal(np.flatnonzero(~some.valid), [200])
    np.testing.assert_array_equal(some.recording.valid, some.valid)


def test_folds_of_many_recordings_are_neighbours_and_hold_all_rows() -> None:
    """No more matrices than folds, whose sum is that over all rows; blocks know theirs."""
    rng = np.random.default_rng(3)
    logs = 23
    parts = tuple((rng.normal(size=(30, 3)), rng.normal(size=(30, 2))) for _ in range(logs))
    rows = Rows(parts, (np.array([0, 1, 3]), np.array([2, 3])), 3, 0.1)
    folds = rows.folds()
    assert len(folds) == FOLDING.most
    dense = np.zeros((4, 4))
    for first, second in parts:
        dense[np.ix_([0, 1, 3], [0, 1, 3])] += first.T @ first
        dense[np.ix_([2, 3], [2, 3])] += second.T @ second
    np.testing.assert_allclose(sum(folds), dense)
    normal = rows.normal()
    assert sorted(normal.by_fold) == list(range(FOLDING.most)) and (np.diff(normal.fold) >= 0).all()
    for fold, gram in normal.by_fold.items():  # 30 rows are one block, so that nothing is dropped
        np.testing.assert_allclose(gram, folds[fold])


@pytest.mark.parametrize("stride", [3, 4])
def test_of_a_swing_the_means_between_samples_are_those_of_its_integral(stride: int) -> None:
    """As at the full rate; the two ends of what is left out would err by a twelfth of its phase squared."""
    omega, rate, one = 31.4, 300.0, log("swing", 1200)
    t = torch.arange(1200, dtype=torch.float64) / rate
    swing = torch.stack([torch.sin(omega * t), torch.cos(omega * t)], dim=1)
    spoilt = swing.clone()
    spoilt[600] = 1e6
    one = replace(one, rate=rate, states=swing, inputs=spoilt, valid=torch.arange(1200) != 600)
    (some,) = shortened([one], 10_000, stride)
    stack, at = LogBatch.of([some]), t[::stride]
    ends = torch.stack([-torch.cos(omega * at), torch.sin(omega * at)], dim=1) / omega
    truth, phase = ends.diff(dim=0) / some.dt, omega * some.dt
    assert (stack.between[0] - truth).abs().max() < 1.1 * (omega / rate) ** 2 / 12 < 0.13 * phase**2 / 12
    drive = (stack.inputs[0, 1:] + stack.inputs[0, :-1]) / 2
    clear = (torch.arange(len(truth)) * stride - 600).abs() > 3 * stride + 3
    assert (drive - truth)[clear][3:-3].abs().max() < 0.15 * phase**2 / 12 + phase**4 / 10
    assert drive.abs().max() < 1.1  # what is not valid reaches no sample about it
