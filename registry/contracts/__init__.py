"""The few abstract types that everything else is built from.

Time: sample k is everything measured at t_k. A window's history is samples k0−τ+1 .. k0 (τ of them), its
horizon k0+1 .. k0+T. A prediction ŷ_k may use the inputs u_j for j ≤ k. SI inside.
"""

from registry.contracts.dataset import Dataset
from registry.contracts.entries import InitializerEntry, PredictorEntry
from registry.contracts.initializer import Initializer, InitialVJP
from registry.contracts.measurements import Channel, Finding, Recording, RecordingSet, Split, places
from registry.contracts.predictor import (
    Composite,
    CostVJP,
    Gradients,
    Predictor,
    ReadoutVJP,
    RunVJP,
    Scaler,
    StateLayout,
)
from registry.contracts.problem import Problem

__all__ = [
    "Channel",
    "Composite",
    "CostVJP",
    "Dataset",
    "Finding",
    "Gradients",
    "InitialVJP",
    "Initializer",
    "InitializerEntry",
    "Predictor",
    "PredictorEntry",
    "Problem",
    "ReadoutVJP",
    "Recording",
    "RecordingSet",
    "RunVJP",
    "Scaler",
    "Split",
    "StateLayout",
    "places",
]
