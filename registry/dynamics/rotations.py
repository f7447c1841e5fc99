"""Rotations of a body as unit quaternions xyzw."""

import torch
from torch import Tensor

from registry.dynamics.parameters import total


def rotation_matrix(quaternion: Tensor) -> Tensor:
    """Body-to-world rotation (…, 3, 3) of a quaternion xyzw (…, 4) of any length but zero."""
    x, y, z, w = quaternion.unbind(-1)
    s = 2 / total(quaternion * quaternion, -1)
    xx, yy, zz, xy, xz, yz = x * x * s, y * y * s, z * z * s, x * y * s, x * z * s, y * z * s
    wx, wy, wz = w * x * s, w * y * s, w * z * s
    rows = [1 - yy - zz, xy - wz, xz + wy, xy + wz, 1 - xx - zz, yz - wx, xz - wy, yz + wx, 1 - xx - yy]
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def quaternion_rate(quaternion: Tensor, body_rates: Tensor) -> Tensor:
    """Time derivative (…, 4) of a quaternion xyzw (…, 4) at body rates (…, 3): half of q ⊗ (ω, 0)."""
    x, y, z, w = quaternion.unbind(-1)
    p, q, r = body_rates.unbind(-1)
    rows = [w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p, -x * p - y * q - z * r]
    return 0.5 * torch.stack(rows, dim=-1)
