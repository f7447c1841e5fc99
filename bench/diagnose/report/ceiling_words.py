"""What a network leaves, in sentences. Plain text, not escaped."""

from collections.abc import Sequence

from bench.diagnose.evidence import Predictable
from bench.diagnose.report.phrases import lasting, listed, named, number, shown, united

_BY = {
    "missing": "A network on the same history and inputs brings {each}: something is still missing, in {where}.",
    "slow": "A network on the same history and inputs brings {each}, not surely better than a disturbance observer "
    "would: what it predicts may be slow and follow no signal.",
    "autoregression": "A network on the same history and inputs brings {each}, not surely better than a linear "
    "autoregression that sees no inputs: what it knows may be how a controller brings the state back, and no physics.",
    "little": "A network on the same history and inputs brings {each}: little is left to learn from these signals.",
    "open": "A network on the same history and inputs brings {each}: these recordings do not tell how much of what is "
    "left could be learned.",
    "worse": "A network does worse, it brings {each}: nothing follows from that.",
}
"""By finding, in the order of telling."""


Row = tuple[str, list[str], str]
"""An output with its horizon and unit, the errors of its `Predictable.lines`, and what follows."""
_SHORT = {
    "missing": "something is missing",
    "slow": "may be slow",
    "autoregression": "may be the controller",
    "little": "little is left",
    "open": "not told",
    "worse": "nothing follows",
}


def row(f: Predictable) -> Row:
    """A line of the table of single axes."""
    unit, factor = shown(f.unit, f.group.partition(".")[0], f.errors)
    said = f"{named(f.group)} after {lasting(f.horizon_s)} [{unit}]"
    return said, [number(e * factor) for e in f.errors], _SHORT[f.finding]


def sentences(found: Sequence[Predictable]) -> list[str]:
    """One for every finding that some group with an equation of its own has."""
    out = []
    for finding, text in _BY.items():
        of = [f for f in found if f.own and f.finding == finding]
        if of:
            out.append(text.format(each=listed(map(_fall, of)), where=listed(map(_place, of))))
    return out


def _fall(f: Predictable) -> str:
    """Such as "velocity after 0.5 s from 0.821 to 0.527 m/s (floor 0.0262)"."""
    unit, factor = shown(f.unit, f.group, [f.model, f.network])
    before, after, floor = (number(e * factor) for e in (f.model, f.network, f.floor))
    return f"{named(f.group)} after {lasting(f.horizon_s)} from {before} to {united(after, unit)} (floor {floor})"


def _place(f: Predictable) -> str:
    """Such as "body rates p and q": the channels, or the group where it is all of it."""
    if not f.axes:
        return named(f.group)
    return f"{named(f.group)} {listed(axis.partition('.')[2] or axis for axis in f.axes)}"
