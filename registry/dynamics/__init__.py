"""Physics models and the effects that a simple one leaves out.

A model's constants and an effect's parameters are the fields of frozen dataclasses; each may hold a number,
a tuple of numbers or a tensor (to fit it by gradient, or one value a batch element). Everything is batched
over leading dimensions and differentiable. SI inside; world z up, body x forward, y left, z up.
"""

from registry.dynamics.description import Axis, Description, Quantity, Signals, per_second
from registry.dynamics.effects import (
    Effect,
    HubEffect,
    InputEffect,
    InternalEffect,
    LoadEffect,
    ModelEffect,
    Motion,
    PointEffect,
    RateEffect,
    ThrustEffect,
    TorqueEffect,
    WindEffect,
)
from registry.dynamics.model import PhysicsModel, Rates, advanced, unsuited
from registry.dynamics.parameters import (
    Parameter,
    constant,
    cross,
    in_measure,
    joined,
    tensor,
    total,
    turned,
    turned_back,
    vector,
)
from registry.dynamics.pilot import Pilot, SetPoint
from registry.dynamics.rotations import quaternion_rate, rotation_matrix
from registry.dynamics.sticking import DryEffect, resting, sticks

__all__ = [
    "Axis",
    "Description",
    "DryEffect",
    "Effect",
    "HubEffect",
    "InputEffect",
    "InternalEffect",
    "LoadEffect",
    "ModelEffect",
    "Motion",
    "Parameter",
    "PhysicsModel",
    "Pilot",
    "PointEffect",
    "Quantity",
    "RateEffect",
    "Rates",
    "SetPoint",
    "Signals",
    "ThrustEffect",
    "TorqueEffect",
    "WindEffect",
    "advanced",
    "constant",
    "cross",
    "in_measure",
    "joined",
    "per_second",
    "quaternion_rate",
    "resting",
    "rotation_matrix",
    "sticks",
    "tensor",
    "total",
    "turned",
    "turned_back",
    "unsuited",
    "vector",
]
