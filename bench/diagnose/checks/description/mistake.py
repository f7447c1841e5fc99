"""A mistake of reading, and the lines of dataset.toml that mend it."""

import json
from dataclasses import dataclass

from bench.diagnose.checks.description.recorded import Reading
from registry.datasets.folder.signals import SignalColumns


@dataclass(frozen=True)
class Mistake:
    """Something that dataset.toml says of all recordings and that is not so."""

    kind: str
    signal: str
    """The first of those concerned."""
    recordings: tuple[str, ...]
    """In which it shows."""
    detail: str
    """One sentence with figures."""
    mend: tuple[str, ...] = ()
    """Lines of dataset.toml as they should be."""
    stops: bool = True
    """Whether it spoils everything that follows."""
    reading: Reading | None = None
    """With the mistake mended, if a reading can be."""


def lines(before: Reading, after: Reading) -> tuple[str, ...]:
    """The lines of dataset.toml that differ."""
    out = [line(n, s) for n, s in after.signals.items() if s != before.signals.get(n)]
    if after.positions != before.positions:
        out.append(f"rotor_positions = {json.dumps(after.positions)}")
    if after.directions != before.directions:
        out.append(f"rotor_directions = {json.dumps([int(s) if s == int(s) else s for s in after.directions])}")
    return tuple(out)


def line(name: str, signal: SignalColumns) -> str:
    """A signal as dataset.toml has it."""
    parts = [f"columns = {json.dumps(list(signal.columns), ensure_ascii=False)}", f'unit = "{signal.unit}"']
    parts += [f'{k} = "{getattr(signal, k)}"' for k in ("convention", "frame", "gravity") if getattr(signal, k)]
    parts += [f"delay_s = {signal.delay:.4g}"] if signal.delay else []
    parts += [f"turned_deg = {json.dumps(list(signal.turned))}"] if signal.turned else []
    return f"{name} = {{{', '.join(parts)}}}"
