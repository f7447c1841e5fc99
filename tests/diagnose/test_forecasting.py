"""Effects that only free runs ask for: fitted by shooting, confirmed by halves of the recordings, no finding."""

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
from samples import DRAG, REACTION, named
from test_compare import DT, subject_of

from bench.diagnose.confirm import Setup, with_forecasting
from bench.diagnose.extend import extend
from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.subject import Subject
from bench.diagnose.report import sentences
from bench.diagnose.result import schema
from bench.diagnose.select.simulated.forecasting import forecasting
from bench.diagnose.simulate.multiple_shooting import multiple_shooting, relative_error
from registry.core import EFFECTS
from registry.physics.oscillator import Oscillator

STATED = Oscillator(mass=1.0, damping=0.1, stiffness=4.0)
HARDENING = 6.0
"""[N/m³]"""


def swung(hardening: float, pushed: np.ndarray, offset: float, samples: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """States (R, N, 2) and forces (R, N, 1) of masses on springs that harden [N/m³], pushed by so much [N].

    A constant ``offset`` [N] pushes them besides.

    Noise of .1 mm and 1 mm/s.
    """
    rng, fine = np.random.default_rng(0), 10
    count, h = len(pushed), DT / fine
    force = pushed[:, None] * np.repeat(rng.normal(size=(count, samples // 20)), 20, axis=1)
    states, x, v = np.zeros((count, samples, 2)), np.zeros(count), np.zeros(count)
    for k in range(samples * fine):
        if k % fine == 0:
            states[:, k // fine] = np.column_stack([x, v])
        v = v + h * (offset + force[:, k // fine] - 0.1 * v - 4.0 * x - hardening * x**3)
        x = x + h * v
    return states + rng.normal(size=states.shape) * [1e-4, 1e-3], force[..., None]


def of(hardening: float, pushed: tuple[float, ...] = (4.0,) * 6, offset: float = 0.0) -> Subject:
    """Springs of which the first four are learnt from."""
    known, seen = {"mass": 0.02, "damping": 0.02, "stiffness": 0.02}, ("displacement", "speed", "force")
    model = replace(STATED, input_hold="previous")
    whole = subject_of(model, *swung(hardening, np.array(pushed), offset), uncertainty=known, signals=seen)
    return replace(whole, training=whole.training[:4], held_out=whole.training[4:])


def test_free_runs_ask_for_what_moves_them_and_say_how_much() -> None:
    subject = of(HARDENING)
    grown, numbers = forecasting(subject, subject.model)
    assert [EFFECTS.name_of(type(e)) for e in grown.effects] == ["cubic_stiffness"]
    (spring,) = (x for x in numbers if not x.entry.constant)
    assert spring.low < spring.value < spring.high and spring.value == pytest.approx(HARDENING, rel=0.03)
    assert relative_error(subject.model, grown, subject, subject.held_out) < 0.05


def test_what_one_half_of_the_recordings_does_not_confirm_is_not_added() -> None:
    subject = of(HARDENING, (4.0, 0.02, 4.0, 0.02, 4.0, 4.0))
    assert forecasting(subject, subject.model) == (subject.model, ())
    # Though all of them together gain by it.
    spring = EFFECTS.get("cubic_stiffness").neutral_for(subject.model, {})
    both = [
        multiple_shooting(replace(subject.model, effects=effects), subject, subject.training).model
        for effects in ((), (spring,))
    ]
    assert relative_error(*both, subject, subject.training) < 0.9


def test_what_makes_forecasts_of_held_out_recordings_worse_is_not_added() -> None:
    """The recordings to learn from have a spring that hardens, those held out one that does not."""
    hard, plain = of(HARDENING, offset=0.5), of(0.0, offset=0.5)
    subject = replace(hard, logs=(*hard.of(hard.training), *plain.of(plain.held_out)))
    run = Setup(subject, noise_of(subject), lambda what: None, None, subject)
    before = extend(subject, subject.model, "offset_force")
    asked, _ = forecasting(subject, before.model)
    assert [EFFECTS.name_of(type(e)) for e in asked.effects] == ["offset_force", "cubic_stiffness"]
    assert with_forecasting(run, before) is before


def test_an_effect_that_was_found_is_fitted_again_beside_what_only_forecasts_ask_for() -> None:
    subject = of(HARDENING, offset=0.5)
    run = Setup(subject, noise_of(subject), lambda what: None, None, subject)
    before = extend(subject, subject.model, "offset_force")
    after = with_forecasting(run, before)
    assert [(e.id, e.forecast_only) for e in after.effects] == [("offset_force", False), ("cubic_stiffness", True)]
    ((was,), (now,)) = (x.effects[0].parameters.values() for x in (before, after))
    assert now.low <= was.value <= now.high and now.low <= 0.5 <= now.high
    assert abs(now.value - 0.5) < 0.05 < abs(was.value - 0.5)
    assert [s.name for s in after.stages] == ["nominal", "calibrated", "offset_force", "cubic_stiffness", "floor"]
    assert after.stages[:3] == before.stages[:3]
    assert after.stages[3].error["speed"] < 0.01 * after.stages[2].error["speed"]
    assert after.effects[1].share_explained > 0.9
    assert with_forecasting(replace(run, catalogue=["offset_force"]), before) is before


def test_nothing_is_added_where_free_runs_miss_nothing() -> None:
    subject = of(0.0)
    assert forecasting(subject, subject.model) == (subject.model, ())


def test_nothing_is_added_without_recordings_that_confirm_it() -> None:
    subject = of(HARDENING)
    alone = replace(subject, training=subject.training[:1])
    assert forecasting(alone, alone.model) == (alone.model, ())


@pytest.mark.parametrize("verdict", ["named", "nothing", "unknown_effect"])
def test_what_only_forecasts_ask_for_is_told_as_no_finding(verdict: str) -> None:
    extra = replace(DRAG, forecast_only=True)
    found = replace(named(), verdict=verdict, effects=(*[REACTION] * (verdict == "named"), extra))
    jsonschema.validate(json.loads(json.dumps(found.to_json())), schema())
    assert "drag" not in sentences.headline(found)
    said = sentences.explanation(found)
    assert "Forecasts ask for rotor drag, which no equation by itself confirms" in said and "no finding" in said
    assert sentences.explains(extra) == "for forecasts only"


def test_a_named_effect_must_have_been_found() -> None:
    found = replace(named(), verdict="named", effects=(replace(DRAG, forecast_only=True),))
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(json.loads(json.dumps(found.to_json())), schema())
