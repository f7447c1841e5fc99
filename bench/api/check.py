"""`bench.check`: a verdict on every claim of the paper, and on every number that this suite published."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from bench.analysis.display import Displayed
from bench.claims import claim, gathering, judge, manifest
from bench.claims import published as regression
from registry.errors import BenchError, near


@dataclass(frozen=True, eq=False)
class Verdicts(Displayed):
    """What became of every claim, and of every published number that was made again here."""

    rows: tuple[judge.Row, ...]
    """One a claim and data set."""
    published: tuple[regression.Held, ...]
    left_out: tuple[str, ...] = ()
    """Studies that were run here and are no evidence, trainings that do not count beside newer ones, and why."""

    @property
    def headline(self) -> str:
        """How many verdicts of each kind, and whether the published numbers hold."""
        counts = pd.Series([r.judgement.verdict for r in self.rows], dtype=object).value_counts()
        said = ", ".join(f"{n} {verdict}" for verdict, n in counts.items())
        held = sum(h.holds for h in self.published)
        return f"{said}; {held} of {len(self.published)} published numbers that were made again hold"

    @property
    def lost(self) -> tuple[regression.Held, ...]:
        """Published numbers that no longer hold."""
        return tuple(h for h in self.published if not h.holds)

    def to_frame(self) -> pd.DataFrame:
        """One row a claim and data set.

        Returns:
            claim, published (as the paper has it), dataset, value, low, high (95 %, in the unit named), unit, verdict,
            basis, outlook (what would settle it, where it is open).
        """
        return pd.DataFrame(
            [
                (
                    r.claim.id,
                    r.claim.stated,
                    r.dataset,
                    r.judgement.value,
                    r.judgement.low,
                    r.judgement.high,
                    r.claim.unit,
                    r.judgement.verdict,
                    r.judgement.basis,
                    r.outlook,
                )
                for r in self.rows
            ],
            columns=["claim", "published", "dataset", "value", "low", "high", "unit", "verdict", "basis", "outlook"],
        )


def check(
    claims: Sequence[str] | None = None, results: str | Path = "results", published: str | Path | None = None
) -> Verdicts:
    """Judge the claims of the paper by what was published with this suite and what was run here.

    Args:
        claims: their ids; default: all.
        results: folder whose finished studies are evidence.
        published: folder of the published numbers; default: the checkout's results/published.

    Raises:
        BenchError: an unknown id, published files that are not as they were published, or that cannot be read.
    """
    refuse_spoilt(published)
    return judged(claims, Path(results), published_folder(published))


def refuse_spoilt(published: str | Path | None) -> None:
    """Raise `BenchError` where published files are not as they were published; see `check`."""
    folder = published_folder(published)
    if (published is None or manifest.sealed(folder)) and (spoilt := manifest.spoilt(folder)):
        raise BenchError(
            f"{spoilt[0].how}: {folder / spoilt[0].name}, one of {len(spoilt)} published files that are not as "
            f"published: restore what was, or list what you published with `{manifest.SEAL}`."
        )


def published_folder(given: str | Path | None) -> Path:
    """The folder of the published numbers: as given, or the checkout's."""
    return claim.checkout() / "results" / "published" if given is None else Path(given)


def judged(
    claims: Sequence[str] | None, results: Path, published: Path, file: Path | None = None, simulate: bool = False
) -> Verdicts:
    """The verdicts, with published files taken as they are; see `check`.

    Args:
        claims: ids; default: all.
        results: as for `check`.
        published: as for `check`.
        file: of the claims; default: those of the paper.
        simulate: count in simulated data too, where a claim is about the recordings.
    """
    known = claim.read(file)
    ids = {c.id for c in known.claims}
    for name in claims or ():
        if name not in ids:
            raise BenchError(f"There is no claim {name!r}: {near(name, ids)}")
    wanted = ids if claims is None else set(claims)
    facts = any(c.id in wanted and not c.study for c in known.claims)
    gathered = gathering.gather(published, results / "studies")
    rows = judge.judge(known, gathered, facts, simulate, wanted)
    held = regression.check(published, results)
    out = [*gathering.left_out(results / "studies"), *(s for e in gathered for s in e.superseded)]
    return Verdicts(tuple(rows), tuple(held), tuple(out))
