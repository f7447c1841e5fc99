"""What simpler methods regress where an accelerometer was logged."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rotorpy")

from bench.diagnose.logs.subject import LogBatch, Subject
from bench.diagnose.regression.linearise import Linearization, directions
from bench.score.alternatives import WINDOW, accelerations, attempt_all, changes
from bench.score.chain.case import ChainCase, measured

DRAG = ChainCase(
    id="drag",
    vehicle="racer",
    effects={"rotor_drag": {"k_d": 8e-5}},
    noise="low",
    rough=False,
    log_hz=100,
    clock="even",
    accelerometer=True,
    recordings=3,
    seconds=4.0,
)


@pytest.fixture(scope="module")
def flown(cache: Path) -> tuple[Subject, Linearization]:
    who = measured(DRAG, cache)
    stack = LogBatch.of(who.of(who.training))
    return who, directions(who.model, who.model, who.uncertainty, stack)


@pytest.mark.parametrize("axis", [0, 1])
def test_an_accelerometer_sideways_shows_what_a_model_of_thrust_alone_leaves(
    flown: tuple[Subject, Linearization], axis: int
) -> None:
    who, linear = flown
    sensed = linear.channels.index(len(who.model.state_channels) + axis)
    length = round(WINDOW * 100)
    for pointwise, windows, log in zip(accelerations(linear), changes(linear), linear.stack.logs, strict=True):
        felt = log.recording.pick(["specific_force"])[0][:, axis]
        means = (felt[1:] + felt[:-1]) / 2
        whole = means[: len(means) // length * length].reshape(-1, length).sum(1) / 100
        np.testing.assert_allclose(windows[-1, :, sensed], whole - whole.mean(), atol=1e-9)
        assert np.corrcoef(pointwise[-1, :, sensed], means)[0, 1] > 0.9  # a smoothing filter lies between


def test_simpler_methods_answer_where_an_accelerometer_was_logged(cache: Path) -> None:
    answers = attempt_all(DRAG, cache)
    assert set(answers) == {"pysindy", "bic", "weak_form"}
    assert "rotor_drag" in answers["weak_form"].named
