"""All claims against all evidence: a verdict each, corrected for how many there are."""

import shlex
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from bench.claims import family
from bench.claims.claim import Claim, Claims
from bench.claims.estimate import ALPHA, NOT_RUN, OPEN, Estimate, Judgement, number, settle
from bench.claims.evidence import Evidence
from bench.claims.kinds.counting import Fact
from bench.claims.outlook import outlook
from bench.experiment import study
from registry.datasets.locate import has_files
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
    outlook: str = ""
    """What would settle an open claim."""
    preset: str = ""
    """Of the study."""
    seeds: int = 0
    """That each of ``specs`` has; 0: there is no evidence."""
    specs: tuple[str, ...] = ()
    """The configurations that the claim is about, of which there is evidence."""
    needed: int = 0
    """Seeds in all that would settle an open claim; 0: seeds do not."""


def judge(
    claims: Claims,
    evidence: Sequence[Evidence],
    facts: bool = True,
    simulate: bool = False,
    wanted: Collection[str] | None = None,
) -> list[Row]:
    """One row a claim and data set with evidence for it, real recordings first; at least one a claim.

    Of all verdicts on comparative claims at most 5 % are expected to be wrong (`family.level`); dataset-bound claims,
    each a number of its own, are judged at 95 %.

    Args:
        claims: what to judge.
        evidence: of all studies.
        facts: read the recordings of dataset-bound claims about the data themselves, where they are there.
        simulate: count in the simulated stand-ins of these data as well (a minute where they are not kept yet).
        wanted: ids of the claims to return; all others count in the family alone. None: all.
    """
    ordered = sorted(evidence, key=lambda e: (e.dataset.endswith(TWIN), e.dataset))
    asked = [
        (claim, found, _question(claim, found))
        for found in ordered
        for claim in claims.claims
        if claim.scope == "comparative" and claim.study == found.study
    ]
    asked = [a for a in asked if a[2][0]]
    alpha = family.level([question for _, _, question in asked])
    asked_for = [c for c in claims.claims if wanted is None or c.id in wanted]
    rows: dict[str, list[Row]] = {c.id: [] for c in asked_for}
    homes = study.default_datasets()
    for claim, found, question in asked:
        if claim.id not in rows:
            continue
        judgement = family.judged(question, alpha, len(asked))
        needed, seeds = outlook(question, alpha) if judgement.verdict == OPEN else ("", 0)
        command = _command(claim, homes, found.dataset, found.preset, seeds > 0)
        trained = found.seeds_of(_compared(claim, found))
        rows[claim.id].append(
            Row(
                claim=claim,
                dataset=found.dataset,
                label=_label(claims, claim, found),
                judgement=judgement,
                command=command,
                outlook=needed,
                preset=found.preset,
                seeds=min(trained.values(), default=0),
                specs=tuple(trained),
                needed=seeds,
            )
        )
    for claim in asked_for:
        if claim.scope == "dataset":
            rows[claim.id].append(_bound(claims, claim, ordered, homes, facts, simulate))
        elif not rows[claim.id]:
            rows[claim.id].append(Row(claim, "", "", Judgement(NOT_RUN), _command(claim, homes)))
    return [row for found in rows.values() for row in found]


def _question(claim: Claim, evidence: Evidence) -> family.Question:
    kind = claim.kind
    assert not isinstance(kind, Fact)
    seeds = max(evidence.seeds_of(_compared(claim, evidence)).values(), default=evidence.seeds)
    return family.Question(kind.measure(evidence), claim.accept, kind.relative, evidence.first or seeds, seeds)


def _label(claims: Claims, claim: Claim, evidence: Evidence) -> str:
    parts = ["simulated"] if evidence.dataset.endswith(TWIN) else []
    parts += [] if evidence.preset == "paper" else [evidence.preset]
    used = {s for p in patterns(claim) for s in evidence.specs(p)}
    return ", ".join([*parts, *([] if used <= claims.paper_specs else ["at reduced size"])])


def patterns(claim: Claim) -> list[str]:
    """Every pattern of configurations that the claim's judgement names; none of a claim about recordings."""
    kind = claim.kind
    pairs = [p for pair in getattr(kind, "pairs", ()) for p in pair]
    listed = [p for name in ("specs", "against") for p in getattr(kind, name, ())]
    return [*pairs, *listed, *(getattr(kind, name) for name in ("a", "b") if hasattr(kind, name))]


def _compared(claim: Claim, evidence: Evidence) -> list[str]:
    """The configurations that the claim compares: of pairs those that have an opponent."""
    pairs = getattr(claim.kind, "pairs", ())
    return [spec for a, b in pairs for pair in evidence.pairs(a, b) for spec in pair] if pairs else patterns(claim)


def _command(claim: Claim, homes: Mapping[str, str], dataset: str = "", preset: str = "", seeds: bool = False) -> str:
    """The command that brings evidence, or more of it: seeds where they help, else the study, at its largest preset."""
    if not claim.study:
        return shlex.join(["bench", "data", "inspect", claim.needs])
    words = ["bench", "settle", claim.id] if seeds else ["bench", "run", claim.study]
    if seeds or dataset not in ("", homes.get(claim.study)):
        words += ["--dataset", dataset]
    return shlex.join(words + (["--preset", "paper"] if preset and not seeds else []))


def _bound(
    claims: Claims, claim: Claim, ordered: Sequence[Evidence], homes: Mapping[str, str], facts: bool, simulate: bool
) -> Row:
    """A dataset-bound claim: judged on its own data only, with the values on others beside."""
    kind, needs = claim.kind, claim.needs
    missing = Judgement(NOT_RUN, basis=f"needs {needs}")
    if isinstance(kind, Fact):
        row = Row(claim, needs, "", missing, _command(claim, homes))
        if not facts:
            return row
        values = sorted(e.value for e in _recorded(kind, STAND_IN.get(needs, ""))) if simulate else []
        shown = " to ".join(number(v) for v in dict.fromkeys(values[:1] + values[-1:]))
        beside = f"{STAND_IN[needs]}: {shown}" if values else ""
        counted = _recorded(kind, needs)
        if not counted:
            return replace(row, beside=beside)
        return replace(row, judgement=settle(counted, claim.accept), beside=beside)
    others, row = [], Row(claim, needs, "", missing, _command(claim, homes, needs))
    for found in (e for e in ordered if e.study == claim.study):
        judgement = family.judged(_question(claim, found)._replace(relative=False), ALPHA, 1)
        if found.dataset == needs:
            label, command = _label(claims, claim, found), _command(claim, homes, needs, found.preset)
            row = Row(claim, needs, label, judgement, command)
        elif judgement.basis:
            others.append(f"{found.dataset}: {number(judgement.value)}")
    return replace(row, beside="; ".join(others))


def _recorded(kind: Fact, dataset: str) -> list[Estimate]:
    """What the recordings say; nothing where they cannot be had."""
    if dataset in STAND_IN and not has_files(dataset):
        return []
    from bench.training.split import load  # training and what it trains take seconds to import
    from registry.core import DATASETS

    try:
        entry = DATASETS.get(dataset)
        return kind.count(load(entry(**entry.in_full)))
    except BenchError:
        return []
