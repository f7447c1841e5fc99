"""A claim of the paper as data: ``results/paper/claims.toml``, read and checked."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.claims.estimate import Kind, number
from bench.claims.kinds import comparing, counting, curves, levels
from bench.claims.kinds.counting import Fact
from registry.errors import BenchError, near
from registry.regular_file import read_toml

FILE = Path("results", "paper", "claims.toml")
"""Of the checkout that this code belongs to."""
KINDS: dict[str, type[Kind] | type[Fact]] = {
    "ratio": comparing.Ratio,
    "alike": comparing.Alike,
    "factor": comparing.Factor,
    "fewer_weights": comparing.FewerWeights,
    "norms": comparing.Norms,
    "convergence": comparing.Convergence,
    "level": levels.Level,
    "quantile": levels.Quantile,
    "early_peak": curves.EarlyPeak,
    "growth": curves.Growth,
    "history_spread": curves.HistorySpread,
    "peak_shrinks": curves.PeakShrinks,
    "diverged": counting.Diverged,
    "samples": counting.Samples,
    "hours": counting.Hours,
    "maxima": counting.Maxima,
}
SCOPES = ("comparative", "dataset")


@dataclass(frozen=True)
class Claim:
    """One sentence of the paper and how it is judged."""

    id: str
    text: str
    """In our words, one sentence."""
    source: str
    """Section, figure or table of the paper."""
    scope: str
    """"dataset": a number of the paper's own recordings; "comparative": may hold on any."""
    kind: Kind | Fact
    accept: tuple[float, float]
    """What reproduces it: written before the claim was first run."""
    needs: str = ""
    """The data set that a dataset-bound claim is about."""
    study: str = ""
    """The study that settles it; empty where the recordings alone do."""
    published: float | None = None
    """The paper's value, in ``unit``."""
    unit: str = ""
    note: str = ""

    @property
    def stated(self) -> str:
        """What the paper publishes, else what the claim amounts to, in a few characters."""
        if self.published is not None:
            return f"{number(self.published)} {self.unit}".strip()
        low, high = self.accept
        if math.isinf(high):
            return f"above {low:g}"
        return f"below {high:g}" if low <= 0 else f"{low:g} to {high:g}"


@dataclass(frozen=True)
class Claims:
    """The file."""

    claims: tuple[Claim, ...]
    paper_specs: frozenset[str]
    """Configurations of the sizes that the paper trained; a verdict on others is labelled."""


def checkout() -> Path:
    """The checkout: where this package lies, or the working directory where it was installed elsewhere."""
    beside = Path(__file__).parents[2]
    return beside if (beside / FILE).is_file() else Path()


def read(path: Path | None = None) -> Claims:
    """The claims of ``path``, by default those of the `checkout`.

    Raises:
        BenchError: no such file, or what is wrong in it.
    """
    path = path or checkout() / FILE
    content = read_toml(path, "work in the checkout, or name a file of claims with --claims")
    entries, specs = content.get("claim", []), content.get("paper_specs", [])
    if not isinstance(entries, list) or not isinstance(specs, list) or not all(isinstance(s, str) for s in specs):
        raise BenchError(f"{path.name}: claims must be tables, [[claim]], and paper_specs a list of texts.")
    claims = tuple(_claim(entry, f"{path.name}, claim {i + 1}") for i, entry in enumerate(entries))
    if not claims:
        raise BenchError(f"{path} holds no [[claim]].")
    twice = {c.id for c in claims if sum(c.id == d.id for d in claims) > 1}
    if twice:
        raise BenchError(f"{path.name}: two claims are called {min(twice)!r}.")
    return Claims(claims, frozenset(specs))


def _claim(entry: Any, where: str) -> Claim:
    if not isinstance(entry, dict):
        raise BenchError(f"{where} must be a table of keys.")
    entry = dict(entry)
    judge = entry.pop("judge", None)
    name = str(judge.get("kind") if isinstance(judge, dict) else judge)
    if not isinstance(judge, dict) or name not in KINDS:
        raise BenchError(f"{where}: judge has no kind {name!r}: {near(name, KINDS)}")
    kind = _build(KINDS[name], {k: v for k, v in judge.items() if k != "kind"}, f"{where}, judge")
    claim: Claim = _build(Claim, {**entry, "kind": kind}, where)
    if claim.scope not in SCOPES:
        raise BenchError(f"{where}: there is no scope {claim.scope!r}: {near(str(claim.scope), SCOPES)}")
    if (claim.scope == "dataset") != bool(claim.needs):
        raise BenchError(f"{where}: `needs` names the data set of a dataset-bound claim, and of no other.")
    if len(claim.accept) != 2 or not all(map(_number, claim.accept)) or not claim.accept[0] <= claim.accept[1]:
        raise BenchError(f"{where}: accept must be [lowest, highest].")
    if isinstance(kind, Kind) != bool(claim.study):
        raise BenchError(f"{where}: `study` names the study that settles it, unless the recordings alone do.")
    return claim


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _build(kind: type, values: Mapping[str, Any], where: str) -> Any:
    known = {f.name: f for f in dataclasses.fields(kind)}
    for name in values:
        if name not in known:
            raise BenchError(f"{where} has no key {name!r}: {near(name, known)}")
    for f in known.values():
        if f.default is dataclasses.MISSING and f.name not in values:
            raise BenchError(f"{where}: {f.name} is missing.")
        value = values.get(f.name)
        if value is not None and not _fits(value, str(f.type)):
            raise BenchError(f"{where}: {f.name} = {value!r} is of the wrong type.")
    return kind(**{name: _frozen(value) for name, value in values.items()})


def _fits(value: Any, annotation: str) -> bool:
    """Whether a TOML value is text, a list or a number where the field wants one."""
    if "tuple" in annotation:
        return isinstance(value, list)
    if "str" in annotation:
        return isinstance(value, str)
    return not isinstance(value, str | list | dict)


def _frozen(value: Any) -> Any:
    return tuple(map(_frozen, value)) if isinstance(value, list) else value
