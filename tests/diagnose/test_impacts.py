"""A crash ends a flight; missing samples, spikes and violent flying do not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_problems import DT, Columns, flights, made

from bench.diagnose.checks.problems import problems
from bench.diagnose.logs.impacts import before_impacts, impact

AT = 700
"""The last sample before the fault."""


def crashed(log: Columns) -> Columns:
    """The flight until it hits a wall, from which it bounces, tumbling: its pose goes on from where it was."""
    t = DT * np.arange(len(log["t"]) - AT - 1)[:, None]
    out = {name: values.copy() for name, values in log.items()}
    fades = np.exp(-t / 0.3)
    velocity = (-0.4 * log["velocity"][AT] + [1.5, -1.0, 0.5]) * fades
    rates = 30 * fades * np.sin(25 * t + [0.5, 1.6, 2.8])
    out["velocity"][AT + 1 :], out["body_rates"][AT + 1 :] = velocity, rates
    out["position"][AT + 1 :] = log["position"][AT] + np.cumsum(velocity * DT, axis=0)
    turned = Rotation.from_quat(log["attitude"][AT])
    for k, rate in enumerate(rates, start=AT + 1):
        turned = turned * Rotation.from_rotvec(rate * DT)
        out["attitude"][k] = turned.as_quat()
    return out


def without(log: Columns, samples: int) -> Columns:
    """So many samples are missing, and nobody says so."""
    out = {name: np.delete(values, np.arange(AT + 1, AT + 1 + samples), axis=0) for name, values in log.items()}
    return {**out, "t": log["t"][: len(out["t"])]}


def without_few(log: Columns) -> Columns:
    """Eight samples are missing."""
    return without(log, 8)


def without_the_crash(log: Columns) -> Columns:
    """Nothing is filed of the first third of a second of a crash: rates jump as in one, but the pose with them."""
    return without(crashed(log), 33)


def spoilt(log: Columns) -> Columns:
    """The velocity is far off for a moment."""
    out = {name: values.copy() for name, values in log.items()}
    out["velocity"][AT + 1 : AT + 3] += 3.0
    return out


def test_a_recording_ends_where_the_vehicle_hits_something() -> None:
    logs = flights(3)
    logs[1] = crashed(logs[1])
    subject = before_impacts(made(logs))
    assert impact(subject.model, made(logs).logs[1]) in (AT - 1, AT)
    valid = subject.logs[1].valid
    assert valid[: AT - 10].any() and not valid[AT - 1 :].any()
    for said in (subject.notes, subject.resampled):
        assert [n.split(":")[0] for n in said if "hits something" in n] == ["flight_2"]
    assert not problems(subject).problems


@pytest.mark.parametrize("fault", [without_few, without_the_crash, spoilt, dict])
@pytest.mark.parametrize("vigour", [0.3, 1.0, 1.6])
def test_nothing_else_is_an_impact(fault: object, vigour: float) -> None:
    logs = flights(4, count=3, vigour=vigour)
    logs[1] = fault(logs[1])  # type: ignore[operator]
    subject = made(logs)
    assert before_impacts(subject) is subject
