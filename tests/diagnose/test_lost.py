"""Free runs that lose the attitude may not take back what the weak form is sure of."""

from dataclasses import replace

import numpy as np
import pytest

from bench.diagnose.fit import lost
from bench.diagnose.regression.parameters import Entry
from bench.diagnose.select.verify import Estimate
from bench.diagnose.simulate.multiple_shooting import Shot

DRAG = Entry(0, "drag", None, "kg/s", 0.2, 0.1, 0.0, 10.0, neutral=0.0)
MASS = Entry(-1, "mass", None, "kg", 1.0, 0.03, 0.9, 1.1, stated=1.0)


@pytest.mark.parametrize(
    ("entry", "interval", "after", "gone"),
    [
        (DRAG, (0.18, 0.22), 0.0, True),
        (DRAG, (0.18, 0.22), 0.03, False),  # less of it is no contradiction
        (DRAG, (0.00, 0.22), 0.0, False),  # the weak form was not sure
        (MASS, (0.99, 1.01), 0.0, False),  # a constant has no value that makes it nothing
    ],
)
def test_shooting_loses_a_sure_number_where_it_leaves_no_effect(
    entry: Entry, interval: tuple[float, float], after: float, gone: bool
) -> None:
    sure = Estimate(entry, entry.value, *interval)
    shot = Shot(None, 1.0, 0.5, (replace(entry, value=after),), np.eye(1))  # type: ignore[arg-type]
    assert lost([sure], shot) is gone
    untouched = Shot(None, 1.0, 0.5, (), np.zeros((0, 0)))  # type: ignore[arg-type]
    assert not lost([sure], untouched)


@pytest.mark.parametrize(
    ("entry", "value", "half", "interval"),
    [
        (MASS, 1.09, 0.05, (1.04, 1.14)),  # calibration stops at 1.1, what is known of the mass does not
        (MASS, 1.0, 2.0, (0.0, 3.0)),
        (replace(MASS, low=-1.0), 0.0, 2.0, (-2.0, 2.0)),
        (DRAG, 0.1, 0.2, (0.0, 0.3)),  # less than no drag there is not
    ],
)
def test_an_interval_ends_where_a_number_cannot_be_and_not_where_calibration_stops(
    entry: Entry, value: float, half: float, interval: tuple[float, float]
) -> None:
    assert entry.interval(value, half) == pytest.approx(interval)
