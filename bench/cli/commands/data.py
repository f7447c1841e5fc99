"""`bench data`: look at recordings, describe a folder of one's own, check it."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.markup import escape
from rich.table import Table

from bench.cli import options
from bench.cli.data_options import DataOptions, exclude_option, ignore_option
from bench.cli.names import check_dataset, check_system
from registry.errors import BenchError

if TYPE_CHECKING:
    from bench.diagnose.checks.description.mistake import Mistake
    from bench.diagnose.checks.description.recorded import Recorded
    from bench.diagnose.logs.subject import Subject
    from registry.contracts import Dataset, Finding, RecordingSet
    from registry.datasets.folder.dataset import Folder


_FINDINGS = 3
"""Findings of one kind that are told one by one where there are more."""


@click.group("data")
def data_command() -> None:
    """Recordings: inspect a data set, describe and check a folder of your own."""


@data_command.command("inspect")
@click.argument("name", metavar="DATASET|FOLDER")
@options.assignments
def inspect_command(name: str, assignments: tuple[str, ...]) -> None:
    """Per recording: samples, rate, seconds, what cleaning found, ranges with units; then every finding."""
    given = {k.removeprefix("dataset."): v for k, v in options.parsed(assignments).items()}
    check_dataset(name)

    from bench.experiment.datasets import choose
    from registry.datasets.reading.inspect import inspect

    _render(*inspect(choose(name, given)))


@data_command.command("init")
@click.argument("folder", type=options.Recordings())
@click.option(
    "--system",
    metavar="NAME|FILE.py:CLASS",
    default="",
    help="Physics model, or your own class; default: a vehicle's, or none.",
)
def init_command(folder: Path, system: str) -> None:
    """Draft FOLDER/dataset.toml from the headers and the clock of its CSV or Parquet files.

    Without --system, columns that hold the motion of a vehicle make a quadrotor or a helicopter of it; all others are
    signals of their own, which networks predict.

    \b
    bench data init flights/
    bench data init spring/ --system oscillator    `bench list physics` names the systems, `bench show` their signals
    bench data init arm/ --system mine.py:Arm      your own physics
    """
    from registry.datasets.folder.draft import NO_PHYSICS, draft

    target = folder / "dataset.toml"
    if target.exists():
        raise BenchError(f"{target} exists already: edit it, or move it away to draft a new one.")
    own = None
    if ".py:" in system:
        from bench.diagnose.logs.own_system import own_class

        own = own_class(system)
    text = draft(folder, "" if own else system, own=own)
    try:
        target.write_text(text)
    except OSError as error:
        raise BenchError(f"{target} cannot be written: {error.strerror}.") from error
    if NO_PHYSICS in text:
        others = "no --system names another model (`bench list physics`)"
        click.echo(f"{NO_PHYSICS} No column looks like the motion of a vehicle, and {others}.")
    check = DataOptions(str(folder), system=system if own else None).next_command("data check")
    click.echo(f"Wrote {target}. Complete the lines marked TODO, then: {check}")


@data_command.command("import")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FILE...")
@click.option("-o", "--out", "folder", required=True, type=options.Output(folder=True), help="Folder to write.")
@click.option(
    "--rate",
    metavar="HZ",
    type=options.Positive(1e5),
    help="Common sample rate; default: that of the slower of body rates and motors, 100 Hz at most for a vehicle whose "
    "signals have clocks of their own. Of a MATLAB file without a time, that at which it was sampled.",
)
@click.option(
    "--vehicle",
    metavar="crazyflie|FILE.toml",
    default="",
    help="Whose constants to state: a Crazyflie 2's, or those under [physics] of a file, such as dataset.toml.",
)
def import_command(files: tuple[Path, ...], folder: Path, rate: float | None, vehicle: str) -> None:
    """Logs of PX4, ArduPilot, ROS 1 and 2, a Crazyflie or MATLAB as CSV files with a drafted dataset.toml.

    Of autopilots and ROS all signals on one clock, SI, world z up, body x forward, y left, z up (NED and FRD are
    converted). Of a Crazyflie the variables as they are, described with their units and signs; files that cfclient
    wrote at the same time, block by block, are put together. Of MATLAB structs with a time, nested or in arrays, or
    plain variables.

    \b
    bench data import flight1.ulg flight2.ulg -o flights/
    bench data import 00000012.BIN -o flights/
    bench data import run.bag -o flights/ --rate 200
    bench data import log00 log01 -o flights/ --vehicle crazyflie
    bench data import state.csv motors.csv -o flights/
    bench data import tank.mat -o tank/
    """
    from registry.datasets.logs.importing import convert

    for sentence in convert(files, folder, rate, vehicle):
        click.echo(sentence)
    todo = "TODO" in (folder / "dataset.toml").read_text(encoding="utf-8")
    complete = "Complete the lines marked TODO in its dataset.toml, then:" if todo else "Next:"
    click.echo(f"Wrote {folder}. {complete} bench data check {shlex.quote(str(folder))}")


@data_command.command("check")
@click.argument("folder", type=options.Recordings())
@click.option(
    "--system",
    metavar="NAME|FILE.py:CLASS",
    help="Physics model, as `bench diagnose` takes it; default: what dataset.toml names.",
)
@exclude_option
@ignore_option
def check_command(folder: Path, system: str | None, exclude: tuple[str, ...], ignore: tuple[str, ...]) -> None:
    """Read everything that FOLDER/dataset.toml describes and say what is wrong, and what is missing.

    Signals are held against each other: signs, axes, units, frames, the order of the rotors and clocks. What is WRONG
    is named, of a vehicle with the line of dataset.toml that mends it; the exit code is then 2, so that scripts stop.
    Time on the ground is left out.

    \b
    bench data check flights/
    bench data check arm/ --system mine.py:Arm   also whether the folder has what this class needs
    bench data check flights/ --exclude flight_3 --ignore-problem spike   as `bench diagnose` would go on
    """
    check_system(system)

    from bench.diagnose.checks.description.checklist import check
    from bench.diagnose.checks.description.recorded import flying, of_folder
    from bench.diagnose.logs.load import load
    from bench.diagnose.logs.parts import refuse_short
    from bench.diagnose.logs.smoothing import stated
    from bench.diagnose.result import check_kinds
    from registry.core import PHYSICS
    from registry.datasets.folder.dataset import Folder
    from registry.stated import refuse_unstated

    check_kinds(ignore)
    dataset, asked = Folder(path=str(folder)), DataOptions(str(folder), system=system, exclude=exclude)
    dataset = dataset.without(exclude) if exclude else dataset
    loaded, again = dataset.load(), asked.asked(ignore_problem=ignore)
    _show_read(loaded, dataset)
    stated(dataset.processing)
    if dataset.system and not system:
        refuse_unstated(dataset, PHYSICS.get(dataset.system))
    subject = load(dataset, system) if system else _diagnosable(dataset)
    for warning in () if subject is None else subject.warned:
        click.echo(f"note: {warning}")
    recorded, carried = of_folder(dataset), flying(dataset.system)
    if stopping := _misread(check(recorded, carried), ignore):
        rerun, described = again.command("data check", str(folder)), folder / "dataset.toml"
        some = any(m.mend for m in stopping)
        click.echo(
            f"{f'Write these lines into {described}' if some else f'Mend the files or {described}'}, then: {rerun}"
        )
        raise click.exceptions.Exit(2)
    if subject is not None and (kinds := _contradicted(subject, ignore)):
        click.echo(f"Mend the files or {folder / 'dataset.toml'}; `bench diagnose` would stop there.")
        rerun = again.command("data check", str(folder), *(w for k in kinds for w in ("--ignore-problem", k)))
        click.echo(f"Or, if that is no fault (or --exclude RECORDING): {rerun}")
        raise click.exceptions.Exit(2)
    if subject is not None:
        refuse_short(subject)
    _show_agreements(recorded, carried)
    dataset.split(loaded.names)  # or it says that one short recording is too little
    _show_next(dataset, again.command("diagnose", str(folder)) if system or dataset.system else None)


def _show_next(dataset: "Folder", diagnose: str | None) -> None:
    """Say what can be done with a folder that is in order; ``diagnose``: None where no model is named."""
    folder = shlex.quote(str(dataset.path))
    network = f'bench run "LSTM: 1x50 - MLP: 60x10" --dataset {folder}   (a network that predicts it)'
    if diagnose:
        click.echo(f"Next: {diagnose}   (which physics a model of it lacks)")
        click.echo(f"  or: {network}")
        return
    click.echo(
        f"No physics model: networks only. {', '.join(dataset.inputs) or 'nothing'} → {', '.join(dataset.predicted())}."
    )
    if dataset.description.physics:
        click.echo("[physics] belongs to a model, and none is named: its constants were not looked at. If it is a")
        click.echo("class of your own, name it with every command: --system FILE.py:CLASS.")
    click.echo(f"Next: {network}")
    click.echo(f"  or: bench diagnose {folder} --system mine.py:Class   (physics of your own)")


def _show_read(loaded: "RecordingSet", dataset: "Folder") -> None:
    """Say what was read, what was found on the way, and what is still open."""
    seconds = sum(r.seconds for r in loaded.recordings)
    long = f"{seconds:.1f}" if seconds >= 1 else f"{seconds:.2g}"
    some = "1 recording" if len(loaded.recordings) == 1 else f"{len(loaded.recordings)} recordings"
    click.echo(f"{some}, {long} s in all at {dataset.description.rate:g} Hz, read without an error.")
    of_kind: dict[str, list[Finding]] = {}
    for f in loaded.findings:
        of_kind.setdefault(f.kind, []).append(f)
    for alike in of_kind.values():
        shown = alike[:_FINDINGS] if len(alike) > _FINDINGS + 1 else alike
        for f in shown:
            click.echo(f"  {f.recording}: {f.detail}")
        if more := len(alike) - len(shown):
            every = f"bench data inspect {shlex.quote(str(dataset.path))}"
            click.echo(f"  … and {more} more like this ({shown[0].kind}); all of them: {every}")
    for note in dataset.description.notes:
        click.echo(f"  {note}")
    if todo := Path(dataset.described).read_text(encoding="utf-8").count("TODO"):
        click.echo(f"  dataset.toml still says TODO {todo} times: complete what is open, and delete the marks.")


def _misread(mistakes: "Sequence[Mistake]", ignore: tuple[str, ...]) -> "list[Mistake]":
    """Say what dataset.toml has wrong and the lines that mend it; those at which a diagnosis would stop."""
    stopping = [m for m in mistakes if m.stops and m.kind not in ignore]
    for m in mistakes:
        click.echo(f"{'WRONG' if m in stopping else 'note'}: {m.kind}: {m.detail}")
        for row in m.mend:
            click.echo(f"    {row}")
    return stopping


def _show_agreements(recorded: "Recorded", carried: bool) -> None:
    """Say what of a vehicle was held against what, so that silence is not taken for a check."""
    from bench.diagnose.checks.description.conventions import agreeing

    alike, untold = agreeing(recorded, carried)
    if alike:
        click.echo(f"Agree with each other: {'; '.join(alike)}.")
    if untold:
        click.echo(f"Not told by these recordings: {'; '.join(untold)}.")


def _diagnosable(dataset: "Dataset") -> "Subject | None":
    """The recordings as a diagnosis takes them; None: nobody asks for one, or they do not fit the model."""
    from bench.diagnose.logs.load import load

    if not dataset.system:
        return None
    try:
        return load(dataset)
    except BenchError as error:
        click.echo(f"note: {error}")
        return None


def _contradicted(subject: "Subject", ignore: tuple[str, ...]) -> list[str]:
    """Say what signals tell against each other; the kinds of it that would stop a diagnosis."""
    from bench.diagnose.checks.problems import contradictions, without_damaged
    from bench.diagnose.report.phrases import gathered

    found, suspicions = contradictions(subject)
    left = [p for p in found if p.kind not in ignore]
    stopping = left if without_damaged(subject, left) is None else []
    for word, said in (("WRONG", stopping), ("note", [p for p in found if p not in stopping])):
        for line in gathered(said):
            click.echo(f"{word}: {line}")
    for one in suspicions:
        click.echo(f"note: {one.detail}")
    return list(dict.fromkeys(p.kind for p in stopping))


def _render(rows: list[dict[str, Any]], findings: "list[Finding]") -> None:
    out = options.console()
    table = Table(box=None, header_style="bold", padding=(0, 2, 0, 0), pad_edge=False)
    table.add_column("recording")
    for name in ("samples", "Hz", "s", "invalid", "dropped", "held", "spikes", "gaps", "lag"):
        table.add_column(name, justify="right")
    for r in rows:
        lag = "" if r["lag"] is None else f"{r['lag']:+.1f}"
        rate = "" if r["rate"] is None else f"{r['rate']:g}"
        counts = [r[k] for k in ("invalid", "dropped", "held", "spike", "gaps")]
        cells = (str(c or "") for c in counts)
        table.add_row(escape(r["name"]), str(r["samples"]), rate, f"{r['seconds']:.1f}", *cells, lag)
    out.print(table)
    total = sum(r["samples"] for r in rows)
    out.print(f"{len(rows)} recordings, {total} samples, {sum(r['seconds'] for r in rows) / 60:.1f} minutes.\n")
    _render_ranges(out, rows)
    if findings:
        out.print("\n[bold]What cleaning found[/]")
    for f in findings:
        out.print(f"  {f.recording}: {f.kind}: {f.detail}", highlight=False, markup=False)


def _render_ranges(out: Any, rows: list[dict[str, Any]]) -> None:
    """Least and greatest value of every channel, recording by recording in blocks of a signal."""
    signals: dict[str, list[str]] = {}
    for row in rows:
        for channel in row["ranges"]:
            axes = signals.setdefault(channel.partition(".")[0], [])
            if channel not in axes:
                axes.append(channel)
    for signal, channels in signals.items():
        unit = next(r["ranges"][c][2] for r in rows for c in channels if c in r["ranges"])
        table = Table(box=None, header_style="bold", padding=(0, 2, 0, 0), pad_edge=False)
        table.add_column(escape(f"{signal} [{unit}]"))
        for c in channels:
            table.add_column(escape(c.partition(".")[2]), justify="right", no_wrap=True)
        for r in rows:
            cells = [r["ranges"].get(c) for c in channels]
            if any(cells):
                table.add_row(escape(r["name"]), *("" if c is None else f"{c[0]:.3g} .. {c[1]:.3g}" for c in cells))
        out.print(table)
