"""What is registered: frozen dataclasses whose fields are options, and which build predictors and initializers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from registry.contracts.dataset import Dataset
from registry.contracts.initializer import Initializer
from registry.contracts.predictor import Predictor
from registry.contracts.problem import Problem


class PredictorEntry(ABC):
    """Base of the frozen dataclasses registered as predictors."""

    training: ClassVar[str] = "gradient"
    """"gradient", "closed_form" (`Predictor.fit`) or "none"."""
    network: ClassVar[bool] = False
    """Whether the notation carries a size LxH (fields ``layers`` and ``hidden``)."""
    stateful: ClassVar[bool] = True
    """Whether an initializer is needed."""

    supports_batching: ClassVar[bool] = False
    """Whether several models of one shape are trained together: each weight then has a leading model dimension, as
    inputs and outputs have, and no random numbers are drawn. Without, training is plain PyTorch."""

    def signals(self, dataset: Dataset) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
        """Inputs, outputs and context where a run names none."""
        return dataset.inputs, dataset.predicted(), ()

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
    supports_batching: ClassVar[bool] = False
    """Whether weights may have a leading model dimension; see `PredictorEntry.supports_batching`."""

    @abstractmethod
    def build(self, predictor: Predictor, problem: Problem) -> Initializer:
        """A fresh initializer for ``predictor``."""
