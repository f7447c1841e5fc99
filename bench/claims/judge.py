"""All claims against all evidence: a verdict each, corrected for how many there are."""

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from bench.claims.claim import Claim, Claims
from bench.claims.counting import Fact
from bench.claims.estimate import ALPHA, NOT_RUN, OPEN, Estimate, Judgement, number, settle
from bench.claims.evidence import Evidence
from bench.experiment import study
from bench.training.data import load
from registry.core import DATASETS
from registry.errors import BenchError

TWIN = "_twin"
"""What the name of a simulated data set ends with."""
STAND_IN = {"pelican": "pelican_twin", "stanford_helicopter": "helicopter_twin"}
"""The simulated data set beside one that may not be had."""


@dataclass(frozen=True)
class Row:
    """The verdict on one claim on one data set."""

    claim: Claim
    dataset: str
    label: str
    """Under what the evidence falls short of the paper: preset, reduced size, simulation."""
    judgement: Judgement
    command: str
    """What would settle it."""
    beside: str = ""
    """Values of a dataset-bound claim on other data."""


def judge(claims: Claims, evidence: Sequence[Evidence], facts: bool = True) -> list[Row]:
    """One row a claim and data set with evidence for it, real recordings first; at least one a claim.

    Verdicts on comparative claims of one data set share an error rate of 5 % (Holm 1979); dataset-bound claims, each
    a number of its own, are judged at 95 %.

    Args:
        claims: what to judge.
        evidence: of all studies.
        facts: read the recordings of dataset-bound claims about the data themselves (seconds).
    """
    ordered = sorted(evidence, key=lambda e: (e.dataset.endswith(TWIN), e.dataset))
    rows: dict[str, list[Row]] = {c.id: [] for c in claims.claims}
    for dataset in dict.fromkeys(e.dataset for e in ordered):
        here = {e.study: e for e in ordered if e.dataset == dataset}
        family = [c for c in claims.claims if c.scope == "comparative" and c.study in here]
        verdicts = holm([_judge(c, here[c.study]) for c in family])
        for claim, judgement in zip(family, verdicts, strict=True):
            if judgement.verdict != NOT_RUN:
                found = here[claim.study]
                label = _label(claims, claim, found)
                rows[claim.id].append(Row(claim, dataset, label, judgement, _command(claim, dataset, found.preset)))
    for claim in claims.claims:
        if claim.scope == "dataset":
            rows[claim.id].append(_bound(claims, claim, ordered, facts))
        elif not rows[claim.id]:
            rows[claim.id].append(Row(claim, "", "", Judgement(NOT_RUN), _command(claim)))
    return [row for found in rows.values() for row in found]


def _judge(claim: Claim, evidence: Evidence) -> Callable[[float], Judgement]:
    kind = claim.kind
    assert not isinstance(kind, Fact)
    return lambda alpha: settle(lambda a: kind.measure(evidence, a), claim.accept, alpha)


def holm(judges: Sequence[Callable[[float], Judgement]], alpha: float = ALPHA) -> list[Judgement]:
    """Holm's step-down procedure on verdicts instead of p-values: each verdict must stand at α over the open ones.

    The interval that is returned is always that at 1 − α; a verdict that stands alone but not among so many is open.
    """
    plain = [j(alpha) for j in judges]
    open_now = [i for i, p in enumerate(plain) if p.verdict not in (OPEN, NOT_RUN)]
    left = sum(p.verdict != NOT_RUN for p in plain)
    count = left
    while open_now:
        stands = [i for i in open_now if judges[i](alpha / left).verdict == plain[i].verdict]
        if not stands:
            break
        open_now = [i for i in open_now if i not in stands]
        left -= len(stands)
    for i in open_now:
        said = f"{plain[i].verdict} if it were the only claim, but not as one of {count}. {plain[i].basis}"
        plain[i] = replace(plain[i], verdict=OPEN, basis=said)
    return plain


def _label(claims: Claims, claim: Claim, evidence: Evidence) -> str:
    parts = ["simulated"] if evidence.dataset.endswith(TWIN) else []
    parts += [] if evidence.preset == "paper" else [evidence.preset]
    patterns = _patterns(claim)
    used = {s for p in patterns for s in evidence.specs(p)}
    return ", ".join([*parts, *([] if used <= claims.paper_specs else ["at reduced size"])])


def _patterns(claim: Claim) -> list[str]:
    """Every pattern of configurations that the claim's judgement names."""
    kind = claim.kind
    pairs = [p for pair in getattr(kind, "pairs", ()) for p in pair]
    listed = [p for name in ("specs", "against") for p in getattr(kind, name, ())]
    return [*pairs, *listed, *(getattr(kind, name) for name in ("a", "b") if hasattr(kind, name))]


def _command(claim: Claim, dataset: str = "", preset: str = "") -> str:
    """The command that brings evidence, or more of it: the study, then its largest preset."""
    if not claim.study:
        return shlex.join(["bench", "data", "inspect", claim.needs])
    words = ["bench", "run", claim.study]
    if dataset not in ("", study.get(claim.study).default_dataset):
        words += ["--dataset", dataset]
    return shlex.join([*words, *(["--preset", "paper"] if preset else [])])


def _bound(claims: Claims, claim: Claim, ordered: Sequence[Evidence], facts: bool) -> Row:
    """A dataset-bound claim: judged on its own data only, with the values on others beside."""
    kind, needs = claim.kind, claim.needs
    missing = Judgement(NOT_RUN, basis=f"needs {needs}")
    if isinstance(kind, Fact):
        row = Row(claim, needs, "", missing, _command(claim))
        if not facts:
            return row
        values = sorted(e.value for e in _recorded(kind, STAND_IN.get(needs, "")))
        shown = " to ".join(number(v) for v in dict.fromkeys(values[:1] + values[-1:]))
        beside = f"{STAND_IN[needs]}: {shown}" if values else ""
        counted = _recorded(kind, needs)
        if not counted:
            return replace(row, beside=beside)
        return replace(row, judgement=settle(lambda _: counted, claim.accept, ALPHA), beside=beside)
    others, row = [], Row(claim, needs, "", missing, _command(claim, needs))
    for evidence in (e for e in ordered if e.study == claim.study):
        if evidence.dataset == needs:
            label, command = _label(claims, claim, evidence), _command(claim, needs, evidence.preset)
            row = Row(claim, needs, label, _judge(claim, evidence)(ALPHA), command)
        else:
            others += [f"{evidence.dataset}: {number(j.value)}" for j in [_judge(claim, evidence)(ALPHA)] if j.basis]
    return replace(row, beside="; ".join(others))


def _recorded(kind: Fact, dataset: str) -> list[Estimate]:
    """What the recordings say; nothing where they cannot be had."""
    try:
        entry = DATASETS.get(dataset)
        return kind.count(load(entry(**entry.in_full)))
    except BenchError:
        return []
