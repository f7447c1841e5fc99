"""Mirror images of a vehicle: what it does mirrored, it would do if flown mirrored, where its rotors allow it."""

import torch
from torch import Tensor

from registry.contracts import Channel
from registry.physics.quadrotor import Quadrotor

_PLANES = ((1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (-1.0, 1.0, 1.0), (-1.0, -1.0, 1.0))
"""As it is, left for right, front for back, and both: a half turn about z. With any two, their product."""
_POLAR = ("position", "velocity", "specific_force")
_AXIAL = ("body_rates", "attitude")
"""The vector part of a quaternion turns as an axial vector; its scalar stays."""
_AXES = {a: i for axes in (("x", "y", "z"), ("p", "q", "r"), ("qx", "qy", "qz")) for i, a in enumerate(axes)}
_NEAR = 1e-3
"""How far a mirrored hub may be from one of the vehicle, relative to the largest arm."""


class Mirrors:
    """The mirror images about the body's (and the world's) xz and yz planes that a vehicle's rotors allow.

    A reflection M takes polar vectors to M v, axial ones to det(M) M v, a rotation to M R M; a rotor goes where its
    mirror image is, which must turn the other way if M is a reflection.
    """

    def __init__(self, model: Quadrotor, wanted: bool = True) -> None:
        """
        Args:
            model: with the positions and directions of the rotors.
            wanted: whether there are others than the vehicle itself.
        """
        hubs = torch.tensor(model.rotor_positions, dtype=torch.float64)
        directions = torch.tensor(model.rotor_directions, dtype=torch.float64)
        found: list[tuple[tuple[float, ...], list[int]]] = []
        for plane in _PLANES if wanted else _PLANES[:1]:
            m = torch.tensor(plane, dtype=torch.float64)
            distance, image = torch.cdist(hubs * m, hubs).min(1)
            turned = directions[image] == directions * m.prod()
            if bool((distance <= _NEAR * hubs.abs().max()).all()) and bool(turned.all()):
                found.append((plane, image.tolist()))
        self.polar = torch.tensor([plane for plane, _ in found])
        """(G, 3) what polar vectors are multiplied by; the first image is the vehicle itself."""
        self.axial = self.polar * self.polar.prod(-1, keepdim=True)
        """(G, 3) the same of axial vectors."""
        self.rotors = torch.tensor([image for _, image in found])
        """(G, rotors): each rotor of the image is which of the vehicle."""

    def __len__(self) -> int:
        return len(self.polar)

    def signs(self, channels: tuple[Channel, ...]) -> Tensor:
        """(G, c) what channels are multiplied by; 1 for those that are not vectors."""
        table = torch.ones(len(self), len(channels))
        for column, c in enumerate(channels):
            if c.group in _POLAR + _AXIAL and c.axis in _AXES:
                vectors = self.polar if c.group in _POLAR else self.axial
                table[:, column] = vectors[:, _AXES[c.axis]]
        return table
