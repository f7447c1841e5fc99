"""What is hidden, as a function of signals along an axis, written out in numpy; the suite's own words for its forms."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

Array = np.ndarray

FORMS: dict[str, Callable[[Array, tuple[float, ...]], Array]] = {
    "linear": lambda x, p: p[0] * x,
    "affine": lambda x, p: p[0] * x + p[1],
    "signed_square": lambda x, p: p[0] * x * np.abs(x),
    "cubic": lambda x, p: p[0] * x**3,
    "sign": lambda x, p: p[0] * np.tanh(x / p[1]),
    "above": lambda x, p: p[0] * np.maximum(x - p[1], 0),
    "below": lambda x, p: p[0] * np.maximum(p[1] - x, 0),
    "dead_zone": lambda x, p: p[0] * (x - np.clip(x, -p[1], p[1])),
    "saturation": lambda x, p: p[0] * np.clip(x, -p[1], p[1]),
    "exponential": lambda x, p: p[0] * np.exp(-p[1] * x),
    "wave": lambda x, p: p[0] * np.sin(p[1] * x + p[2]),
}
"""By name as the diagnosis calls a form: its value at x with parameters p. A sign is smoothed over p[1]."""
SAME: dict[str, tuple[str, ...]] = {
    "linear": ("linear", "affine"),
    "affine": ("affine", "linear"),
    "sign": ("sign", "sign_linear"),
}
"""Forms that say the same as another one where a constant beside it is free."""


@dataclass(frozen=True)
class Term:
    """f(x), or f(x) y, along one axis: a force [N], a torque [N m] or what is added to a state's rate of change."""

    axis: str
    signals: tuple[str, ...]
    form: str
    values: tuple[float, ...]
    alike: tuple[str, ...] = ()
    """Further axes along which the same is felt: they may be said beside it, and need not be."""
    instead: tuple[str, ...] = ()
    """Inputs that do the same by themselves: all of it may be said along one of them, in its unit."""

    def at(self, signals: Mapping[str, Array]) -> Array:
        """Its amount at signals of any shape."""
        out = self.curve(signals[self.signals[0]])
        return out * signals[self.signals[1]] if len(self.signals) > 1 else out

    def curve(self, x: Array) -> Array:
        """f alone."""
        return np.asarray(FORMS[self.form](x, self.values))

    @property
    def forms(self) -> tuple[str, ...]:
        """Names of the forms that are right."""
        return SAME.get(self.form, (self.form,))
