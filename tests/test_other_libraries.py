"""The peers' libraries on a made-up system: each is trained for a second and judged as the suite's own models are."""

import numpy as np
import other_libraries
import pytest
from conftest import Toy

from bench.experiment.config import RunConfig
from bench.experiment.notation import parse


@pytest.mark.parametrize("name", list(other_libraries.LIBRARIES))
def test_a_library_is_trained_its_own_way(name: str) -> None:
    module, trained = other_libraries.LIBRARIES[name]
    pytest.importorskip(module)
    config = RunConfig(*parse("LSTM: 1x8 - MLP: 8x10"), Toy(), horizon=20, simulate=True).resolved()
    _, _, test = other_libraries.parts(config)
    seconds, updates, errors = trained(config, 4.0)
    assert seconds >= 4 and updates > 0
    assert set(errors) == {f"{c}@{n}" for c in other_libraries.channels(config) for n in test}
    for (_, y), n in zip(test.values(), test, strict=True):
        for i, c in enumerate(other_libraries.channels(config)):
            assert errors[f"{c}@{n}"] < 1.5 * np.std(y[:, i])  # it has learnt, or at least kept to the mean


def test_what_trains_and_what_validates_is_what_the_others_have() -> None:
    config = RunConfig(*parse("LSTM: 1x8 - MLP: 8x10"), Toy(), horizon=20).resolved()
    train, validation, test = other_libraries.parts(config)
    split = other_libraries.choose_split(config)
    assert [len(train), len(validation), len(test)] == [len(getattr(split, p)) for p in ("train", "validation", "test")]
    measured = next(iter(test.values()))[1]
    errors = other_libraries.judged(test, 10, other_libraries.channels(config), lambda u, y: np.zeros_like(y))
    assert next(iter(errors.values())) == pytest.approx(np.sqrt(np.mean(measured[10:, 0] ** 2)))
