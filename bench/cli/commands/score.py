"""`bench score-discovery`: prove the diagnosis on flights whose missing physics is known."""

import os
import shlex
import time
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console

from bench.cli import options
from bench.cli.progress import clock, meter
from registry.cache import cache_folder
from registry.errors import BenchError, near

if TYPE_CHECKING:
    from bench.score.case import Case
    from bench.score.run import Job, Store

CHAINS = ("first", "second", "both", "unknown")
CONDITIONS = ("single", "pair", "triple", "nothing", "gusts", "unknown", "tie", "corrupted", "shifted")
UNFORESEEN = (
    *("spring", "wall", "place_lift", "cross", "dead_zone", "taken_out", "periodic", "drift", "load", "slosh"),
    *("motors", "twisted", "empty", "blown", "undersampled"),
)
"""Conditions of the chain "unknown"."""


class _Share(click.ParamType):
    name = "SHARE"

    def convert(self, value: str | Fraction, param: click.Parameter | None, ctx: click.Context | None) -> Fraction:
        """A share such as 1/3 or 0.2."""
        try:
            share = Fraction(value)
        except (ValueError, ZeroDivisionError):
            self.fail(f"{value!r} is no number: give a share such as 1/3 or 0.2.", param, ctx)
        if not 0 < share <= 1:
            self.fail(f"{value} is not between 0 and 1.", param, ctx)
        return share


@click.command("score-discovery")
@click.option("--quick", is_flag=True, help="A seventh to an eleventh of the cases, with fewer and shorter flights.")
@options.workers
@click.option(
    "--seed",
    type=click.Choice(["reported", "development"]),
    default="reported",
    show_default=True,
    help="Which suite. Tune on development; what is reported shares no flight and no noise with it.",
)
@click.option(
    "--chain",
    type=click.Choice(CHAINS),
    default="first",
    show_default=True,
    help="RotorPy, a second simulator with motors, estimators and loggers, both; or effects that nobody foresaw.",
)
@click.option("--case", "named", multiple=True, metavar="ID", help="This case only. Repeatable.")
@click.option(
    "--write",
    "write_to",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Diagnose nothing: write the folder of each chosen case to DIR/ID, as a user would bring it.",
)
@click.option(
    "--only", type=click.Choice((*CONDITIONS, *UNFORESEEN)), multiple=True, help="This condition only. Repeatable."
)
@click.option("--fraction", type=_Share(), default="1", help="This share of every condition, such as 1/3.")
@options.results
@click.option(
    "--cache",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the simulated flights; default: in your cache folder.",
)
@click.option(
    "--alternatives/--no-alternatives",
    default=True,
    show_default=True,
    help="Try what one would do instead on the same logs: PySINDy, regression with BIC, plain weak form.",
)
@click.option("--table", is_flag=True, help="Run nothing: the table of what is finished so far.")
def score_discovery_command(
    quick: bool,
    workers: int | None,
    seed: str,
    chain: str,
    named: tuple[str, ...],
    write_to: Path | None,
    only: tuple[str, ...],
    fraction: Fraction,
    results: Path,
    cache: Path | None,
    alternatives: bool,
    table: bool,
) -> None:
    """Prove `bench diagnose` on simulated flights whose missing physics is known.

    RotorPy, a simulator that shares no code with this project, flies vehicles with one hidden effect, with several,
    with none, with effects that the catalogue lacks, and logs that were spoilt. Every set of logs is diagnosed as a
    user's would be; the table holds the answers against the truth, beside those of simpler methods.

    \b
    pip install '.[score]'                               RotorPy and PySINDy
    bench score-discovery --quick                        a first look, minutes
    bench score-discovery                                all of it; writes results/published/discovery.md
    bench score-discovery --only pair --only triple      two conditions
    bench score-discovery --fraction 1/3 --table         what is known so far, running nothing
    bench score-discovery --chain second                 the flights of the second simulator
    bench score-discovery --chain unknown --fraction 1/3 effects that no catalogue has: flights, tanks, carts
    bench score-discovery --chain second --case ID --write DIR     one of them as a folder, for `bench diagnose`

    Finished cases are kept in RESULTS/discovery/answers.jsonl: after Ctrl-C or a crash the same command goes on
    where it stopped. When the code of the diagnosis changes, its answers are sought anew. A case whose diagnosis
    raised an error is a wrong answer, and ends in exit code 1.
    """
    from bench.score.chains import cases, write_folder
    from bench.score.run import Store, jobs, part

    suite = cases(seed, quick, chain)
    if unknown := sorted(set(named) - {c.id for c in suite}):
        raise BenchError(f"--case {unknown[0]}: {_alike(unknown[0], [c.id for c in suite])}")
    suite = [c for c in suite if not named or c.id in named]
    chosen = part([c for c in suite if not only or c.condition in only], float(fraction))
    out = options.console()
    if write_to:
        for case in chosen:
            write_folder(case, write_to / case.id, cache or _cache())
            out.print(str(write_to / case.id), highlight=False, markup=False, soft_wrap=True)
        return
    store = Store(results)
    if not table:
        todo = jobs(chosen, alternatives and chain != "unknown")
        _run(out, todo, store, cache or _cache(), workers or os.cpu_count() or 1)
    page = {"first": "discovery.md", "unknown": "unknown_effects.md"}.get(chain, "")
    whole = seed == "reported" and bool(page) and not (quick or only or named) and fraction == 1
    command = _command(quick, seed, chain, named=named, only=only, fraction=fraction, alternatives=alternatives)
    _conclude(out, chosen, store, command, results, page if whole else "")


def _alike(text: str, ids: list[str]) -> str:
    """The tail of an error about an unknown case: the ids that contain the text, else the near ones."""
    found = [i for i in ids if text.strip() and text.strip().lower() in i.lower()]
    more = f", and {len(found) - 20} more" if len(found) > 20 else ""
    return f"no case has this id. Ids that contain it: {', '.join(found[:20])}{more}." if found else near(text, ids)


def _run(out: Console, todo: "list[Job]", store: "Store", cache: Path, workers: int) -> None:
    from bench.score.run import COST, run

    held = store.read()
    missing = [job for job in todo if job.key not in held]
    out.print(f"{len(todo)} jobs, {len(todo) - len(missing)} already finished, {len(missing)} to do.")
    if not missing:
        return
    with meter(out, sum(COST[job.kind] for job in missing), len(missing)) as progress:

        def finished(job: "Job") -> None:
            progress.done += COST[job.kind]
            progress.record()

        run(missing, store, cache, workers, lambda job: progress.start(job.case.id), finished)
    out.print(f"{len(missing)} jobs in {clock(time.monotonic() - progress.started)} with {workers} process(es).")


def _conclude(out: Console, chosen: "list[Case]", store: "Store", command: str, results: Path, page: str) -> None:
    from bench.claims.manifest import entered
    from bench.diagnose.result import write_text
    from bench.score.show import markdown, show
    from bench.score.table import table
    from bench.score.unknown.condition import UnknownCase
    from bench.score.unknown.table import table as unforeseen

    found = (unforeseen if any(isinstance(c, UnknownCase) for c in chosen) else table)(chosen, store.read())
    if not found.scored:
        raise BenchError(f"None of these cases was finished by the present code in {store.path}: leave --table out.")
    show(out, found)
    complete = page and found.scored == len(chosen)
    path = results / "published" / page if complete else store.path.with_name("table.md")
    write_text(path, markdown(found, command))
    entered(path)
    out.print(f"Table and failures: {path}", highlight=False, markup=False)
    if found.raised:
        raise click.exceptions.Exit(1)


def _command(
    quick: bool,
    seed: str,
    chain: str,
    named: tuple[str, ...],
    only: tuple[str, ...],
    fraction: Fraction,
    alternatives: bool,
) -> str:
    """The command that makes the same table on any machine."""
    words = ["bench", "score-discovery", *["--quick"] * quick]
    words += ["--seed", seed] if seed != "reported" else []
    words += ["--chain", chain] if chain != "first" else []
    words += [w for name in named for w in ("--case", name)]
    words += [w for name in only for w in ("--only", name)]
    words += ["--fraction", str(fraction)] if fraction != 1 else []
    return shlex.join(words + ["--no-alternatives"] * (not alternatives))


def _cache() -> Path:
    return cache_folder() / "flights"
