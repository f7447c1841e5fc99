"""What a diagnosis says: the contract that `schema.json` describes."""

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from bench.analysis.display import Displayed
from bench.diagnose.by_equation import ConstantEstimate, EffectSaving, EquationResult
from bench.diagnose.evidence import Evidence, plot_curves
from bench.diagnose.learned_shape import LearnedShape
from registry.atomic_io import replacing
from registry.errors import BenchError, near

if TYPE_CHECKING:
    from matplotlib.axes import Axes

KINDS = (
    *("not finite", "quaternion", "frozen", "clipped", "spike", "clock jump", "clock rate", "clock offset", "slow log"),
    *("unit", "scale", "input scale", "gravity", "frame", "swapped sign", "swapped axes", "swapped signals"),
    *("inverse attitude", "quaternion order", "euler convention", "rotor order", "rotor directions", "rotor positions"),
    *("time shift", "no effect", "not stated", "mounting", "two levels", "disagreement", "unrelated", "standstill"),
)
"""What `DataProblem.kind` may be."""
VERDICTS = ("named", "tie", "nothing", "unknown_effect", "data_problem")


@dataclass(frozen=True)
class GroupError:
    """Root mean square error of one output group at one horizon of a free run on held-out recordings."""

    horizon_s: float
    rmse: float
    """SI; not finite where the free run diverged."""
    unit: str


ByGroup = dict[str, GroupError]


@dataclass(frozen=True)
class Errors:
    """Held-out errors of the three models."""

    nominal: ByGroup
    calibrated: ByGroup
    extended: ByGroup


@dataclass(frozen=True)
class ParameterEstimate:
    """A fitted parameter, SI, with its 95 % interval (NaN: there is none)."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class NamedEffect:
    """An effect in the extended model, in the order in which effects were added."""

    id: str
    parameters: dict[str, ParameterEstimate]
    share_explained: float
    """(E²_before − E²_after) / (E²_nominal − E²_floor), pooled over scaled outputs; E²_calibrated where larger."""
    error_before: ByGroup
    error_after: ByGroup
    indistinguishable_from: tuple[str, ...] = ()
    """Ids that explain these data as well; empty: the effect stands alone."""
    separate_by: str = ""
    """A sentence: the manoeuvre that would separate them."""
    acts_on: str = ""
    """The `EffectSaving.where` in which it saves most; empty: no equation was judged by itself."""
    learned: bool = False
    """Whether it is in no catalogue and was learned from what the catalogue leaves."""
    term: LearnedShape | None = None
    """Of a learned one: where it acts, what it follows and how."""
    saves: tuple[EffectSaving, ...] = ()
    """What it saves where it acts: in every equation by itself and along its axes; empty: none was judged."""
    by_recording: dict[str, dict[str, ParameterEstimate]] = field(default_factory=dict)
    """Parameters that differ from recording to recording; empty: there are none."""
    forecast_only: bool = False
    """Whether free runs alone ask for it: it makes forecasts better, and no equation by itself confirms it."""

    @property
    def found(self) -> bool:
        """Whether it is of the catalogue and was found: not learned, and not for forecasts only."""
        return not (self.learned or self.forecast_only)

    @property
    def main(self) -> EffectSaving | None:
        """What it saves where it saves most; None: no equation was judged by itself."""
        return next((s for s in self.saves if s.where == self.acts_on), None)

    @property
    def name(self) -> str:
        """The id, or of a learned term "world_force_x ~ position.x"."""
        return self.id if self.term is None else self.term.name

    @property
    def key(self) -> str:
        """As a name that any tracker takes."""
        if self.term is None:
            return self.id
        return ".".join((self.id, self.term.axis, *self.term.signals)).replace("+", " plus ").replace("-", " minus ")

    @property
    def described(self) -> str:
        """A learned term in a line."""
        return "" if self.term is None else self.term.described


@dataclass(frozen=True)
class DifferingEffect:
    """What recordings differ in: an effect, or several that act through each other, with numbers of each recording."""

    effects: tuple[str, ...]
    """Ids."""
    share: float
    """Of the squared error that one number for all recordings leaves where it acts, 0 to 1, on stretches not fitted."""
    by_recording: dict[str, dict[str, ParameterEstimate]]
    """Their parameters, as a linear regression on each recording tells them beside what all have in common."""
    rivals: tuple[str, ...] = ()
    """Ids of effects that explain nearly as much with numbers of each recording's own."""


@dataclass(frozen=True)
class Unexplained:
    """What the extended model leaves above the floor."""

    share: float
    """Of E² above the floor."""
    axes: tuple[str, ...] = ()
    """Channels in which something systematic is left, such as "velocity.z"."""
    follows: tuple[str, ...] = ()
    """Signals that it follows."""


@dataclass(frozen=True)
class Region:
    """Where the error is."""

    region: str
    """In physical terms, such as "speed > 2.8 m/s"."""
    share_of_error: float
    share_of_time: float
    recordings: tuple[str, ...]
    """Those in which the region is met."""


@dataclass(frozen=True)
class DataProblem:
    """Something that is wrong with a recording, not with the model."""

    recording: str
    signal: str
    kind: str
    """One of `KINDS`."""
    rows: tuple[int, int] | None
    """First and last sample of the recording, counted from 0; None: all of them."""
    detail: str
    """One sentence with figures and units."""


@dataclass(frozen=True)
class Diagnosis(Displayed):
    """The answer of `bench diagnose`."""

    dataset: str
    system: str
    verdict: str
    """One of `VERDICTS`."""
    noise_floor: ByGroup
    error: Errors
    effects: tuple[NamedEffect, ...]
    unexplained: Unexplained
    where: tuple[Region, ...]
    data_problems: tuple[DataProblem, ...]
    """What stopped the analysis, or else what is wrong with recordings that were left out."""
    evidence: Evidence = field(default_factory=Evidence, compare=False)
    by_equation: dict[str, EquationResult] = field(default_factory=dict)
    """By name, such as "forces"; empty: no equation could be judged by itself."""
    constants: dict[str, ConstantEstimate] = field(default_factory=dict)
    """Of the base model, by name."""
    disturbance_floor: ByGroup = field(default_factory=dict)
    """What the last model leaves that goes on with the disturbance which its own past tells; empty: none is known."""
    ceiling: ByGroup | None = None
    """What a network leaves that stands around the last model; None: it was not asked for."""
    differing: DifferingEffect | None = None
    """In what recordings differ so much that no one number holds for all; None: in nothing that shows."""

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise ValueError(f"verdict {self.verdict!r} is none of {', '.join(VERDICTS)}")

    @property
    def headline(self) -> str:
        """The data set, the verdict and the effects."""
        effects = ", ".join(e.id for e in self.effects) or "no effect"
        problems = "; ".join(dict.fromkeys(f"{p.kind} in {p.signal}" for p in self.data_problems))
        said = problems if self.verdict == "data_problem" else effects
        return f"{self.dataset} ({self.system}): {self.verdict}: {said}"

    def to_frame(self) -> pd.DataFrame:
        """The effects, one row a parameter.

        Returns:
            effect, parameter, value, low, high (95 %, SI), unit, share_explained (0 to 1), indistinguishable_from.
        """
        return effect_frame(
            (e.id, n, p.value, p.low, p.high, p.unit, e.share_explained, e.indistinguishable_from)
            for e in self.effects
            for n, p in e.parameters.items()
        )

    def plot(self) -> "list[Axes]":
        """Held-out error of the free runs against the horizon: matplotlib axes, one an output group."""
        return plot_curves(self.evidence.curves)

    def to_json(self) -> dict[str, Any]:
        """The contract as JSON values, without the evidence; a number that does not exist is None."""
        contract = asdict(self)
        del contract["evidence"]
        values: dict[str, Any] = finite(contract)
        return values

    def write(self, path: Path) -> None:
        """Write `to_json` to ``path``, whole or not at all.

        Raises:
            BenchError: the file cannot be written.
        """
        write_text(path, json.dumps(self.to_json(), indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def effect_frame(rows: Iterable[tuple[Any, ...]]) -> pd.DataFrame:
    """Effects with their parameters as a table; the columns are those of `Diagnosis.to_frame`."""
    heads = ("effect", "parameter", "value", "low", "high", "unit", "share_explained", "indistinguishable_from")
    return pd.DataFrame([(*row[:-1], ", ".join(row[-1])) for row in rows], columns=list(heads))


def check_kinds(names: Sequence[str]) -> None:
    """Raise `BenchError` where the data can have no problem of such a kind."""
    for name in names:
        if name not in KINDS:
            raise BenchError(f"--ignore-problem {name}: the data can have no such problem: {near(name, KINDS)}")


def schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of `Diagnosis.to_json`."""
    text = Path(__file__).with_name("schema.json").read_text(encoding="utf-8")
    read: dict[str, Any] = json.loads(text)
    return read


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all; its folder is made.

    Raises:
        BenchError: the file cannot be written.
    """
    try:
        with replacing(path) as draft:
            draft.write_text(text, encoding="utf-8", errors="replace", newline="\n")
    except OSError as error:
        raise BenchError(f"{path} cannot be written: {error.strerror or error}.") from error


def finite(value: Any) -> Any:
    """``value`` with None for every number that is not finite, in all its parts."""
    if isinstance(value, dict):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
