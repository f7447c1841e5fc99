"""The few abstract types that everything else is built from.

Time: sample k is everything measured at t_k. A window's history is samples k0−τ+1 .. k0 (τ of them), its
horizon k0+1 .. k0+T. A prediction ŷ_k may use the inputs u_j for j ≤ k. SI inside.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from registry.core import DATASETS
from registry.cost import prediction_cost
from registry.errors import BenchError, near

# --------------------------------------------------------------------------------------------- measurements


@dataclass(frozen=True)
class Channel:
    """One column of a recording, named ``group.axis`` ("body_rates.p"), in an SI unit."""

    name: str
    unit: str

    @property
    def group(self) -> str:
        """The signal this channel belongs to."""
        return self.name.partition(".")[0]

    @property
    def axis(self) -> str:
        """Its axis within the signal."""
        return self.name.partition(".")[2]


@dataclass(frozen=True, eq=False)
class Recording:
    """One continuous measurement at a constant rate.

    Args:
        name: unique within its data set.
        rate: samples per second [Hz].
        inputs: (N, m) what drives the system, SI; m = 0 for an undriven one.
        outputs: (N, n) everything else that was measured, SI.
        input_channels: the m columns of ``inputs``.
        output_channels: the n columns of ``outputs``.
        valid: (N,) bool; a window never touches a sample that is not valid.
    """

    name: str
    rate: float
    inputs: np.ndarray
    outputs: np.ndarray
    input_channels: tuple[Channel, ...]
    output_channels: tuple[Channel, ...]
    valid: np.ndarray

    def __post_init__(self) -> None:
        n = len(self.outputs)
        if self.inputs.shape != (n, len(self.input_channels)):
            raise ValueError(f"{self.name}: inputs {self.inputs.shape} do not fit {len(self.input_channels)} channels")
        if self.outputs.shape != (n, len(self.output_channels)) or self.valid.shape != (n,):
            raise ValueError(f"{self.name}: outputs {self.outputs.shape} or mask {self.valid.shape} do not fit")
        names = [c.name for c in (*self.input_channels, *self.output_channels)]
        if len(set(names)) != len(names):
            raise ValueError(f"{self.name}: two channels of one name")

    def __len__(self) -> int:
        return len(self.outputs)

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return len(self) / self.rate

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Input and output channels."""
        return (*self.input_channels, *self.output_channels)

    def pick(self, selectors: Sequence[str]) -> tuple[np.ndarray, tuple[Channel, ...]]:
        """The columns (N, len) of the named groups ("body_rates") or channels ("body_rates.p"), in that order.

        Raises:
            BenchError: nothing of that name was measured.
        """
        picked = places(self.channels, selectors, f"Recording {self.name}")
        columns = np.concatenate([self.inputs, self.outputs], axis=1)
        return columns[:, picked], tuple(self.channels[i] for i in picked)

    def digest(self) -> str:
        """SHA-256 over samples, mask, rate and channel names (not the recording's own name)."""
        h = hashlib.sha256(repr((self.rate, [(c.name, c.unit) for c in self.channels])).encode())
        for a in (self.inputs, self.outputs, self.valid):
            h.update(np.ascontiguousarray(a).tobytes())
        return h.hexdigest()


def places(channels: Sequence[Channel], selectors: Sequence[str], owner: str) -> list[int]:
    """Where the named groups or channels are among an owner's channels, in the order of the names.

    Raises:
        BenchError: it has none of that name.
    """
    picked: list[int] = []
    for selector in selectors:
        found = [i for i, c in enumerate(channels) if selector in (c.name, c.group)]
        if not found:
            known = {c.group for c in channels} | {c.name for c in channels}
            raise BenchError(f"{owner} has no signal {selector!r}: {near(selector, known)}")
        picked += [i for i in found if i not in picked]
    return picked


@dataclass(frozen=True)
class Finding:
    """One thing that cleaning found in a recording and what was done about it."""

    recording: str
    kind: str
    """Such as "spike", "held", "dropped", "gap", "trimmed", "lag", "duplicate", "short"."""
    count: float
    """Samples concerned (for a lag: samples of shift)."""
    detail: str
    """One sentence with figures and units."""


@dataclass(frozen=True)
class Loaded:
    """What `Dataset.load` returns: the recordings that are left, and everything that was found in them."""

    recordings: tuple[Recording, ...]
    findings: tuple[Finding, ...]

    def digest(self) -> str:
        """SHA-256 over all recordings, in order, with their names."""
        h = hashlib.sha256()
        for r in self.recordings:
            h.update(f"{r.name}:{r.digest()};".encode())
        return h.hexdigest()

    @property
    def names(self) -> list[str]:
        """Names of the recordings."""
        return [r.name for r in self.recordings]


@dataclass(frozen=True)
class Split:
    """Which recordings train, which validate (early stopping, tuning) and which test."""

    train: tuple[str, ...]
    validation: tuple[str, ...]
    test: tuple[str, ...]


class Dataset(ABC):
    """A source of recordings. Subclasses are frozen dataclasses; their fields are options."""

    source: ClassVar[str] = ""
    """Where the data come from: citation or address, and licence."""
    system: ClassVar[str] = "quadrotor"
    """The registered physics model of the recorded system."""
    inputs: ClassVar[tuple[str, ...]] = ()
    """Signals that drive a predictor by default."""
    rates: ClassVar[str] = "body_rates"
    """The signal of three rotational rates that the studies predict one by one."""
    velocity: ClassVar[str] = "velocity"
    """The translational velocity signal."""
    input_hold: ClassVar[str] = "linear"
    """Inputs between samples: "linear" (measured) or "previous" (commands)."""
    physics: ClassVar[dict[str, Any]] = {}
    """Nominal constants of the recorded system, SI."""
    uncertainty: ClassVar[dict[str, float]] = {}
    """Relative 1σ of these constants, where it is not the model's default."""
    described: ClassVar[str] = ""
    """Where a user states its constants; empty: what is not in ``physics`` is as in the registered system."""
    processing: ClassVar[dict[str, Any]] = {}
    """What was done to the recordings, as [processing] of a dataset.toml says it."""
    recorded: ClassVar[tuple[Channel, ...]] = ()
    """Channels of every recording, inputs first, where they are known before anything is read or simulated."""
    in_full: ClassVar[dict[str, str]] = {}
    """Options of the whole of the data, where they come in sizes; studies take it for all but smoke tests."""

    @property
    def label(self) -> str:
        """What tables and titles call the data: the registered name, unless the data have one of their own."""
        return DATASETS.name_of(type(self))

    def load(self) -> Loaded:
        """Read, clean and check. Duplicated recordings are dropped and named in the findings.

        Raises:
            BenchError: the data are absent or broken; the message says what to do.
        """
        loaded = self.read()
        kept: dict[str, Recording] = {}
        findings = list(loaded.findings)
        for recording in loaded.recordings:
            digest = recording.digest()
            if digest in kept:
                findings.append(
                    Finding(
                        recording.name, "duplicate", len(recording), f"dropped: the same samples as {kept[digest].name}"
                    )
                )
            else:
                kept[digest] = recording
        if not kept:
            raise BenchError(f"Dataset {type(self).__name__} holds no usable recording.")
        return Loaded(tuple(kept.values()), tuple(findings))

    @abstractmethod
    def read(self) -> Loaded:
        """The cleaned recordings, duplicates included; called by `load`."""

    @abstractmethod
    def split(self, names: Sequence[str]) -> Split:
        """The published or default split of the recordings ``names``."""


# ----------------------------------------------------------------------------------------------- predictors


@dataclass(frozen=True)
class Problem:
    """What a model is to predict from what: all that a predictor or an initializer is built from."""

    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    horizon: int
    """Prediction length T [samples]."""
    history: int
    """Initialization length τ [samples]."""
    context: tuple[Channel, ...] = ()
    """Measured during the history only: they set initial states and are not predicted."""
    rate: float = 100.0
    """Samples per second [Hz]."""
    system: str = "quadrotor"
    """The registered physics model of what was recorded, its nominal constants, and what inputs do between samples."""
    physics: Mapping[str, Any] = field(default_factory=dict)
    input_hold: str = "linear"

    @classmethod
    def plain(cls, n_inputs: int, n_outputs: int, horizon: int, history: int, n_context: int = 0) -> Problem:
        """A problem whose channels have no meaning."""

        def channels(name: str, count: int) -> tuple[Channel, ...]:
            return tuple(Channel(f"{name}.{i}", "1") for i in range(count))

        named = channels("input", n_inputs), channels("output", n_outputs)
        return cls(*named, horizon, history, channels("context", n_context))

    @property
    def n_inputs(self) -> int:
        """m."""
        return len(self.inputs)

    @property
    def n_outputs(self) -> int:
        """n."""
        return len(self.outputs)

    @property
    def n_context(self) -> int:
        """c."""
        return len(self.context)

    @property
    def n_measured(self) -> int:
        """Columns m + n + c of a sample of the history."""
        return self.n_inputs + self.n_outputs + self.n_context


@dataclass(frozen=True)
class StateLayout:
    """A predictor's state vector: [output states and delay-line buffers | hidden | cell]."""

    buffer: int
    hidden: int
    cell: int

    @property
    def size(self) -> int:
        """Length s of the state."""
        return self.buffer + self.hidden + self.cell

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Lengths of the three pieces."""
        return self.buffer, self.hidden, self.cell

    def split(self, state: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(…, s) → buffers (…, s_b), hidden (…, s_h), cell (…, s_c)."""
        b, h, c = state.split(self.sizes, dim=-1)
        return b, h, c


class Scaler(nn.Module):
    """An affine map between SI values and scaled ones, (x − offset) / scale, kept as buffers of the model."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("offset", torch.zeros(size))
        self.register_buffer("scale", torch.ones(size))
        self.offset: Tensor
        self.scale: Tensor

    def set(self, offset: Tensor, scale: Tensor) -> None:
        """Fit values, from the training part only; a scale of zero (a constant channel) becomes one."""
        self.offset.copy_(offset)
        self.scale.copy_(torch.where(scale > 0, scale, torch.ones_like(scale)))

    def forward(self, x: Tensor) -> Tensor:
        """SI (…, size) → scaled (…, size)."""
        return (x - self.offset) / self.scale

    def invert(self, x: Tensor) -> Tensor:
        """Scaled (…, size) → SI (…, size)."""
        return x * self.scale + self.offset


Gradients = dict[str, Tensor]
"""Of the parameters of a network, by name. Fresh tensors, to be added to."""
CostVJP = Callable[[Tensor], tuple[Tensor, Gradients]]
"""From the gradient of what the cost looks at (…, B, T, n) to that of the state at k0 and those of the parameters."""
RunVJP = Callable[[Tensor | None, Tensor | None], tuple[Tensor, Gradients]]
"""From the gradients of outputs (…, B, T, n) and end state (…, B, s), which may be overwritten (None: zero), to that of
the state at k0 and those of the parameters."""
ReadoutVJP = Callable[[Tensor, Tensor], Gradients]
"""From the gradient of what was read (…, B, n); adds to that of the state (…, B, s), its second argument."""
InitialVJP = Callable[[Tensor], tuple[Gradients, Gradients]]
"""From the gradient of the state (…, B, s), which may be overwritten, to those of the initializer's parameters and
those of the predictor's."""


class Predictor(nn.Module, ABC):
    """Predicts T steps of outputs from T inputs and a state, running free.

    Subclasses work in scaled units (`rollout`); `forward` is SI in, SI out. ``horizon`` is the T the
    predictor is built for (recurrent ones accept any T).
    """

    layout: StateLayout
    history: int = 1
    """Samples of history that `fill` needs."""
    by_hand: bool = True
    """Whether this one, of a class with `rollout_vjp` or `teach_vjp`, can do without autograd."""
    views: tuple[str, ...] = ()
    """Names of further predictions that are judged beside the free run; see `view`."""

    def __init__(self, problem: Problem) -> None:
        super().__init__()
        self.problem = problem
        self.n_inputs, self.n_outputs, self.n_context = problem.n_inputs, problem.n_outputs, problem.n_context
        self.horizon = problem.horizon
        self.input_scaler, self.output_scaler = Scaler(self.n_inputs), Scaler(self.n_outputs)
        self.context_scaler = Scaler(self.n_context) if self.n_context else None

    def scale_history(self, outputs: Tensor) -> Tensor:
        """SI history (…, τ, n + c), outputs then context → scaled."""
        if self.context_scaler is None:
            return self.output_scaler(outputs)
        measured, context = outputs.split([self.n_outputs, self.n_context], -1)
        return torch.cat([self.output_scaler(measured), self.context_scaler(context)], -1)

    @abstractmethod
    def fill(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """Buffers (B, s_b) at k0 from the scaled measured history (B, τ, m), (B, τ, n + c)."""

    @abstractmethod
    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Free run in scaled units.

        Args:
            inputs: (B, T, m) u_{k0+1} .. u_{k0+T}.
            state: (B, s) at k0.
            feedback: (B, T, n) measured outputs y_{k0+1} .. y_{k0+T} that are fed back in place of the
                predictor's own (washout, teacher forcing).

        Returns:
            outputs (B, T, n) and the state (B, s) at k0+T.
        """

    def teach(self, inputs: Tensor, outputs: Tensor, state: Tensor) -> Tensor:
        """What the training cost looks at (B, T, n), scaled: the free run, unless measured outputs (B, T, n) are fed.

        Tests and validation always run free.
        """
        return self.rollout(inputs, state)[0]

    def cost(self, predicted: Tensor, measured: Tensor) -> Tensor:
        """L_pred (…) of scaled outputs (…, B, T, n); lower is better."""
        return prediction_cost(predicted, measured)

    def vary(self, windows: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        """Training windows, scaled, as they are or changed at random by what the system cannot tell, such as mirrored.

        Args:
            windows: history inputs (…, B, τ, m) and outputs (…, B, τ, n + c), horizon inputs (…, B, T, m) and outputs
                (…, B, T, n). Draw from torch's global generator; then `PredictorEntry.side_by_side` must be False.
        """
        return windows

    def viewed(self, name: str) -> list[int]:
        """The columns of the outputs that a view is about; all of them unless said."""
        return list(range(self.n_outputs))

    def view(self, name: str, inputs: Tensor, outputs: Tensor, state: Tensor) -> Tensor:
        """A further prediction (B, T, len(viewed)), one of `views`, scaled, given what `rollout` and `teach` are."""
        raise NotImplementedError(f"{type(self).__name__} has no view {name!r}")

    def rollout_vjp(
        self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None
    ) -> tuple[Tensor, Tensor, RunVJP]:
        """`rollout` on the compiled core without autograd, and its vector-Jacobian product: autograd's, bit for bit.

        Not every predictor has one. Where a subclass changes a method but not its product, or the cost, training falls
        back on autograd.
        """
        raise NotImplementedError

    def teach_vjp(self, inputs: Tensor, outputs: Tensor, state: Tensor) -> tuple[Tensor, CostVJP]:
        """`teach` and its vector-Jacobian product; see `rollout_vjp`."""
        predicted, _, run = self.rollout_vjp(inputs, state)
        return predicted, lambda d_outputs: run(d_outputs, None)

    def readout(self, state: Tensor, inputs: Tensor) -> Tensor | None:
        """ŷ_{k0} (B, n) as the output layer reads it from the state (B, s) and u_{k0} (B, m), scaled.

        The state-initialization cost is its distance from the measured y_{k0} (paper, eq. state_init_cost).
        None: the predictor has no states to initialize.
        """
        return None

    def readout_vjp(self, state: Tensor, inputs: Tensor) -> tuple[Tensor, ReadoutVJP] | None:
        """`readout` and its vector-Jacobian product; see `rollout_vjp`."""
        return None

    def fit(self, history_inputs: Tensor, history_outputs: Tensor, inputs: Tensor, outputs: Tensor) -> None:
        """Closed-form fit on scaled training windows, for predictors not trained by gradient."""

    def forward(self, inputs: Tensor, state: Tensor) -> Tensor:
        """SI inputs (B, T, m) and state (B, s) → SI outputs (B, T, n)."""
        outputs, _ = self.rollout(self.input_scaler(inputs), state)
        return self.output_scaler.invert(outputs)

    def weight_count(self) -> int:
        """Number of trainable weights."""
        return sum(p.numel() for p in self.parameters())


class Composite(Predictor):
    """Several initialized networks that predict together; each has an initializer of its own."""

    @abstractmethod
    def parts(self) -> list[Predictor]:
        """The networks, each with its own problem."""

    @abstractmethod
    def part_history(self, part: int, inputs: Tensor, outputs: Tensor) -> tuple[Tensor, Tensor]:
        """Scaled history of a part, (B, τ, m_i) and (B, τ, n_i + c_i), from that of the whole."""

    @abstractmethod
    def join(self, states: Sequence[Tensor], inputs: Tensor, outputs: Tensor) -> Tensor:
        """State (B, s) of the whole from those of its parts (B, s_i) and its own scaled history."""

    def separate(self, d_state: Tensor) -> list[Tensor]:
        """The gradients of the parts' states (B, s_i) from that of the whole (B, s): the way back of `join`."""
        raise NotImplementedError


class Initializer(nn.Module, ABC):
    """Sets a predictor's state from a history of τ samples.

    ``predictor`` is passed to the calls and not held, so that its weights are counted once.
    """

    uses_state_cost: ClassVar[bool] = False
    """Whether L_si joins the training cost (the neural initializers)."""

    @abstractmethod
    def initialize(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> Tensor:
        """State (B, s) at k0 from the scaled history (B, τ, m), (B, τ, n + c)."""

    def initialize_vjp(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> tuple[Tensor, InitialVJP]:
        """`initialize` and its vector-Jacobian product, for a predictor that has one; see `Predictor.rollout_vjp`."""
        raise NotImplementedError

    def forward(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> Tensor:
        """State (B, s) from the SI history (B, τ, m), (B, τ, n + c)."""
        return self.initialize(predictor, predictor.input_scaler(inputs), predictor.scale_history(outputs))

    def weight_count(self) -> int:
        """Number of trainable weights."""
        return sum(p.numel() for p in self.parameters())


class PredictorEntry(ABC):
    """Base of the frozen dataclasses registered as predictors."""

    training: ClassVar[str] = "gradient"
    """"gradient", "closed_form" (`Predictor.fit`) or "none"."""
    network: ClassVar[bool] = False
    """Whether the notation carries a size LxH (fields ``layers`` and ``hidden``)."""
    stateful: ClassVar[bool] = True
    """Whether an initializer is needed."""

    side_by_side: ClassVar[bool] = False
    """Whether several models of one shape are trained together: each weight then has a leading model dimension, as
    inputs and outputs have, and no random numbers are drawn. Without, training is plain PyTorch."""

    def signals(self, dataset: Dataset) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
        """Inputs, outputs and context where a run names none."""
        return dataset.inputs, (dataset.rates,), ()

    def content(self) -> str:
        """Digest of the files that the options name, for the run key; empty: they name none."""
        return ""

    @abstractmethod
    def build(self, problem: Problem) -> Predictor:
        """A fresh predictor; weights are drawn from torch's global generator."""


class InitializerEntry(ABC):
    """Base of the frozen dataclasses registered as initializers. ``history`` is τ, the initialization length."""

    history: int
    sized: ClassVar[bool] = False
    """Whether the notation carries the size of a hidden layer (field ``hidden``)."""
    side_by_side: ClassVar[bool] = False
    """Whether weights may have a leading model dimension; see `PredictorEntry.side_by_side`."""

    @abstractmethod
    def build(self, predictor: Predictor, problem: Problem) -> Initializer:
        """A fresh initializer for ``predictor``."""
