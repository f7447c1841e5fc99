"""Networks that predict by what the free runs of a model deviate, from the same history and inputs.

A series hybrid: an LSTM sees the signals of the model's own free run and adds to it, and another one reads the history
and sets its states (the RNN initializer of Mohajerin and Waslander). The model itself is not differentiated, so any
will do. They are trained by the loop that trains all networks here, several seeds side by side.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from bench.diagnose.ceiling.examples import Examples
from bench.diagnose.ceiling.scaling import Scaling
from bench.diagnose.settings import CEILING
from bench.experiment.config import RunConfig, Training
from bench.training.data import WindowedData, Windows
from bench.training.model import Model
from bench.training.train import train
from registry.contracts import Channel, Dataset, RecordingSet, Split
from registry.errors import BenchError
from registry.initializers.rnn import RNN
from registry.predictors.lstm import LSTM

Progress = Callable[[float], None]
"""Called with the share of the training that is done."""


@dataclass(frozen=True, eq=False)
class Networks:
    """Networks from several seeds, and how far what they predict of each deviation is to be believed."""

    models: tuple[Model, ...]
    scaling: Scaling
    trust: Tensor
    """(n,) from 0 to 1."""

    @classmethod
    def learned(cls, examples: Examples, others: Examples, progress: Progress = lambda share: None) -> "Networks":
        """Train on examples until others are predicted no better; these tell how far the networks are to be believed.

        Args:
            examples: to learn from.
            others: from other recordings, or later in the same ones.
            progress: see `Progress`.
        """
        examples, others = examples.finite(), others.finite()
        scaling = Scaling.of(examples)
        data = _windowed(scaling, examples, others)
        done = [0.0]

        def tell(updates: int) -> None:
            done[0] += updates / (CEILING.seeds * CEILING.updates)
            progress(min(1.0, done[0]))

        configs = _configs(data)
        trained = train(configs, [data] * len(configs), tell)
        blank = cls(tuple(t.model for t in trained), scaling, torch.ones_like(scaling.past))
        said, true = blank.predict(others).mean(0) / scaling.ahead, others.deviations / scaling.ahead
        power = said.square().sum((0, 1))
        slope = (said * true).sum((0, 1)) / torch.where(power > 0, power, 1.0)
        return cls(blank.models, scaling, torch.nan_to_num(slope, nan=0.0).clamp(0, 1))

    def predict(self, examples: Examples) -> Tensor:
        """What each network adds to free runs (networks, W, T, n), SI."""
        signals, history = self.scaling.shown(examples)
        past = history.shape[1]
        history = torch.cat([torch.zeros_like(history), history], dim=-1)
        each = [model.predict(signals[:, :past], history, signals[:, past:]) for model in self.models]
        return torch.stack(each).double() * self.scaling.ahead * self.trust


def _configs(data: WindowedData) -> list[RunConfig]:
    training = Training(
        updates=CEILING.updates,
        patience=CEILING.patience,
        weight_decay=CEILING.weight_decay,
        validation_windows=CEILING.windows,
        beta=0.0,
    )
    first = RNN(hidden=CEILING.hidden, history=data.tau)
    return [
        RunConfig(LSTM(hidden=CEILING.hidden), first, _Shown(), horizon=data.horizon, training=training, seed=seed)
        for seed in range(CEILING.seeds)
    ]


def _windowed(scaling: Scaling, examples: Examples, others: Examples) -> WindowedData:
    """Examples as windows of joined recordings, each of which is one window; scaled already."""
    parts = []
    for of in (examples, others):
        signals, history = scaling.shown(of)
        ahead = (of.deviations / scaling.ahead).float()
        past = torch.zeros(len(ahead), history.shape[1], ahead.shape[2])
        parts.append((signals, torch.cat([past, ahead], 1), torch.cat([history, torch.zeros_like(ahead)], 1)))
    inputs, outputs, context = (torch.cat(both).flatten(0, 1).contiguous() for both in zip(*parts, strict=True))
    tau, horizon = examples.history.shape[1], examples.deviations.shape[1]
    first = torch.arange(len(examples.run) + len(others.run)) * (tau + horizon)
    learned, confirming = first.split([len(examples.run), len(others.run)])
    return WindowedData(
        inputs=inputs,
        outputs=outputs,
        context=context,
        input_channels=_channels("signal", inputs),
        output_channels=_channels("deviation", outputs),
        context_channels=_channels("past", context),
        rate=1.0,
        tau=tau,
        horizon=horizon,
        train=_of_one(learned),
        validation=_of_one(confirming),
        test=_of_one(confirming[:0]),
        names=(),
        split=Split((), (), ()),
        input_scale=_as_it_is(inputs),
        output_scale=_as_it_is(outputs),
        context_scale=_as_it_is(context),
    )


def _of_one(starts: Tensor) -> Windows:
    return Windows(starts, np.zeros(len(starts), dtype=int))


def _channels(name: str, values: Tensor) -> tuple[Channel, ...]:
    return tuple(Channel(f"{name}.{i}", "1") for i in range(values.shape[1]))


def _as_it_is(values: Tensor) -> tuple[Tensor, Tensor]:
    return torch.zeros(values.shape[1]), torch.ones(values.shape[1])


class _Shown(Dataset):
    """Stands for the examples in the configuration of a training, which is given them as windows."""

    def read(self) -> RecordingSet:
        """Raise `BenchError`: there are no recordings of examples."""
        raise BenchError("Examples of free runs are no recordings.")

    def split(self, names: object) -> Split:
        """Nothing to split."""
        return Split((), (), ())
