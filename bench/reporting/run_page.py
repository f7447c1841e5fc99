"""One run as an HTML page that needs no network: its error at every prediction step."""

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from bench.analysis.tables import named
from bench.records.record import RunRecord
from bench.reporting import page
from bench.reporting.drawing import Look, Panel, Scale, around
from bench.reporting.page import Drawing, Section

MEAN, Q95 = Look("#0072B2", (), 2.0), Look("#0072B2", (4, 2), 1.2)
LINES = ((MEAN, "mean"), (Look("#0072B2", (), 9.0, 0.14), "25 % to 75 %"), (Q95, "95 %"))


@dataclass(frozen=True)
class Drawn:
    """Drawings, and what their lines mean."""

    legend: Sequence[tuple[Look, str]]
    drawings: Sequence[Drawing]


def distinct(steps: pd.DataFrame) -> pd.DataFrame:
    """`RunRecord.steps` without the norms of signals of which one axis is predicted: they equal that axis."""
    groups = steps.quantity[steps.norm == "axis"].drop_duplicates().str.rpartition(".")[0]
    single = groups[~groups.duplicated(keep=False)]
    return steps[(steps.norm == "axis") | ~steps.quantity.isin(single)]


def render(record: RunRecord) -> str:
    """The page of a run that did not diverge: a drawing a quantity, with mean, quartile band and 95 % quantile."""
    s = record.summary
    drawn = []
    for (quantity, norm), rows in distinct(record.steps).groupby(["quantity", "norm"], sort=False):
        by = {str(name): part.value.to_numpy() for name, part in rows.groupby("statistic", sort=False)}
        time, unit = rows.time_s.to_numpy()[: s["horizon"]], rows.unit.iloc[0]
        top = around([*by["mean"], *by["q75"], *by["q95"]], zero=True)
        made = Panel(Scale(0.0, time[-1]), top, "time after k0 [s]", f"|error| [{unit}]", 340, 215)
        made.band(time, by["q25"], by["q75"], MEAN.colour)
        made.line(time, by["mean"], MEAN)
        made.line(time, by["q95"], Q95)
        name, note = named(str(quantity)), "" if norm == "axis" else f"{norm} norm"
        drawn.append(Drawing(name, note, made.svg(f"Error of {name} at every step")))
    return page.render(
        page.shared(),
        "run.html.j2",
        f"{s['spec']}, {s['dataset']}",
        [Section("Error of every prediction step", "steps", Drawn(LINES, drawn))],
        facts=f"T = {s['horizon']}, seed {s['seed']}, {s['windows']['test']} test windows",
        key=record.key,
    )
