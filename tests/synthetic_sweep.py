"""Sweeps of cheap models on the toy data, and what is registered for them; what they should find is planted."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import optuna
from conftest import Toy

from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse
from bench.sweep import journal as sweep
from bench.sweep import search
from bench.sweep.space import default_space, parse_search
from registry.contracts import Predictor, PredictorEntry, RecordingSet, Split, StateLayout
from registry.core import DATASETS, PREDICTORS, option


class HeldOff(Predictor):
    """The last sample, off by a distance."""

    def __init__(self, problem, distance):
        super().__init__(problem)
        self.layout, self.history, self.distance = StateLayout(self.n_outputs, 0, 0), 1, distance

    def init_buffers(self, inputs, outputs):
        return outputs[..., -1, : self.n_outputs]

    def rollout(self, inputs, state, feedback=None):
        shape = (*inputs.shape[:-1], self.n_outputs)
        return (state.unsqueeze(-2) + self.distance).expand(shape), state


@PREDICTORS.register("planted")
@dataclass(frozen=True)
class Planted(PredictorEntry):
    """Right where x = 7.3 and rate = 0.02 alone; for tests."""

    training: ClassVar[str] = "none"
    stateful: ClassVar[bool] = False
    x: float = option(1.0, "place", low=0.0, high=10.0, search=(0.0, 10.0))
    rate: float = option(1.0, "rate", low=1e-4, high=10.0, log=True, search=(1e-4, 10.0))

    def build(self, problem):
        return HeldOff(problem, 10 * (abs(self.x - 7.3) / 10 + abs(np.log10(self.rate / 0.02)) / 5))


@DATASETS.register("poisoned toy")
@dataclass(frozen=True)
class PoisonedToy(Toy):
    """The toy with garbage in its test recording; for tests."""

    def read(self) -> RecordingSet:
        *kept, last = super().read().recordings
        rng = np.random.default_rng(1)
        noise = {name: 1e3 * rng.normal(size=getattr(last, name).shape) for name in ("inputs", "outputs")}
        return RecordingSet((*kept, replace(last, **noise)), ())


@DATASETS.register("toy without validation")
@dataclass(frozen=True)
class NoValidation(Toy):
    """The toy with two parts; for tests."""

    def split(self, names):
        return Split(tuple(names[:-1]), (), (names[-1],))


TRAINING = Training(updates=40, evaluate_every=4, batch=32)


RATES = "1e-5:2e-2:log"
"""Learning rates of which half learn nothing in so few updates."""


def toy(spec: str = "LSTM: 1x8 - MLP: 9x10", dataset: Toy | None = None) -> RunConfig:
    return RunConfig(*parse(spec), dataset or Toy(), horizon=6, training=TRAINING)


def swept(
    folder: Path, config: RunConfig, trials: int, objectives: tuple[str, ...] = ("rmsse",), **searched: str
) -> tuple[sweep.Sweep, optuna.Study]:
    """A sweep in this process; ``predictor_hidden="8:16"`` searches an option."""
    space = default_space([config])
    if "predictor.hidden" in space:
        searched = {"predictor_hidden": "8:16", "predictor_layers": "1,2", "initializer_hidden": "9:16"} | searched
    space |= dict(parse_search(f"{path.replace('_', '.', 1)}={v}", [config]) for path, v in searched.items())
    asked = sweep.Sweep("toy sweep", (config,), space, objectives, 0, "bench sweep toy")
    study = sweep.begin(asked, folder, resume=True)
    search.search(asked, study, folder, trials)
    return asked, study


def essence(study: optuna.Study) -> list[tuple]:
    return [(t.params, t.state, t.values, t.user_attrs.get("curve")) for t in sweep.finished(study)]
