"""Figures of a study: error of every prediction step, drawn so that colour is never the only difference."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import pandas as pd
import seaborn as sns
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bench.analysis.tables import (
    horizons,
    is_baseline,
    named,
    norm_of,
    predicts,
    quantities,
    sound,
    specs,
    whole_signals,
)
from bench.records.record import RunRecord
from bench.reporting.white_grid import WHITE_GRID

# Okabe and Ito's palette for all kinds of colour vision, darkest contrasts first; yellow is too pale on white
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
DASHES: tuple[tuple[float, ...], ...] = ((), (5, 1.6), (1.2, 1.2), (6, 1.5, 1.2, 1.5), (9, 2), (3, 1, 1, 1, 1, 1))
GREYS = (("#6e6e6e", (1.0, 1.6)), ("#6e6e6e", (6.0, 2.0)), ("#a8a8a8", ()))
PANELS = 4
"""Channels beyond which signals of three axes are drawn instead."""
BOXES = 40
"""Boxes beyond which steps are left out, evenly."""
STYLE: Any = {
    **WHITE_GRID,
    "axes.edgecolor": "0.6",
    "axes.labelsize": 9,
    "axes.titlesize": 9.5,
    "figure.dpi": 150,
    "font.size": 9,
    "grid.color": "0.91",
    "svg.fonttype": "path",
    "svg.hashsalt": "multistep-bench",  # the same records give the same file
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
}


def per_step_figure(records: Sequence[RunRecord], path: Path) -> list[Path]:
    """Mean error of every prediction step (paper, figure HeliCompare): one column an output, one row a horizon.

    A curve is the mean over seeds, its band runs from the best to the worst seed. The axis fits the networks;
    a baseline may leave it, which the legend says.

    Args:
        records: runs of one study; diverged ones are left out and counted in the legend.
        path: where to write; both ``.png`` and ``.svg`` are written.

    Returns:
        The files written.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure()
        draw_per_step(records, figure)
        return _save(figure, path)


def draw_per_step(records: Sequence[RunRecord], figure: Figure) -> None:
    """Draw what `per_step_figure` writes, into a figure that is empty."""
    shown = principal(quantities(records))
    styles, lost, outside = looks(specs(records)), _diverged(records), set()
    rows = horizons(records)
    with matplotlib.rc_context(STYLE):
        figure.set_size_inches(max(2.9 * len(shown), 4.6), 2.3 * len(rows) + 0.35)
        figure.set_layout_engine("constrained")
        grid = figure.subplots(len(rows), len(shown), squeeze=False)
        for i, horizon in enumerate(rows):
            for j, quantity in enumerate(shown):
                axes = grid[i, j]
                curves, unit = _curves(records, quantity, horizon)
                if curves.empty:
                    axes.text(0.5, 0.5, "no finished run", ha="center", transform=axes.transAxes, color="0.4")
                else:
                    outside |= _draw(axes, curves, styles)
                axes.set_title(f"{title(quantity)}, T = {horizon}")
                axes.set(xlabel="time after k0 [s]" if i == len(rows) - 1 else "", ylabel="")
                if j == 0 or unit != _curves(records, shown[j - 1], horizon)[1]:
                    axes.set_ylabel(f"mean |error| [{unit}]")
        handles: list[Artist] = [
            Line2D([], [], color=c, dashes=d or (None, None), linewidth=w, label=_label(s, lost, outside))
            for s, (c, d, w) in styles.items()
        ]
        if len({r.summary["seed"] for r in records}) > 1:
            handles.append(Patch(color="0.82", label="band: best to worst seed"))
        figure.legend(
            handles=handles,
            loc="outside lower center",
            ncols=2 if len(shown) < 3 else 3,
            frameon=False,
            handlelength=3.2,
            fontsize=8.5,
        )


def box_figure(record: RunRecord, path: Path) -> list[Path]:
    """Distribution of one run's error at every step: median, quartiles (box), 5 to 95 % (whiskers), 99 % (dots).

    Args:
        record: a finished run.
        path: where to write; both ``.png`` and ``.svg`` are written.

    Returns:
        The files written.
    """
    shown = principal(quantities([record]))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(max(3.2 * len(shown), 5.6), 3.1), layout="constrained")
        for axes, quantity in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
            t = record.steps
            t = t[(t.quantity == quantity) & (t.norm == norm_of(record, quantity))]
            unit, wide = t["unit"].iloc[0], t.pivot(index="time_s", columns="statistic", values="value")
            every = -(-len(wide) // BOXES)
            wide = wide.iloc[every - 1 :: every]
            pitch = wide.index[0] / every * every
            boxes = [
                {"med": r["median"], "q1": r["q25"], "q3": r["q75"], "whislo": r["q05"], "whishi": r["q95"]}
                for _, r in wide.iterrows()
            ]
            axes.bxp(
                boxes,
                positions=list(wide.index),
                widths=0.6 * pitch,
                showfliers=False,
                manage_ticks=False,
                patch_artist=True,
                boxprops={"facecolor": "#56B4E9", "edgecolor": "#0072B2", "linewidth": 0.7},
                medianprops={"color": "black", "linewidth": 1.2},
                whiskerprops={"color": "#0072B2", "linewidth": 0.7},
                capprops={"color": "#0072B2", "linewidth": 0.7},
            )
            axes.plot(wide.index, wide["q99"], ".", color="#D55E00", markersize=3)
            axes.set_title(title(quantity))
            axes.set(xlabel="time after k0 [s]", ylabel=f"|error| [{unit}]", ylim=(0, None))
            axes.grid(axis="x", visible=False)
        figure.suptitle(f"{record.summary['spec']}, seed {record.summary['seed']}", fontsize=9.5)
        handles = [
            Line2D([], [], color="black", linewidth=1.2, label="median"),
            Line2D([], [], color="#56B4E9", linewidth=6, label="25 to 75 %"),
            Line2D([], [], color="#0072B2", linewidth=0.9, label="5 to 95 %"),
            Line2D([], [], color="#D55E00", marker=".", linestyle="", label="99 %"),
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=8.5)
        return _save(figure, path)


def principal(names: list[str]) -> list[str]:
    """The channels, or where they are many the signals of three axes (and whatever belongs to none)."""
    signals = whole_signals(names)
    channels = [n for n in names if n not in signals]
    if len(channels) <= PANELS or not signals:
        return channels
    return signals + [c for c in channels if c.partition(".")[0] not in signals]


def title(quantity: str) -> str:
    """ "body_rates_forced.p" → "body rates p (forced)"."""
    return named(quantity).replace("_", " ").replace(".", " ")


def looks(names: Sequence[str]) -> dict[str, tuple[str, tuple[float, ...], float]]:
    """Configuration → colour, dashes, line width."""
    networks = [s for s in names if not is_baseline(s)]
    baselines = sorted(s for s in names if is_baseline(s))
    styles = {
        s: (COLOURS[i % len(COLOURS)], DASHES[(i + i // len(COLOURS)) % len(DASHES)], 1.5)
        for i, s in enumerate(networks)
    }
    return styles | {s: (*GREYS[i % len(GREYS)], 1.2) for i, s in enumerate(baselines)}


def _diverged(records: Sequence[RunRecord]) -> dict[str, int]:
    """Runs of each configuration that cannot be drawn."""
    return {s: sum(r.summary["spec"] == s and not sound(r) for r in records) for s in specs(records)}


def _curves(records: Sequence[RunRecord], quantity: str, horizon: int) -> tuple[pd.DataFrame, str]:
    """Long table spec, seed, time_s, value of the mean error, and its unit."""
    tables = [pd.DataFrame(columns=["spec", "seed", "time_s", "value", "unit"])]
    for r in records:
        if r.summary["horizon"] == horizon and predicts(r, quantity) and sound(r):
            t = r.steps
            t = t[(t.quantity == quantity) & (t.norm == norm_of(r, quantity)) & (t.statistic == "mean")]
            tables.append(t[["time_s", "value", "unit"]].assign(spec=r.summary["spec"], seed=r.summary["seed"]))
    joined = pd.concat(tables[1:] or tables, ignore_index=True)
    return joined, "" if joined.empty else str(joined["unit"].iloc[0])


def _draw(axes: Axes, curves: pd.DataFrame, styles: dict[str, tuple[str, tuple[float, ...], float]]) -> set[str]:
    """One panel; returns the configurations that leave it."""
    present = [s for s in styles if s in set(curves["spec"])]
    sns.lineplot(
        curves,
        x="time_s",
        y="value",
        hue="spec",
        style="spec",
        size="spec",
        hue_order=present,
        palette={s: styles[s][0] for s in present},
        dashes={s: styles[s][1] or "" for s in present},
        sizes={s: styles[s][2] for s in present},
        errorbar=("pi", 100),
        err_kws={"alpha": 0.13, "linewidth": 0},
        legend=False,
        ax=axes,
    )
    peak = curves.groupby(["spec", "time_s"])["value"].mean().groupby("spec").max()
    networks = [s for s in present if not is_baseline(s)] or present
    top = 1.12 * float(peak[networks].max())
    axes.set_ylim(0, top)
    axes.set_xlim(0, float(curves["time_s"].max()))
    return {str(s) for s in peak.index if peak[s] > top}


def _label(spec: str, lost: dict[str, int], outside: set[str]) -> str:
    """Legend entry with what the curve does not show."""
    notes = [f"{lost[spec]} diverged"] if lost[spec] else []
    notes += ["leaves the axis"] if spec in outside else []
    return spec + (f" ({', '.join(notes)})" if notes else "")


def _save(figure: Figure, path: Path) -> list[Path]:
    """Write PNG and SVG, the latter without a date."""
    files = [path.with_suffix(".png"), path.with_suffix(".svg")]
    figure.savefig(files[0], dpi=150)
    figure.savefig(files[1], metadata={"Date": None})
    return files
