"""What is in a data set and what cleaning did to it, as plain data."""

from typing import Any

from registry.contracts import Dataset, Finding
from registry.units import display

_COUNTED = ("dropped", "held", "spike", "gap", "trimmed")


def inspect(dataset: Dataset) -> tuple[list[dict[str, Any]], list[Finding]]:
    """A row for every recording that was read, and all findings.

    A row: name, samples, rate [Hz], seconds, invalid samples, samples "dropped", "held", "spike", "gap" and
    "trimmed", gaps (how many), lag [samples] or None, the recording it duplicates or None, and per channel of
    ``ranges`` its least and greatest valid value with the unit of reports. Recordings that were left out have
    samples 0 and no ranges.

    Raises:
        BenchError: see `Dataset.load`.
    """
    loaded = dataset.load()
    recordings = {r.name: r for r in loaded.recordings}
    findings: dict[str, list[Finding]] = {name: [] for name in recordings}
    for finding in loaded.findings:
        findings.setdefault(finding.recording, []).append(finding)
    rows = []
    for name, found in findings.items():
        r = recordings.get(name)
        if r is None and not any(f.kind in ("short", "duplicate") for f in found):
            continue  # a finding about the whole set
        row: dict[str, Any] = {
            "name": name,
            "samples": len(r) if r else 0,
            "rate": r.rate if r else None,
            "seconds": r.seconds if r else 0.0,
            "invalid": int((~r.valid).sum()) if r else 0,
        }
        row |= {kind: int(sum(f.count for f in found if f.kind == kind)) for kind in _COUNTED}
        row["gaps"] = sum(f.kind == "gap" for f in found)
        row["lag"] = next((f.count for f in found if f.kind == "lag"), None)
        row["duplicate"] = next((f.detail for f in found if f.kind == "duplicate"), None)
        row["ranges"] = {}
        if r is not None and r.valid.any():
            values, channels = r.pick([c.name for c in r.channels])
            for channel, low, high in zip(
                channels, values[r.valid].min(axis=0), values[r.valid].max(axis=0), strict=True
            ):
                unit, factor = display(channel.unit, channel.group)
                row["ranges"][channel.name] = (float(low * factor), float(high * factor), unit)
        rows.append(row)
    return sorted(rows, key=lambda row: row["name"]), list(loaded.findings)
