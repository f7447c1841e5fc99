"""The effects' stock manoeuvres as signals: what their phrases ask for, within the same limits."""

from collections.abc import Sequence

import numpy as np

from bench.diagnose.manoeuvre.limits import Limit
from bench.diagnose.manoeuvre.waveform import slewed
from bench.diagnose.settings import COMPOSING
from registry.core import EFFECTS

_LINES = (
    "rotor_drag", "linear_drag", "parasitic_drag", "blade_flapping", "translational_lift", "wind",
    "viscous_friction", "quadratic_drag", "rotor_misalignment",
)  # fmt: skip
_REVERSALS = ("coulomb_friction", "stribeck_friction", "offset_force", "backlash", "bouc_wen")
_SIZES = (
    "linear_stiffness", "cubic_stiffness", "gravity_torque", "dead_zone", "saturation", "cogging", "suspended_load",
)  # fmt: skip
_CLIMBS = (
    "inflow_thrust_loss", "vortex_ring_state", "cog_offset", "battery_sag", "thrust_scale", "mass", "ground_effect",
)  # fmt: skip
KINDS = {
    **dict.fromkeys(_LINES, "lines"),
    **dict.fromkeys(_REVERSALS, "reversals"),
    **dict.fromkeys(_SIZES, "sizes"),
    **dict.fromkeys(_CLIMBS, "climbs"),
}
"""By effect; of all others "steps"."""


def kind_of(effect: str) -> str:
    """Which of the stock manoeuvres (`KINDS`) shows an effect; steps where none is assigned."""
    return KINDS.get(effect, "steps")


def phrase_of(effect: str) -> str:
    """The manoeuvre that an effect's catalogue entry recommends, as text; empty: none."""
    return str(EFFECTS.get(effect).manoeuvre) if effect in EFFECTS.names() else ""


def stock_signals(kind: str, limits: Sequence[Limit], samples: int, dt: float) -> np.ndarray:
    """(1, N, c) of one of `KINDS`."""
    s, out = np.arange(samples) / samples, []
    for i, limit in enumerate(limits):
        mine = _shape(kind, s, i, limits)
        low, high, start = limit.low, limit.high, limit.start
        wanted = np.where(mine < 0, start + mine * (start - low), start + mine * (high - start))
        out.append(slewed(np.clip(wanted, low, high)[None], limit, dt))
    return np.stack(out, axis=-1)


def _shape(kind: str, s: np.ndarray, place: int, limits: Sequence[Limit]) -> np.ndarray:
    """(N,) from −1 (the lower limit) over 0 (where it starts) to 1, at times ``s`` from 0 to 1."""
    of, name = len(limits), limits[place].name
    if kind == "climbs" and of > 1:
        return _stairs(s, (1, -1, 0.5, -0.5, 1, 0)) if name == "position.z" else np.zeros_like(s)
    if kind == "lines" and of > 1:
        order = {"position.x": 0, "position.y": 1}.get(name)
        return np.zeros_like(s) if order is None else _stairs(np.mod(s + order / 2, 1), (0.4, -0.4, 1, -1, 0, 0))
    if kind == "lines":
        return _stairs(s, (0.2, 0.6, 1.0, -0.2, -0.6, -1.0))
    if kind == "reversals":
        return np.asarray(0.5 * (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * COMPOSING.pace * s)))
    if kind in ("sizes", "climbs"):
        return np.asarray(np.where(s < 0.5, 0.2, 1.0) * np.sin(2 * np.pi * 2 * COMPOSING.pace * s))
    turns = np.mod(s + place / of, 1.0)
    return _stairs(turns, (1, 0, -1, 0, 1, -1))


def _stairs(s: np.ndarray, levels: Sequence[float]) -> np.ndarray:
    return np.array(levels, dtype=float)[np.minimum((s * len(levels)).astype(int), len(levels) - 1)]
