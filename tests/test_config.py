from dataclasses import replace
from pathlib import Path

import pytest
from conftest import Toy

from bench.execution.engine import plan
from bench.experiment.config import RunConfig, Training, changed, from_json, to_json
from bench.experiment.notation import parse
from bench.experiment.run_key import run_key, shape_key
from registry.contracts import Split
from registry.core import DATASETS
from registry.errors import BenchError

SPLIT = Split(("a",), ("b",), ("c",))
BASE = RunConfig(*parse("LSTM: 1x5 - MLP: 6x10"), Toy())


def test_json_round_trip_keeps_everything_and_the_key() -> None:
    config = changed(BASE, {"predictor.dropout": "0.1", "horizon": "7", "test": "toy_1,toy_2", "seed": "3"})
    again = from_json(to_json(config))
    assert again == config
    assert run_key(again, "d", SPLIT) == run_key(config, "d", SPLIT)


@pytest.mark.parametrize(
    "other",
    [
        replace(BASE, seed=1),
        replace(BASE, horizon=41),
        replace(BASE, outputs=("euler_rates.roll",)),
        replace(BASE, training=Training(updates=7)),
        replace(BASE, predictor=parse("LSTM: 1x6 - MLP: 6x10")[0]),
        replace(BASE, initializer=parse("LSTM: 1x5 - Washout: 10")[1]),
        replace(BASE, dataset=Toy(samples=300)),
    ],
)
def test_every_input_changes_the_key(other: RunConfig) -> None:
    assert run_key(other, "d", SPLIT) != run_key(BASE, "d", SPLIT)


def test_data_change_the_key_and_spelled_out_defaults_do_not() -> None:
    assert run_key(BASE, "d", SPLIT) != run_key(BASE, "e", SPLIT)
    assert run_key(BASE, "d", SPLIT) != run_key(BASE, "d", Split(("a",), ("c",), ("b",)))
    assert run_key(replace(BASE, outputs=("euler_rates",)), "d", SPLIT) == run_key(BASE, "d", SPLIT)


def test_seed_channel_and_learning_rate_share_a_shape_and_size_does_not() -> None:
    miso = replace(BASE, outputs=("euler_rates.roll",))
    assert shape_key(miso) == shape_key(replace(miso, outputs=("euler_rates.yaw",), seed=2))
    assert shape_key(miso) == shape_key(changed(miso, {"training.learning_rate": "0.1"}))
    assert shape_key(miso) != shape_key(changed(miso, {"training.final_rate": "0.1"}))
    assert shape_key(miso) != shape_key(replace(miso, predictor=parse("LSTM: 2x5 - MLP: 6x10")[0]))


@pytest.mark.parametrize(
    ("assignment", "says"),
    [
        ({"predictor.dropuot": "0.1"}, "did you mean predictor.dropout"),
        ({"horizon": "forty"}, "must be an integer"),
        ({"horizon": "0"}, "from 1 to"),
        ({"predictor.dropout": "1.5"}, "from 0.0 to 0.9"),
        ({"predictor.name": "Elman"}, "no predictor"),
    ],
)
def test_a_wrong_option_says_so(assignment: dict[str, str], says: str) -> None:
    with pytest.raises(BenchError, match=says):
        changed(BASE, assignment)


def test_a_signal_that_a_twin_cannot_have_is_told_before_it_flies(monkeypatch: pytest.MonkeyPatch) -> None:
    twin = DATASETS.get("pelican_twin")()
    monkeypatch.setattr(type(twin), "read", lambda self: pytest.fail("it was simulated"))
    config = RunConfig(*parse("LSTM: 1x8 - MLP: 9x10"), twin, outputs=("body_rate",))
    with pytest.raises(BenchError, match=r"pelican_twin has no signal 'body_rate': did you mean body_rates"):
        plan([config], Path("runs"))
