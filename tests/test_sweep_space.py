"""What a sweep varies."""

import re

import pytest
from synthetic_sweep import toy

from bench.sweep.space import default_params, default_space, parse_search
from registry.errors import BenchError


def test_the_space_comes_from_the_entries_and_holds_the_default() -> None:
    config = toy("LSTM: 3x300 - Washout: 4")
    space = default_space([config], fixed=["training.learning_rate"])
    assert list(space) == ["predictor.layers", "predictor.hidden", "initializer.history"]
    assert (space["predictor.hidden"].high, space["initializer.history"].low) == (300, 4)  # type: ignore[attr-defined]
    assert default_params(space, [config]) == dict(zip(space, (3, 300, 4), strict=True))
    two = [toy(), toy("LSTM: 1x8 - Washout: 10")]
    assert list(default_space(two)) == ["spec", "training.learning_rate"]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("predictor.hiden=1:9", "did you mean predictor.hidden"),
        ("horizon=5:9", "would change what is measured"),
        ("training.evaluate_every=5:9", "would change what is measured"),
        ("predictor.hidden=9:1", "smaller value first"),
        ("predictor.hidden=0:9", "must be from 1 to 2000"),
        ("predictor.dropout=0:0.5:log", "above 0"),
        ("predictor.hidden=1:9:lin", "not understood"),
        ("predictor.hidden", "not understood"),
        ("training.batch=32,many", "must be an integer"),
    ],
)
def test_a_wrong_range_is_one_sentence(text: str, sentence: str) -> None:
    with pytest.raises(BenchError, match=re.escape(sentence)):
        parse_search(text, [toy()])
