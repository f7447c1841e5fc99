"""What is said of effects one after another: models on the way to the last one."""

import sys
from dataclasses import replace

import pytest
from hardening import CUBIC, carts

from bench.diagnose.extend import extend
from bench.diagnose.logs.load import load
from bench.diagnose.logs.subject import Subject
from registry.effects.mechanics.friction import OffsetForce
from registry.effects.mechanics.stiffness import CubicStiffness

module = sys.modules["bench.diagnose.extend"]  # its name in the package is the function


@pytest.fixture(scope="module")
def hardening(tmp_path_factory: pytest.TempPathFactory) -> Subject:
    """Six carts of which the spring hardens."""
    folder = carts(tmp_path_factory.mktemp("stages") / "carts", dict.fromkeys("abcdef", 2.0), 8.0)
    return load(folder)


def test_a_model_on_the_way_that_free_runs_do_not_bear_is_the_last_one_cut_short(
    hardening: Subject, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitted = module.fit_parameters

    def worse(subject, model, *rest, **how):
        """As the weak form may be: the first effect alone with a number that makes free runs worse than without."""
        found, numbers = fitted(subject, model, *rest, **how)
        if len(model.effects) == 1:
            found = replace(found, effects=(replace(found.effects[0], k_3=-3 * CUBIC),))
        return found, numbers

    monkeypatch.setattr(module, "fit_parameters", worse)
    told = extend(hardening, hardening.model, [CubicStiffness(k_3=300.0), OffsetForce(f_0=0.01)])
    cubic, offset = told.effects
    assert cubic.share_explained > 0.1  # the rest a stiffer spring explains, which the calibration knows
    assert abs(offset.share_explained) < 0.01


def test_models_on_the_way_stay_where_each_effect_helps(hardening: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_better_on_the_way", lambda *rest: pytest.fail("there was nothing to better"))
    told = extend(hardening, hardening.model, [CubicStiffness(k_3=300.0), OffsetForce(f_0=0.01)])
    assert told.effects[0].share_explained > 0.1
