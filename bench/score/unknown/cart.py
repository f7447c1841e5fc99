"""A pendulum that hangs from a cart, as a user would bring it: a class of one's own in a file, registered nowhere."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.contracts import Channel
from registry.dynamics import constant, tensor
from registry.physics.state_space import StateSpace
from registry.units import Signal


@dataclass(frozen=True)
class CartPendulum(StateSpace):
    """A cart that a force pushes along a level rail, and a bob on a rod that hangs from it."""

    cart_mass: Any = constant(2.0, "M", "kg", low=1e-6)
    bob_mass: Any = constant(0.02, "m", "kg", low=1e-6)
    length: Any = constant(0.25, "l", "m", low=1e-6)
    friction: Any = constant(6.0, "d: of the cart", "N s/m", low=0)
    damping: Any = constant(0.6, "b: of the joint over m l²", "1/s", low=0)

    state_channels: ClassVar[tuple[Channel, ...]] = (
        Channel("place.x", "m"),
        Channel("tilt.theta", "rad"),
        Channel("pace.x", "m/s"),
        Channel("tilt_rate.theta", "rad/s"),
    )
    input_signals: ClassVar[tuple[str, ...]] = ("push",)
    signals: ClassVar[dict[str, Signal]] = {
        "push": Signal("N"),
        "place": Signal("m", ("x",)),
        "tilt": Signal("rad", ("theta",)),
        "pace": Signal("m/s", ("x",)),
        "tilt_rate": Signal("rad/s", ("theta",)),
    }
    alike: ClassVar[tuple[str, ...]] = ()
    equation: ClassVar[str] = (
        "(M + m sin²θ) x'' = F − d x' + m sin θ (l θ'² + g cos θ) + m l b θ' cos θ;  "
        "l θ'' = −g sin θ − x'' cos θ − b l θ'"
    )

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """dx/dt (…, 4); see `StateSpace.own_rate`."""
        heavy, light, length, friction, damping = (
            tensor(c, state) for c in (self.cart_mass, self.bob_mass, self.length, self.friction, self.damping)
        )
        _, angle, speed, swing = state.unbind(-1)
        sine, cosine = torch.sin(angle), torch.cos(angle)
        push = inputs[..., 0] - friction * speed + light * sine * (length * swing**2 + 9.81 * cosine)
        push = push + light * length * damping * swing * cosine
        acceleration = push / (heavy + light * sine**2)
        turning = -(9.81 * sine + acceleration * cosine) / length - damping * swing
        return torch.stack([speed, swing, acceleration, turning], dim=-1)
