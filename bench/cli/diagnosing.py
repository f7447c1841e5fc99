"""What the diagnosing commands share: measurements and models in, tables, files and MLflow runs out."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.markup import escape
from rich.table import Table

from bench.cli import options
from bench.cli.data_options import refuse_file
from bench.cli.progress import announcer
from bench.experiment.datasets import registered
from registry.core import EFFECTS
from registry.errors import BenchError

if TYPE_CHECKING:
    from bench.diagnose.extend import Extension
    from bench.diagnose.logs.subject import Subject
    from bench.diagnose.result import Diagnosis, NamedEffect
    from bench.diagnose.select.discovery import Discovery
    from registry.dynamics import PhysicsModel


# ------------------------------------------------------------------------------------------------- what goes in


def chosen(catalogue: Sequence[str], without: Sequence[str]) -> list[str] | None:
    """Ids of the effects to choose from; None: all of them.

    Raises:
        BenchError: there is no such effect, or none is left.
    """
    check_effects((*catalogue, *without))
    if not catalogue and not without:
        return None
    left = [n for n in (catalogue or EFFECTS.outline()) if n not in without]
    if not left:
        raise BenchError("--without leaves no effect of --catalogue to choose from: name others.")
    return left


def check_effects(names: Sequence[str]) -> None:
    """Raise `BenchError` where the catalogue has no effect of such a name; what asks to learn a term is none."""
    for name in names:
        if name != "learned" and "~" not in name:
            EFFECTS.check(name)


def folder_for(source: str, out: Path | None) -> Path:
    """Where files are written: ``out``, or beside the data.

    Raises:
        BenchError: nothing can be written there.
    """
    if out is not None:
        return out
    refuse_file(source)
    beside = Path("diagnosis") / source if registered(source) else Path(source) / "diagnosis"
    try:
        return options.Output(folder=True).convert(beside, None, None)
    except BenchError as error:
        raise BenchError(f"{str(error).rstrip('.')}: give another folder with --out.") from error


# ------------------------------------------------------------------------------------------------ what comes out


def print_problems(subject: "Subject") -> None:
    """Say what is wrong with the data before a step that would take it for physics."""
    from bench.diagnose.checks.problems import contradictions
    from bench.diagnose.report.phrases import gathered

    found = gathered(contradictions(subject).problems)
    for line in found[:4]:
        click.echo(f"data problem: {line}", err=True)
    if len(found) > 4:
        click.echo(f"data problem: and {len(found) - 4} more; `bench diagnose` lists them.", err=True)


def write_model(target: Path, model: "PhysicsModel", effects: "Sequence[NamedEffect]") -> list[Path]:
    """Write the model; another one that was there is kept beside it. Returns the files written."""
    from bench.diagnose.report import model_file as files

    copy, former = target.with_name(".model.toml.former"), target.with_name("model.previous.toml")
    if not target.is_file():
        files.write(target, model, effects)
        return [target]
    shutil.copyfile(target, copy)
    files.write(target, model, effects)
    if copy.read_bytes() == target.read_bytes():
        copy.unlink()
        return [target]
    copy.replace(former)
    return [target, former]


def print_diagnosis(found: "Diagnosis") -> None:
    """Print the summary, and how to go on although the data have a problem."""
    from bench.diagnose.report import terminal_summary

    terminal_summary.print_summary(found, options.console())
    if found.verdict == "data_problem":
        again = [w for k in dict.fromkeys(p.kind for p in found.data_problems) for w in ("--ignore-problem", k)]
        print_next(found.evidence.command("diagnose", *again), "if that is no fault (or --exclude RECORDING)")


def print_written(console: Any, written: Sequence[Path]) -> None:
    """Name the files, and what a former model is called now."""
    former = " (the model that was there)" if written[-1].name == "model.previous.toml" else ""
    console.print(f"\nWrote {', '.join(map(str, written))}{former}", highlight=False, markup=False, soft_wrap=True)


def show_discovery(console: Any, found: "Discovery") -> None:
    """Print the verdict, the effects found with their fitted numbers, and what the rest follows."""
    from bench.diagnose.report import phrases, sentences
    from bench.diagnose.summaries import parameter_estimates

    effects, left = [(f.id, f.rivals) for f in found.found], found.traces[:3]
    axes, follows = ([getattr(t, name) for t in left] for name in ("axis", "signal"))
    line = sentences.verdict_line(found.verdict, effects, axes, follows, found.obscured, found.inverse)
    console.print(line, highlight=False, markup=False)
    for f in found.found:
        console.print(f"[bold]{f.id}[/]  {escape(EFFECTS.get(f.id).equation)}", highlight=False)
        for name, p in parameter_estimates(f.estimates).items():
            console.print(f"    {name} = {phrases.estimate(name, p)}", highlight=False, markup=False)
        if f.rivals:
            console.print(f"    these recordings cannot tell it from {phrases.listed(f.rivals, 'or')}")
    for t in left if found.found else ():
        console.print(
            f"  something systematic is left in {t.axis}: it follows {t.signal}", highlight=False, markup=False
        )


def show_extension(console: Any, done: "Extension", model_file: Path | None = None) -> None:
    """Print the held-out error, effect by effect, and the fitted numbers; ``model_file``: where it began."""
    from bench.diagnose.report import phrases

    groups, stages = done.comparison.groups, done.stages
    units = [phrases.shown(g.unit, g.name, [s.error[g.name] for s in stages]) for g in groups]
    heads = (f"{phrases.named(g.name)} [{unit}]" for g, (unit, _) in zip(groups, units, strict=True))
    rows = table("held-out error", *map(escape, heads))
    for stage in stages:
        added = stage.name in {e.name for e in done.effects}
        cells = (phrases.number(stage.error[g.name] * f) for g, (_, f) in zip(groups, units, strict=True))
        name = f"{model_file.name}, fitted again" if model_file and stage.name == "calibrated" else stage.name
        rows.add_row(escape(f"+ {name}" if added else name), *cells)
    console.print(rows)
    if len(done.effects) > 1:
        last = done.effects[-1].name
        console.print(
            f"Only the row of {last} is of the final fit by simulation; the rows above it come before that fit."
        )
    for e in done.effects:
        console.print(f"  {e.id}: {e.described or phrases.parameters(e)}", highlight=False, markup=False)
    print_notes(console, done.notes)


def track_extension(
    subject: "Subject",
    start: "PhysicsModel",
    done: "Extension",
    tracking: str | None,
    results: Path,
    model_file: Path,
) -> None:
    """One MLflow run for every effect added."""
    from bench.tracking import track

    held = [EFFECTS.name_of(type(e)) for e in start.effects]
    comparison, added = done.comparison, [e.key for e in done.effects]
    chain = {len(held): comparison.error("calibrated")}
    if held:
        chain[0] = comparison.error("nominal")
    uri = tracking or track.default_uri(results)
    for i, effect in enumerate(done.effects):
        chain[len(held) + i + 1] = effect.error_after
        parameters = {f"{e.key}.{n}": p.value for e in done.effects[: i + 1] for n, p in e.parameters.items()}
        try:
            last = i == len(added) - 1
            track.log_extension(
                uri,
                subject.name,
                effects=(*held, *added[: i + 1]),
                errors={step: chain[step] for step in sorted(chain)},
                floor=comparison.error("floor"),
                parameters=parameters,
                files=(model_file,) if last else (),
            )
        except track.TrackingError as error:
            click.echo(f"bench: {error}", err=True)
            return
    click.echo(f"MLflow: experiment {track.diagnosis_experiment(subject.name)!r}; `bench ui` draws the falling error.")


def table(first: str, *others: str) -> Table:
    """A table with these columns, numbers to the right."""
    made = Table(box=None, header_style="bold", padding=(0, 2, 0, 0), pad_edge=False)
    made.add_column(first)
    for name in others:
        made.add_column(name, justify="right")
    return made


def print_notes(out: Any, notes: Sequence[str]) -> None:
    """Print sentences about how figures came about."""
    for note in notes:
        out.print(note, style="dim", highlight=False, markup=False)


def write_json(path: Path | None, what: dict[str, Any]) -> None:
    """Write values as JSON, null for numbers that do not exist; None: nothing is asked for."""
    from bench.diagnose.result import finite, write_text

    if path is not None:
        write_text(path, json.dumps(finite(what), indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def print_next(command: str, why: str) -> None:
    """Print what to type next."""
    click.echo(f"Next, {why}: {command}")


def with_network(found: "Diagnosis", subject: "Subject", model: "PhysicsModel", horizon: float | None) -> "Diagnosis":
    """The diagnosis with what a network leaves, which is printed; Ctrl-C leaves the one that was written."""
    from bench.diagnose.ceiling.ceiling import ceiling, informed
    from bench.diagnose.logs.load import excluding
    from bench.diagnose.logs.sample import sampled
    from bench.diagnose.report.ceiling_words import sentences

    subject = sampled(excluding(subject, sorted({p.recording for p in found.data_problems})))  # what was diagnosed
    try:
        with announcer(options.console()) as tick:
            asked = ceiling(subject, model, tick=tick, horizon_s=horizon)
    except KeyboardInterrupt:
        click.echo("\nbench: stopped. The diagnosis is written, without the network.", err=True)
        raise click.exceptions.Exit(130) from None
    for sentence in ("", *sentences(asked.findings)):
        options.console().print(sentence, highlight=False, markup=False)
    return informed(found, asked)
