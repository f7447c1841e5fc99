"""Studies with open claims, and the runs of which their next seeds consist."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from bench.claims import claim, gathering, judge
from bench.claims.estimate import OPEN
from bench.claims.evidence import StudyRun
from bench.claims.judge import Row
from bench.claims.published import OTHER_PROCESSOR
from bench.experiment import study
from bench.experiment.config import RunConfig
from bench.experiment.request import Options, Request, request
from bench.experiment.seeds import MOST_SEEDS
from bench.records.finished import slug
from bench.records.record import RunRecord
from registry.errors import BenchError, near

Run = tuple[str, tuple[str, ...], int, int]
"""Configuration, outputs, horizon and seed."""


@dataclass(frozen=True)
class Scope:
    """Which claims are to be settled, by which evidence, with how many seeds."""

    results: Path
    published: Path
    file: Path | None = None
    """Of the claims; None: those of the paper."""
    target: str | None = None
    """A study or a claim; None: all."""
    dataset: str | None = None
    """None: all."""
    max_seeds: int = MOST_SEEDS
    """Of a configuration."""

    def check(self) -> None:
        """Raise `BenchError` where the target is neither a study that claims rest on nor a claim that runs settle."""
        known = claim.read(self.file).claims
        names = {c.id for c in known} | {c.study for c in known if c.study}
        if self.target is not None and self.target not in names:
            raise BenchError(
                f"There is no study with claims, and no claim, {self.target!r}: {near(self.target, names)}"
            )
        if any(c.id == self.target and not c.study for c in known):
            raise BenchError(f"The claim {self.target} is about recordings: no training settles it.")

    def rows(self) -> list[Row]:
        """The verdicts on comparative claims, as they are now.

        Raises:
            BenchError: there is no evidence of the study, or claim, on the data set.
        """
        gathered = gathering.gather(self.published, self.results / "studies")
        rows = [r for r in judge.judge(claim.read(self.file), gathered, facts=False) if r.seeds and self._covers(r)]
        if not rows:
            what = f" of {self.target}" if self.target else ""
            where = f" on {self.dataset}" if self.dataset else ""
            begin = "`bench list studies` has what can be run, and `bench run STUDY` makes the first seeds"
            raise BenchError(f"There is no evidence{what}{where} that more seeds could add to: {begin}.")
        return rows

    def _covers(self, row: Row) -> bool:
        named = self.target in (None, row.claim.id, row.claim.study)
        return named and self.dataset in (None, row.dataset) and row.claim.scope == "comparative"


@dataclass(frozen=True)
class Source:
    """One study on one data set at one preset, of which claims are open."""

    study: str
    dataset: str
    preset: str
    seeds: int
    """That each configuration has which its claims are about."""
    rows: tuple[Row, ...]
    """The open claims."""

    @property
    def name(self) -> str:
        """Study and data set."""
        return f"{self.study} on {self.dataset}"

    def within(self, max_seeds: int) -> list[Row]:
        """The claims that so many seeds are expected to settle."""
        return [r for r in self.rows if 0 < r.needed <= max_seeds]

    def concerns(self, config: RunConfig) -> bool:
        """Whether a claim that seeds may settle is about this training; each is, if no claim is open."""
        return not self.rows or any(
            config.horizon in getattr(row.claim.kind, "horizons", (config.horizon,)) and config.spec in row.specs
            for row in self.within(MOST_SEEDS) or self.rows
        )

    def command(self, asked: Request) -> list[str]:
        """Arguments of `bench` that make the same records, and those of the seeds before."""
        trained = [c for c in asked.configs if _trained(c)]
        specs, seeds = dict.fromkeys(c.spec for c in trained), 1 + max((c.seed for c in trained), default=0)
        preset = [] if self.preset == study.PRESETS[1] else ["--preset", self.preset]
        only = [word for spec in specs for word in ("--only", spec)]
        return ["run", self.study, "--dataset", self.dataset, *preset, *only, "--seeds", str(seeds)]


def sources(rows: Iterable[Row]) -> list[Source]:
    """The open claims by where their evidence comes from."""
    found: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        if row.judgement.verdict == OPEN:
            found.setdefault((row.claim.study, row.dataset, row.preset), []).append(row)
    fewest = {where: min(r.seeds for r in [r for r in rows if r.needed] or rows) for where, rows in found.items()}
    return [Source(*where, fewest[where], tuple(rows)) for where, rows in found.items()]


def published_runs(source: Source, published: Path) -> dict[Run, StudyRun]:
    """The runs of the study that were published as it is declared, and count."""
    found = gathering.counted_runs(published).get((source.study, source.dataset, source.preset))
    return {(r.spec, r.outputs, r.horizon, r.seed): r for r, _ in found.members} if found else {}


def added_runs(source: Source, results: Path) -> set[Run]:
    """The trainings that earlier calls added here, for whichever claims."""
    place = results / "studies" / slug(group(source, 1).title)
    found = [f for f in gathering.folders(place) if f.path == place]
    return {(r.spec, r.outputs, r.horizon, r.seed) for f in found for r in f.runs if r.history is not None}


def group(source: Source, seeds: int, there: Collection[Run] = (), added: Collection[Run] = ()) -> Request:
    """The study with so many seeds of what its open claims are about, without the trainings that are there; what has no
    seed is in it where it is there too, or nothing is there, and so is what was added before.

    Raises:
        BenchError: its data are absent.
    """
    asked = request(source.study, Options(source.dataset, source.preset, max([seeds, *(1 + run[-1] for run in added)])))

    def wanted(config: RunConfig) -> bool:
        if any(_matches(config, run) for run in added):
            return True
        if not _trained(config):
            return not there or any(_matches(config, run) for run in there)
        return config.seed < seeds and source.concerns(config) and not any(_matches(config, run) for run in there)

    title = f"{asked.title.rpartition(', ')[0]}, further seeds"
    return replace(asked, title=title, configs=[c for c in asked.configs if wanted(c)])


def seedless(asked: Request) -> Request:
    """The baselines of it alone: whether the data are read as they were shows in them, in seconds."""
    return replace(asked, configs=[c for c in asked.configs if not _trained(c)])


def _trained(config: RunConfig) -> bool:
    return config.predictor.training == "gradient"


def _matches(config: RunConfig, run: Run) -> bool:
    """Whether a run that is recorded is of this configuration, by what it was asked to predict and not by its key."""
    config = config.resolved()
    spec, outputs, horizon, seed = run
    same = (config.spec, config.horizon, config.seed) == (spec, horizon, seed)
    return same and _predicted(config.outputs, outputs)


def _predicted(selectors: Sequence[str], outputs: Sequence[str]) -> bool:
    """Whether these are the channels of the signals (or channels) asked for, and what a model shows beside them.

    That is named after its channel: velocity_forced.x stands beside velocity.x.
    """
    chosen = [o for o in outputs if any(o == s or o.startswith(f"{s}.") for s in selectors)]
    beside = [o.partition(".") for o in outputs if o not in chosen]
    own = [o.partition(".") for o in chosen]
    return all(any(o == s or o.startswith(f"{s}.") for o in chosen) for s in selectors) and all(
        any(signal.startswith(f"{of}_") and axis == part for of, _, part in own) for signal, _, axis in beside
    )


def unchanged(made: Sequence[RunRecord], published: dict[Run, StudyRun]) -> bool:
    """Whether baselines have the errors that were published, to what another processor rounds otherwise.

    If so, data, parts and windows are as they were then, and published seeds are seeds of the same problem. Without a
    baseline in both nobody knows.
    """
    compared = 0
    for record in made:
        run = StudyRun.of(record.summary)
        old = published.get((run.spec, run.outputs, run.horizon, run.seed))
        if old is None:
            continue
        compared += 1
        for name, value in run.metrics.items():
            before = old.metrics.get(name)
            if value is None or before is None or abs(value - before) > OTHER_PROCESSOR * abs(before):
                return False
    return compared > 0
