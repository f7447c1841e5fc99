"""Affine recurrences against a loop, and a load that swings before anybody records it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.subject import LogBatch, Subject, log_of
from bench.diagnose.regression import weak
from bench.diagnose.regression.recurrence import solved
from bench.diagnose.simulate.roll import roll
from bench.diagnose.simulate.teacher_forced import increments
from registry.contracts import Channel, Recording
from registry.effects.suspended_load import SuspendedLoad
from registry.physics.quadrotor import Quadrotor

STEPS, SIZE, DT = 53, 3, 0.01


@pytest.mark.parametrize("alike", [True, False])
def test_an_affine_recurrence_takes_the_path_of_a_loop_from_wherever_it_begins(alike):
    rng = np.random.default_rng(1)
    matrices = np.eye(SIZE) + 0.1 * rng.normal(size=(2, STEPS, SIZE, SIZE))
    matrices = np.broadcast_to(matrices[:1, :1], matrices.shape) if alike else matrices
    offsets, begin = rng.normal(size=(2, STEPS, SIZE)), rng.normal(size=(2, SIZE))
    a, b = torch.from_numpy(matrices.copy()), torch.from_numpy(offsets)

    def step(x):
        return (a @ x.unsqueeze(-1)).squeeze(-1) + b

    def first(x):
        return (a[:1, :1] @ x.unsqueeze(-1)).squeeze(-1) + b[:1, :1]

    found = solved(step, first, (2, STEPS), SIZE, b)
    assert found is not None
    for started in (np.zeros_like(begin), begin):
        path = [started]
        for k in range(STEPS):
            path.append(np.einsum("lij,lj->li", matrices[:, k], path[-1]) + offsets[:, k])
        expected = torch.from_numpy(np.stack(path, axis=1))
        torch.testing.assert_close(found.path(torch.from_numpy(started)), expected, rtol=1e-11, atol=1e-11)
        turned = found.turned() @ torch.from_numpy(started)[:, None, :, None]
        torch.testing.assert_close(found.path() + turned.squeeze(-1), expected, rtol=1e-11, atol=1e-11)


def test_what_bends_is_never_solved_at_once():
    bends = [lambda x: x + 0.01 * (1 - x * x)] * 2
    assert solved(*bends, (3, 50), 1, torch.zeros(1).double()) is None


def swung(begin: tuple[float, float], samples: int = 1001) -> tuple[Quadrotor, LogBatch, torch.Tensor]:
    """A vehicle that tilts to and fro over a load, whose angles [rad] at the first sample are given.

    Returns:
        The model, measurements of the vehicle alone and the load's own states (N, 4).
    """
    t = DT * torch.arange(samples, dtype=torch.float64)
    model = Quadrotor(effects=(SuspendedLoad(m_l=0.1, l=0.5, zeta=0.03),))
    hover = (model.mass * model.gravity / (4 * model.thrust_coefficient)) ** 0.5
    to_and_fro = torch.sin(5 * t)[:, None] * torch.tensor([1.0, 1.0, -1.0, -1.0]).double()
    speeds, start = hover * (1 + 0.004 * to_and_fro), torch.zeros(1, 17).double()
    start[0, 9], start[0, 13], start[0, 14] = 1.0, *begin
    flown = roll(model, start, speeds[None], DT)[0]
    axes = {"attitude": ("qx", "qy", "qz", "qw"), "body_rates": ("p", "q", "r")}
    groups = ("position", "velocity", "attitude", "body_rates")
    channels = tuple(Channel(f"{g}.{a}", "1") for g in groups for a in axes.get(g, ("x", "y", "z")))
    driven, valid = tuple(Channel(f"rotor_speed.{i}", "rad/s") for i in range(1, 5)), np.ones(samples, dtype=bool)
    seen = Recording("run", 1 / DT, speeds.numpy(), flown[:, :13].numpy(), driven, channels, valid)
    return model, LogBatch.of([log_of(seen, model, "rotor_speed")]), flown[:, 13:]


def test_where_a_load_begins_is_told_by_what_was_measured_until_then():
    model, stack, load = swung((0.3, -0.2))
    told = weak.own_states(model, stack)[0]
    size = load.abs().amax(0)
    assert (told[:7, :2].abs() < 0.1 * load[:7, :2].abs()).all()  # nothing tells it yet
    assert ((told - load).abs() / size)[100:].max() < 0.01
    shorter = replace(stack.logs[0], **{k: getattr(stack.logs[0], k)[:200] for k in ("states", "inputs", "valid")})
    begun = weak.own_states(model, LogBatch.of([shorter]))[0]
    torch.testing.assert_close(begun[100:], load[100:200], rtol=0.0, atol=0.02 * float(size.max()))


def test_a_recording_that_is_known_whole_tells_where_its_load_began():
    model, stack, _ = swung((0.3, -0.2))
    moved, dt = torch.from_numpy(stack.paths).diff(dim=1), stack.dt
    rest = replace(model, effects=())
    errors = {
        name: ((moved / dt - rates)[0, :, 3:6] ** 2).mean() ** 0.5
        for name, rates in {
            "whole": weak.mean_rates(model, stack),
            "so far": weak.mean_rates(model, stack, so_far=True),
            "without": weak.mean_rates(rest, stack),
        }.items()
    }
    assert errors["whole"] < 0.1 * errors["so far"] < 0.01 * errors["without"]


def test_a_load_that_hangs_still_begins_at_rest():
    model, stack, load = swung((0.0, 0.0))
    told = weak.own_states(model, stack)[0]
    torch.testing.assert_close(told, load, rtol=0.0, atol=0.01 * float(load.abs().max()))


def test_what_is_left_of_a_recording_is_told_by_what_came_before():
    """Nobody knows yet in the first block how a load swings; once it is over the equations leave next to nothing."""
    model, stack, _ = swung((0.3, -0.2))
    subject = Subject("swung", model, stack.logs, ("run",), ())
    left = np.abs(increments(model, stack, noise_of(subject)).steps[0, :, 3:6]).max(-1)
    assert left[:7].max() > 100 * left[50:].max()


def test_a_beginning_is_no_larger_than_what_moves_a_load_makes_its_swing():
    """In noise, too, and where little was recorded: free, it would fit the noise."""
    model, stack, _ = swung((0.0, 0.0), samples=36)
    noisy = stack.states + 0.01 * torch.randn(stack.states.shape, generator=torch.Generator().manual_seed(4)).double()
    stack = replace(stack, states=noisy, logs=(replace(stack.logs[0], states=noisy[0]),))
    assert weak.own_states(model, stack)[0, :, :2].abs().max() < 0.02  # rad
