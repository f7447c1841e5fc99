"""What a fleet says: every vehicle's answer, the mean and spread of each number, who differs and who drifts."""

import datetime
import json
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from bench.analysis.display import Displayed
from bench.diagnose.report.phrases import listed, named
from bench.diagnose.result import finite

RATE = 0.05
"""Of the vehicles that are said to differ, and of the drifts that are told, at most so many are expected to be wrong:
a false discovery rate, Benjamini and Hochberg."""
DAYS = 365.25
"""Of a year."""
UNKNOWN = "unknown_effect"
"""In place of an id, of what the catalogue does not have."""
FAILED = "failed"
"""In place of a verdict where there is none."""


@dataclass(frozen=True)
class Number:
    """A parameter of an effect that one vehicle lacks, SI."""

    effect: str
    """Its id; of a learned term what it follows, too."""
    parameter: str
    value: float
    low: float
    high: float
    """Of the 95 % interval; NaN: there is none."""
    unit: str
    rivals: tuple[str, ...] = ()
    """Effects that explain these data as well."""
    learned: bool = False

    @property
    def usable(self) -> bool:
        """Whether it can be compared: fitted, of an effect of the catalogue, with an interval."""
        finite = math.isfinite(self.value) and math.isfinite(self.high - self.low)
        return not self.learned and finite and self.high > self.low

    @property
    def quantity(self) -> tuple[str, str, str]:
        """Effect, parameter and unit."""
        return self.effect, self.parameter, self.unit


@dataclass(frozen=True)
class ErrorBetween:
    """Held-out error of free runs of one group of outputs, SI."""

    group: str
    unit: str
    horizon_s: float
    nominal: float
    extended: float
    floor: float


@dataclass(frozen=True)
class Answer:
    """What was found in the recordings of one vehicle, of one day where they are dated."""

    id: str
    vehicle: str
    date: str
    """Such as 2026-03-01; empty: nobody said."""
    system: str
    verdict: str
    """One of `bench.diagnose.result.VERDICTS`, or "failed"."""
    sentence: str
    """Why there is no answer, or what is wrong with the data; empty: nothing is."""
    page: str
    """Of the vehicle, from the folder of the fleet's page; empty: there is none."""
    numbers: tuple[Number, ...] = ()
    errors: tuple[ErrorBetween, ...] = ()

    @property
    def title(self) -> str:
        """Vehicle and date."""
        return ", ".join(filter(None, (self.vehicle, self.date)))

    @property
    def effects(self) -> list[str]:
        """Those that it lacks, each once; what no catalogue has is one of them."""
        known = [UNKNOWN if n.learned else n.effect for n in self.numbers]
        return list(dict.fromkeys([*known, *([UNKNOWN] if self.verdict == "unknown_effect" else [])]))


@dataclass(frozen=True)
class Deviation:
    """The number of one vehicle against those of all others, SI."""

    vehicle: str
    value: float
    low: float
    high: float
    others: float
    """Their mean."""
    p: float
    """Two-sided, of the vehicle alone; NaN: the others are too few."""
    adjusted: float = math.nan
    """Among all such tests in the fleet."""

    @property
    def differs(self) -> bool:
        """Whether it is told as one that does."""
        return self.adjusted <= RATE


@dataclass(frozen=True)
class Quantity:
    """One parameter over all vehicles that lack its effect, SI."""

    system: str
    effect: str
    parameter: str
    unit: str
    mean: float
    low: float
    high: float
    """Of the 95 % interval of the mean; NaN: one vehicle has it."""
    between: float
    """Standard deviation between vehicles, beyond what their own intervals explain."""
    heterogeneity: float
    """Chance of so large a spread were there nothing between vehicles."""
    vehicles: tuple[Deviation, ...]


@dataclass(frozen=True)
class Drift:
    """How a number moves over dates: of one vehicle, or from vehicle to vehicle."""

    vehicle: str
    """Empty: over the vehicles of the fleet that have one date each."""
    system: str
    effect: str
    parameter: str
    unit: str
    per_year: float
    """Slope, in the unit per year of 365.25 days."""
    low: float
    high: float
    """Of its 95 % interval."""
    level: float
    """Value at the mean date."""
    dates: tuple[str, ...]
    """Of the estimates, in order."""
    p: float
    adjusted: float = math.nan
    """Among all drifts that were looked for."""

    @property
    def drifts(self) -> bool:
        """Whether it is told as one."""
        return self.adjusted <= RATE


def day(date: str) -> int:
    """Days from a fixed one to 2026-03-01."""
    return datetime.date.fromisoformat(date).toordinal()


@dataclass(frozen=True, eq=False)
class FleetDiagnosis(Displayed):
    """The answer of `bench diagnose FLEET`."""

    name: str
    answers: tuple[Answer, ...]
    """By vehicle and date."""
    quantities: tuple[Quantity, ...]
    drifts: tuple[Drift, ...]
    """All that were looked for."""
    notes: tuple[str, ...] = ()
    kind: str = "vehicle"
    """What its members are: vehicles, or recordings of one folder."""
    folder: Path = field(default_factory=Path)
    """Where the page, fleet.json and the vehicles' own pages are."""

    @property
    def vehicles(self) -> list[str]:
        """Their names."""
        return list(dict.fromkeys(a.vehicle for a in self.answers))

    @property
    def lacking(self) -> Counter[str]:
        """By effect, how many vehicles lack it; the commonest first."""
        pairs = dict.fromkeys((a.vehicle, e) for a in self.answers for e in a.effects)
        return Counter(dict(Counter(e for _, e in pairs).most_common()))

    @property
    def differing(self) -> list[tuple[Quantity, Deviation]]:
        """Numbers of vehicles that differ from the others', the surest first."""
        found = [(q, d) for q in self.quantities for d in q.vehicles if d.differs]
        return sorted(found, key=lambda pair: pair[1].p)

    @property
    def drifting(self) -> list[Drift]:
        """The surest first."""
        return sorted((d for d in self.drifts if d.drifts), key=lambda d: d.p)

    def behind(self, drift: Drift) -> list[tuple[Answer, Number]]:
        """The dated numbers that a drift rests on."""
        what = drift.effect, drift.parameter, drift.unit
        times = Counter(
            (a.vehicle, n.quantity) for a in self.answers for n in a.numbers if a.date and a.system == drift.system
        )
        return [
            (a, n)
            for a in self.answers
            for n in a.numbers
            if a.date and a.system == drift.system and n.quantity == what and n.usable
            if (a.vehicle == drift.vehicle if drift.vehicle else times[a.vehicle, what] == 1)
        ]

    def of(self, *verdicts: str) -> list[Answer]:
        """Those with one of these verdicts."""
        return [a for a in self.answers if a.verdict in verdicts]

    @property
    def headline(self) -> str:
        """How many vehicles lack what, differ and drift."""
        count = len(self.vehicles)
        shown = {e: "something that the catalogue does not have" if e == UNKNOWN else named(e) for e in self.lacking}
        said = [f"{n} {'lacks' if n == 1 else 'lack'} {shown[e]}" for e, n in self.lacking.items()]
        if len(said) > 4:
            said = [*said[:3], f"{len(said) - 3} more effects are missing here and there"]
        parts = [f"Of {count} {self.kind}s {listed(said or ['none is shown to lack an effect'])}"]
        if differ := len({d.vehicle for _, d in self.differing}):
            parts.append(f"{differ} {'differs' if differ == 1 else 'differ'} from the others in a number")
        if drift := len({d.vehicle for d in self.drifting if d.vehicle}):
            parts.append(f"{drift} {'drifts' if drift == 1 else 'drift'} over dates")
        if left := len({a.vehicle for a in self.of(FAILED, "data_problem")}):
            parts.append(f"{left} {'has' if left == 1 else 'have'} no answer yet")
        return "; ".join(parts) + "."

    def to_frame(self) -> pd.DataFrame:
        """One row a vehicle (and date) and parameter; one without numbers for a vehicle that lacks nothing or failed.

        Returns:
            vehicle, date, verdict, effect, parameter, value, low, high (95 %, SI), unit, others (mean of the other
            vehicles), adjusted_p (that it differs from them), differs.
        """
        held = {(d.vehicle, q.effect, q.parameter, q.unit): d for q in self.quantities for d in q.vehicles}
        rows: list[tuple[Any, ...]] = []
        for a in self.answers:
            for n in a.numbers:
                d = held.get((a.vehicle, *n.quantity))
                found = (d.others, d.adjusted, d.differs) if d else (math.nan, math.nan, False)
                rows.append(
                    (a.vehicle, a.date, a.verdict, n.effect, n.parameter, n.value, n.low, n.high, n.unit, *found)
                )
            if not a.numbers:
                rows.append((a.vehicle, a.date, a.verdict, "", "", *[math.nan] * 3, "", math.nan, math.nan, False))
        heads = "vehicle date verdict effect parameter value low high unit others adjusted_p differs"
        return pd.DataFrame(rows, columns=heads.split())

    def to_json(self) -> dict[str, Any]:
        """What ``fleet.json`` holds, as ``schema.json`` describes it; a number that does not exist is None."""
        told: Mapping[str, Any] = {
            "fleet": self.name,
            "kind": self.kind,
            "false_discovery_rate": RATE,
            "vehicles": [asdict(a) for a in self.answers],
            "quantities": [
                {**asdict(q), "vehicles": [{**asdict(d), "differs": d.differs} for d in q.vehicles]}
                for q in self.quantities
            ],
            "drifts": [{**asdict(d), "drifts": d.drifts} for d in self.drifts],
            "notes": list(self.notes),
        }
        values: dict[str, Any] = finite(dict(told))
        return values

    def json_text(self) -> str:
        """`to_json` as text."""
        return json.dumps(self.to_json(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of `FleetDiagnosis.to_json`."""
    read: dict[str, Any] = json.loads(Path(__file__).with_name("schema.json").read_text(encoding="utf-8"))
    return read
