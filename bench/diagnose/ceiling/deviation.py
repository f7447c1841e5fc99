"""By what a predicted state is off, as a vector that can be added to it; an attitude's is a rotation."""

from collections.abc import Sequence

import torch
from torch import Tensor

from bench.diagnose.simulate.free_run import Group, between
from registry.contracts import Channel


def deviation(predicted: Tensor, measured: Tensor, groups: Sequence[Group]) -> Tensor:
    """Measured less predicted (…, n), group by group; of an attitude twice `between`, about the world's axes.

    Args:
        predicted: states (…, s).
        measured: states (…, s).
        groups: what was measured of them.
    """
    return torch.cat([_off(predicted[..., list(g.at)], measured[..., list(g.at)], g.name) for g in groups], dim=-1)


def corrected(predicted: Tensor, by: Tensor, groups: Sequence[Group]) -> Tensor:
    """The states (…, s) from which ``predicted`` deviates by (…, n): what `deviation` takes apart."""
    out, first = predicted.clone(), 0
    for group in groups:
        at = list(group.at)
        width = _width(group)
        own, first = by[..., first : first + width], first + width
        out[..., at] = _turned(predicted[..., at], own / 2) if group.name == "attitude" else predicted[..., at] + own
    return out


def axes(groups: Sequence[Group], channels: Sequence[Channel]) -> list[Group]:
    """Every channel of the groups as a group of its own; an attitude, which has no axes of its own, is left out."""
    return [Group(channels[i].name, g.unit, (i,)) for g in groups if g.name != "attitude" for i in g.at]


def _width(group: Group) -> int:
    return 3 if group.name == "attitude" else len(group.at)


def _off(predicted: Tensor, measured: Tensor, name: str) -> Tensor:
    return 2 * between(predicted, measured) if name == "attitude" else measured - predicted


def _turned(a: Tensor, vector: Tensor) -> Tensor:
    """The attitude xyzw (…, 4) turned by a rotation with this vector part (…, 3)."""
    w = (1 - vector.square().sum(-1, keepdim=True)).clamp(min=0).sqrt()
    own, scalar = a[..., :3], a[..., 3:]
    turned = w * own + scalar * vector + torch.linalg.cross(vector, own)
    return torch.cat([turned, w * scalar - (vector * own).sum(-1, keepdim=True)], dim=-1)
