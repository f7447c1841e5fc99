"""A model linearised on measured states, and what taking one of its effects away does."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from bench.diagnose.learn.curve import nearest
from bench.diagnose.logs.subject import Log, LogBatch
from bench.diagnose.regression.columns import Columns, response
from bench.diagnose.regression.linearise import directions
from bench.diagnose.regression.parameters import entries, probes, with_values
from bench.diagnose.regression.weak import mean_rates, midpoint_rates
from registry.core import EFFECTS
from registry.effects.learned_term import LearnedTerm
from registry.physics.quadrotor import Quadrotor


def wandering(samples: int = 200) -> LogBatch:
    """A flight that drifts and turns at random."""
    rng = np.random.default_rng(0)
    wander = np.cumsum(rng.normal(0, 0.02, (samples, 9)), axis=0)
    turned = Rotation.from_rotvec(wander[:, :3]).as_quat()
    states = np.column_stack([wander[:, :3], wander[:, 3:6], turned, wander[:, 6:]])
    inputs = np.full((samples, 4), 496.0) + rng.normal(0, 5, (samples, 4))
    x, u, valid = torch.from_numpy(states), torch.from_numpy(inputs), torch.ones(samples, dtype=torch.bool)
    return LogBatch.of([Log("flight", 100.0, x, (True,) * 13, u, valid, None)])  # type: ignore[arg-type]


def test_a_drag_and_a_wind_are_linear_together() -> None:
    """In the drag and its product with the wind; alone, a wind does nothing and a drag pulls the other way."""
    drag, wind, model, stack = EFFECTS.get("rotor_drag"), EFFECTS.get("wind"), Quadrotor(), wandering()
    linear = directions(model, model, {}, stack, [("rotor_drag", drag)], pairs=[("wind", wind)])
    alone, both = linear.starts
    assert (alone.ids, both.ids) == (("rotor_drag",), ("rotor_drag", "wind"))
    k_d, w_x, w_y = 1e-4, 9.0, -4.0
    size = both.size([k_d, 0.0, 0.0])
    beta = [k_d, size * w_x, size * w_y]
    hidden = drag(k_d=k_d), wind(w_x=w_x, w_y=w_y)
    expected = midpoint_rates(replace(model, effects=hidden), stack) - midpoint_rates(model, stack)
    added = sum(b * linear.columns[c] for b, c in zip(beta, both.columns, strict=True))
    assert added == pytest.approx(expected.numpy()[..., list(linear.channels)], abs=1e-9)
    found = both.effects_at(beta)
    assert [p.value for e in found for p in e.parameters()] == pytest.approx([k_d, w_x, w_y])
    assert both.effects_at([0.0, 1.0, 1.0])[1] == wind.neutral()  # without a drag nothing is known of the wind


def test_without_the_wind_a_drag_acts_on_the_velocity_over_ground() -> None:
    drag, wind = EFFECTS.get("linear_drag")(d_x=0.3, d_y=0.3, d_z=0.3), EFFECTS.get("wind")(w_x=9.0)
    model, stack = Quadrotor(effects=(drag, wind)), wandering()
    linear = directions(model, model, {}, stack)
    still = replace(model, effects=(drag,))
    expected = directions(still, still, {}, stack)
    for place, e in enumerate(linear.own):
        if e.owner == 0:
            mine = linear.columns[linear.changed([place], [1])[0]]
            (its,) = (i for i, o in enumerate(expected.own) if (o.owner, o.name) == (0, e.name))
            assert mine == pytest.approx(expected.columns[its], abs=1e-9)


def test_what_needs_an_effect_goes_with_it() -> None:
    drag, wind = EFFECTS.get("rotor_drag")(k_d=1e-4), EFFECTS.get("wind")(w_x=2.0, w_y=-1.0)
    model, stack = Quadrotor(effects=(drag, wind)), wandering()
    linear = directions(model, model, {}, stack)
    assert linear.removed([1]) == ({1}, [linear.removals[1]])
    assert linear.removed([0]) == linear.removed([0, 1]) == ({0, 1}, [linear.removals[0]])
    for place, left in ((0, ()), (1, (drag,))):
        expected = midpoint_rates(replace(model, effects=left), stack) - midpoint_rates(model, stack)
        removed = linear.columns[linear.removals[place]]
        assert removed == pytest.approx(expected.numpy()[..., list(linear.channels)], abs=1e-12)
    both = Quadrotor(effects=(drag, wind, EFFECTS.get("linear_drag").typical()))
    two = directions(both, both, {}, stack)
    assert two.removed([0])[0] == {0} and two.removed([0, 2])[0] == {0, 1, 2}  # each of the drags carries the wind
    ((place, w_x),) = ((i, e) for i, e in enumerate(two.own) if e.name == "w_x")
    less = replace(both, effects=both.effects[1:])
    (its,) = (i for i, e in enumerate(directions(less, less, {}, stack).own) if e.name == w_x.name)
    carried = directions(less, less, {}, stack).columns[its]
    assert two.columns[two.changed([place], [0])[0]] == pytest.approx(carried, abs=1e-9)


def test_a_drag_with_a_wind_is_no_likeness_of_a_force_along_the_motion() -> None:
    """What goes with the wind is free, and would let the drag push."""
    pushed = Quadrotor(effects=(LearnedTerm("world_force_x", ("velocity.x",), "affine", (0.3, 3.0)),))
    kinds = [(name, EFFECTS.get(name)) for name in ("linear_drag", "rotor_drag")]
    linear = directions(pushed, pushed, {}, wandering(400), kinds, pairs=[("wind", EFFECTS.get("wind"))])
    assert len(linear.starts) == 4 and nearest(linear, 0) is None


def test_every_effect_is_tried_on_six_rotors() -> None:
    """Of each rotor's own thrust there is a column, and nothing of the search wants four."""
    rng, samples = np.random.default_rng(0), 60
    angles = np.pi / 6 + np.arange(6) * np.pi / 3
    places = tuple((float(0.3 * np.cos(a)), float(0.3 * np.sin(a)), 0.0) for a in angles)
    model = Quadrotor(rotor_positions=places, rotor_directions=(1.0, -1.0) * 3, extras=("battery", "time"))
    wander = np.cumsum(rng.normal(0, 0.02, (samples, 9)), axis=0)
    turned = Rotation.from_rotvec(wander[:, :3]).as_quat()
    states = torch.from_numpy(np.column_stack([wander[:, :3] + 2, wander[:, 3:6], turned, wander[:, 6:]]))
    inputs = torch.from_numpy(np.column_stack([rng.normal(400, 20, (samples, 6)), np.full((samples, 2), 3.7)]))
    stack = LogBatch.of(
        [Log("flight", 100.0, states, (True,) * 13, inputs, torch.ones(samples, dtype=torch.bool), None)]
    )  # type: ignore[arg-type]
    kinds = [
        (n, k)
        for n, k in ((n, EFFECTS.get(n)) for n in EFFECTS.names())
        if k.suits(Quadrotor) and not k.learned and not k.requires
    ]
    linear = directions(model, model, {}, stack, kinds)
    (start,) = [s for s in linear.starts if s.id == "unequal_rotors"]
    assert [e.name for e in start.entries] == [f"eps_{i}" for i in range(1, 7)]
    assert {s.id for s in linear.starts} >= {"rotor_drag", "cog_offset", "battery_sag", "ground_effect"}


def test_a_column_keeps_only_the_channels_that_it_moves():
    rng = np.random.default_rng(0)
    some, more = rng.normal(size=(2, 2, 5, 4)) * np.array([[0.0, 1, 0, 1], [0, 0, 1, 0]])[:, None, None]
    columns = Columns((response(some, 0 * some, (1, 2, 3)),), (1, 2, 3), (2, 5)).with_more([more[..., 1:]])
    assert [set(r) for r in columns.responses] == [{1, 3}, {2}]
    assert [columns.acting(i).tolist() for i in range(3)] == [[0], [1], [0]]
    np.testing.assert_array_equal(np.asarray(columns), np.stack([some, more])[..., 1:])
    np.testing.assert_array_equal(columns.on(2, 1, [0])[:, 0], some[1, :, 3])
    swapped = columns.replaced({0: columns.responses[1]})
    np.testing.assert_array_equal(swapped[0], more[..., 1:])
    assert len(columns.forgotten()) == 2 and not np.asarray(columns.forgotten()).any()


def test_models_that_share_what_is_alike_have_the_rates_of_each_alone():
    """Rates of many models at once, of which some parameters differ, against one model after another."""
    rng, samples = np.random.default_rng(1), 60
    states = np.column_stack(
        [rng.normal(0, 0.3, (samples, 6)), Rotation.random(samples, rng).as_quat(), rng.normal(0, 1, (samples, 3))]
    )
    inputs = np.abs(np.full((samples, 4), 496.0) + rng.normal(0, 30, (samples, 4)))
    x, u, valid = torch.from_numpy(states), torch.from_numpy(inputs), torch.ones(samples, dtype=torch.bool)
    stack = LogBatch.of([Log("flight", 100.0, x, (True,) * 13, u, valid, None)])  # type: ignore[arg-type]
    pairs = ("motor_lag", "rotor_reaction_torque"), ("unequal_rotors", "ground_effect"), ("suspended_load", "mass")
    for names in (("motor_lag", "rotor_drag"), *pairs):
        model = Quadrotor(effects=tuple(EFFECTS.get(n).typical() for n in names))
        where = entries(model, {})
        values, _ = probes(where)
        for rates in (mean_rates, midpoint_rates):
            together = rates(with_values(model, where, values), stack)
            for row, found in zip(values.numpy(), together, strict=True):
                alone = rates(with_values(model, where, row), stack)
                torch.testing.assert_close(found, alone, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("volts", "reference"), [(3.8, 3.7), (7.5, 7.4), (15.9, 14.8), (16.6, 14.8), (22.4, 22.2)])
def test_a_sagging_battery_is_sought_about_the_voltage_of_its_cells(volts: float, reference: float) -> None:
    """About that of one cell, a slope of 0.06 1/V of a pack of four takes its thrust coefficient to a quarter."""
    rng, samples = np.random.default_rng(2), 60
    states = np.column_stack(
        [rng.normal(0, 0.3, (samples, 6)), np.tile([0, 0, 0, 1.0], (samples, 1)), np.zeros((samples, 3))]
    )
    rotors, battery = np.full((samples, 4), 496.0), volts + 0.1 * rng.normal(size=samples)
    inputs = np.column_stack([rotors, battery, np.arange(samples) / 100])
    x, u, valid = torch.from_numpy(states), torch.from_numpy(inputs), torch.ones(samples, dtype=torch.bool)
    stack = LogBatch.of([Log("flight", 100.0, x, (True,) * 13, u, valid, None)])  # type: ignore[arg-type]
    model = Quadrotor(extras=("battery", "time"))
    linear = directions(model, model, {}, stack, [("battery_sag", EFFECTS.get("battery_sag"))])
    (start,) = linear.starts
    assert start.effect.parameters()[2].value == pytest.approx(reference)
    lift = linear.columns[start.columns[0]][0, :, list(linear.channels).index(5)]
    expected = (battery[:-1] + battery[1:]) / 2 - reference
    np.testing.assert_allclose(lift, 4 * model.thrust_coefficient * 496.0**2 / model.mass * expected, rtol=1e-6)
