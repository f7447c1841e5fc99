"""How a result shows itself: as a table, as a drawing, and by itself in a notebook."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
import pandas as pd


class Displayed(ABC):
    """A result with a headline and a table. What users wrote, names of files among it, is escaped in a notebook."""

    @property
    @abstractmethod
    def headline(self) -> str:
        """What it says, in a sentence."""

    @abstractmethod
    def to_frame(self) -> pd.DataFrame:
        """The figures as a table, a unit beside every number."""

    def __str__(self) -> str:
        """What `print` shows."""
        return f"{self.headline}\n{self.to_frame().to_string(index=False, na_rep='–')}"

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return f"<p>{escape(self.headline)}</p>\n{self.to_frame().to_html(index=False, escape=True, na_rep='–')}"


def new_axes(columns: int) -> list[Any]:
    """So many matplotlib axes beside each other, in a figure that a notebook shows."""
    from matplotlib import pyplot

    _, grid = pyplot.subplots(1, columns, figsize=(4.2 * columns, 3.2), layout="constrained", squeeze=False)
    return list(grid[0])


def draw_curves(
    axes: Any, x: Sequence[float], curves: Mapping[str, Sequence[Sequence[float]]], labels: tuple[str, str]
) -> None:
    """Lines with bands.

    Args:
        axes: matplotlib axes.
        x: (N,).
        curves: by name, values (N,) and, where they are known, lower and upper limits (N,) of them.
        labels: of the two axes, with units.
    """
    dashes = ("-", "--", "-.", ":")
    for (name, (values, *limits)), dash in zip(curves.items(), dashes * len(curves), strict=False):
        (line,) = axes.plot(x, values, dash, marker=".", label=name)
        if len(limits) == 2 and all(map(len, limits)):
            axes.fill_between(x, *limits, color=line.get_color(), alpha=0.15, linewidth=0)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend()


def draw_bars(
    axes: Any, names: Sequence[str], series: Mapping[str, Sequence[float]], label: str, spans: Any = None
) -> None:
    """Horizontal bars, the first on top, a bar a series beside each other.

    Args:
        axes: matplotlib axes.
        names: (N,) of the groups of bars.
        series: by name, lengths (N,) of the bars.
        label: of the length, with its unit.
        spans: (2, N) lower and upper limits where there is one series.
    """
    place, height = np.arange(len(names)), 0.8 / max(1, len(series))
    for i, (name, values) in enumerate(series.items()):
        errors = None if spans is None else np.abs(np.asarray(spans) - np.asarray(values))
        axes.barh(place + i * height, values, height, label=name, xerr=errors)
    axes.set_yticks(place + 0.4 - height / 2, names)
    axes.invert_yaxis()
    axes.set_xlabel(label)
    axes.grid(axis="x", alpha=0.3)
    if len(series) > 1:
        axes.legend()
    if not names:
        axes.text(0.5, 0.5, "nothing", ha="center", transform=axes.transAxes, color="0.4")
