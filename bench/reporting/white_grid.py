"""How figures look before they say otherwise: white, with a pale grid and no ticks (seaborn's "whitegrid")."""

from typing import Any

import matplotlib

WHITE_GRID: Any = {
    # a matplotlibrc in the working directory has no say: it may ask for other programs
    **{k: v for k, v in matplotlib.rcParamsDefault.items() if k != "backend"},
    "axes.axisbelow": True,
    "axes.edgecolor": ".8",
    "axes.grid": True,
    "axes.labelcolor": ".15",
    "font.family": ["sans-serif"],
    "font.sans-serif": ["Arial", "DejaVu Sans", "Liberation Sans", "Bitstream Vera Sans", "sans-serif"],
    "grid.color": ".8",
    "lines.solid_capstyle": "round",
    "patch.edgecolor": "w",
    "patch.force_edgecolor": True,
    "text.color": ".15",
    "xtick.bottom": False,
    "xtick.color": ".15",
    "ytick.color": ".15",
    "ytick.left": False,
}
