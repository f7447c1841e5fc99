"""`bench compare`, `locate`, `discover`, `extend` and `diagnose`: find the missing physics."""

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.markup import escape

from bench.cli import fleets, options, stages
from bench.cli.data_options import DataOptions, data_options, ignore_option
from bench.cli.diagnosing import (
    check_effects,
    chosen,
    folder_for,
    print_diagnosis,
    print_next,
    print_notes,
    print_problems,
    print_written,
    show_discovery,
    show_extension,
    table,
    track_extension,
    with_network,
    write_json,
    write_model,
)
from bench.cli.execution_options import Execution, execution_options
from bench.cli.progress import announcer
from registry.errors import BenchError

if TYPE_CHECKING:
    from bench.diagnose.result import Diagnosis
    from registry.dynamics import PhysicsModel

Command = Callable[..., None]


def _choice(command: Command) -> Command:
    """Which effects may be named."""
    for decorate in (
        click.option(
            "--without", multiple=True, metavar="EFFECT", help="Leave this effect out of the catalogue. Repeatable."
        ),
        click.option(
            "--catalogue", multiple=True, metavar="EFFECT", help="Choose among these effects only. Repeatable."
        ),
    ):
        command = decorate(command)
    return command


_horizon = click.option(
    "--horizon",
    metavar="SECONDS",
    type=options.Positive(1e6),
    help="Length of the longest free run; default: what suits the sample rate.",
)
_out = click.option(
    "--out",
    type=options.Output(folder=True),
    help="Folder of what is written; default: diagnosis/ in DATA, or diagnosis/NAME here for a registered data set.",
)


@click.command("compare")
@data_options
@_horizon
def compare_command(
    data: DataOptions,
    horizon: float | None,
    to_json: Path | None,
) -> None:
    """Step 1: run the model free against the measurements, beside the noise floor.

    From many measured states the model runs on its own; the table has its error on recordings that were not fitted.
    Three lines: nominal, calibrated (constants fitted within their stated uncertainty) and floor (what measurement
    noise and smoothing alone would give). An error near the floor leaves nothing to find.

    \b
    bench compare flights/                                 a folder with a dataset.toml
    bench compare flights/ --model diagnosis/model.toml    is the extended model better?
    bench compare emps --horizon 0.5                       a registered data set, up to half a second
    """
    subject, model = data.load()

    from bench.diagnose.compare import compare, refuse_long
    from bench.diagnose.fit import fit_parameters
    from bench.diagnose.report import phrases

    refuse_long(subject, horizon)
    with announcer(options.console(), stages.COMPARE) as tick:
        print_problems(subject)
        calibrated, _ = fit_parameters(subject, subject.model, tick=tick)
        models = {"calibrated": calibrated}
        if model is not None:
            tick("model")
            models["extended"] = model
        tick("free runs")
        found = compare(subject, models, horizon_s=horizon)
    out = options.console()
    rows = table("error", "horizon", *found.lines)
    for group in found.groups:
        for k, seconds in enumerate(found.horizon_s):
            if k in (0, len(found.horizon_s) // 2, len(found.horizon_s) - 1):
                errors = [of[group.name].rmse[k] for of in found.lines.values()]
                unit, factor = phrases.shown(group.unit, group.name, errors)
                cells = (phrases.number(e * factor) for e in errors)
                label = escape(f"{phrases.named(group.name)} [{unit}]")
                rows.add_row(label, f"{seconds:.3g} s", *cells)
    out.print(rows)
    print_notes(out, found.notes)
    lines = {n: {g: asdict(line) for g, line in of.items()} for n, of in found.lines.items()}
    write_json(to_json, {"dataset": subject.name, "horizon_s": found.horizon_s, "lines": lines})
    print_next(data.next_command("locate"), "where it errs")


@click.command("locate")
@data_options
def locate_command(data: DataOptions, to_json: Path | None) -> None:
    """Step 2: say in which conditions the model errs, in physical terms.

    Regions such as "speed > 2.8 m/s", ranked by their share of the error against their share of the time; each shows
    in several recordings.

    \b
    bench locate flights/
    bench locate flights/ --model diagnosis/model.toml     what is left, and where
    """
    subject, model = data.load()

    from bench.diagnose.fit import fit_parameters
    from bench.diagnose.locate import locate

    with announcer(options.console(), stages.LOCATE) as tick:
        print_problems(subject)
        if model is None:
            model, _ = fit_parameters(subject, subject.model, tick=tick)
        tick("locate")
        found = locate(subject, model)
    out = options.console()
    if found.regions:
        rows = table("region", "share of error", "share of time", "recordings")
        for r in found.regions:
            rows.add_row(escape(r.region), f"{r.share_of_error:.0%}", f"{r.share_of_time:.0%}", str(len(r.recordings)))
        out.print(rows)
    print_notes(out, found.notes)
    write_json(to_json, {"dataset": subject.name, "where": [asdict(r) for r in found.regions]})
    print_next(data.next_command("discover"), "what is missing")


@click.command("discover")
@data_options
@_choice
def discover_command(
    data: DataOptions,
    to_json: Path | None,
    catalogue: tuple[str, ...],
    without: tuple[str, ...],
) -> None:
    """Step 3: find which effect of the catalogue is missing, with its parameters and their 95 % intervals.

    The answer may also be a tie (effects that these data cannot tell apart), nothing, or something systematic that
    the catalogue does not have: then it is said in which axes, and which signals it follows. `bench list effects` is
    the catalogue, `bench show EFFECT` explains one. The numbers are those of this step; `bench extend` fits them once
    more, so that free runs meet the measurements, with intervals that are a little wider.

    \b
    bench discover flights/
    bench discover flights/ --without ground_effect        what else would explain it?
    bench discover flights/ --catalogue rotor_drag --catalogue linear_drag
    """
    names = chosen(catalogue, without)
    subject, model = data.load()

    from bench.diagnose.discover import discover
    from bench.diagnose.select.catalogue import check_catalogue
    from bench.diagnose.summaries import parameter_estimates

    check_catalogue(subject, model or subject.model, catalogue)
    with announcer(options.console(), stages.DISCOVER) as tick:
        print_problems(subject)
        found = discover(subject if model is None else replace(subject, model=model), names, tick)
    show_discovery(options.console(), found)
    effects = [
        {
            "id": f.id,
            "parameters": {n: asdict(p) for n, p in parameter_estimates(f.estimates).items()},
            "indistinguishable_from": list(f.rivals),
        }
        for f in found.found
    ]
    left = [{"axis": t.axis, "follows": t.signal} for t in found.traces]
    write_json(to_json, {"dataset": subject.name, "effects": effects, "unexplained": left})
    if found.found:
        print_next(data.next_command("extend", "--add", found.found[0].id), "add it, and see the error fall")
    elif found.verdict == "unknown_effect":
        print_next(data.next_command("extend", "--add", "learned"), "describe it by terms of its own")


@click.command("extend")
@data_options
@_horizon
@click.option(
    "--add",
    multiple=True,
    required=True,
    metavar="EFFECT",
    help='Effect to add; "learned" or "AXIS ~ SIGNAL" learns what no catalogue has. Repeatable, in order.',
)
@_out
@options.results
@options.tracking
@click.option("--no-track", is_flag=True, help="Leave MLflow alone.")
def extend_command(
    data: DataOptions,
    horizon: float | None,
    to_json: Path | None,
    add: tuple[str, ...],
    out: Path | None,
    results: Path,
    tracking: str | None,
    no_track: bool,
) -> None:
    """Step 4: add effects to the model, fit all of it again, and see the error fall on recordings not fitted.

    Writes model.toml, which holds every constant and effect with its fitted numbers; edit it as you like, and start
    from it with --model. Each addition is an MLflow run, so that `bench ui` draws the falling error.

    \b
    bench extend flights/ --add rotor_drag
    bench discover flights/ --model flights/diagnosis/model.toml            what else?
    bench extend flights/ --model flights/diagnosis/model.toml --add inflow_thrust_loss
    bench extend flights/ --add learned                                     terms that no catalogue has
    bench extend flights/ --add "force_z ~ height"                          one that you suspect
    """
    check_effects(add)
    subject, model = data.load()

    from bench.diagnose.extend import extend

    start, folder = model or subject.model, folder_for(data.source, out)
    with announcer(options.console()) as tick:
        print_problems(subject)
        done = extend(subject, start, add, tick, horizon_s=horizon)
    target = folder / "model.toml"
    written = write_model(target, done.model, done.effects)
    console = options.console()
    show_extension(console, done, data.model_file)
    print_written(console, written)
    errors = {s.name: s.error for s in done.stages}
    write_json(to_json, {"dataset": subject.name, "error": errors, "effects": [asdict(e) for e in done.effects]})
    if not no_track:
        track_extension(subject, start, done, tracking, results, target)
    print_next(replace(data, model_file=target).next_command("discover"), "what is still missing")


@click.command("diagnose")
@data_options
@_horizon
@_choice
@ignore_option
@click.option("--vehicle", "vehicles", multiple=True, metavar="NAME", help="Of a fleet, this one only. Repeatable.")
@click.option("--each-recording", is_flag=True, help="Diagnose every recording by itself, as if each were a vehicle.")
@click.option(
    "--ceiling",
    "asks_network",
    is_flag=True,
    help="Can these signals predict more than the model does? Trains networks (seeds 0, 1 and 2): 2 to 5 minutes more.",
)
@_out
@execution_options
def diagnose_command(
    data: DataOptions,
    horizon: float | None,
    to_json: Path | None,
    catalogue: tuple[str, ...],
    without: tuple[str, ...],
    ignore: tuple[str, ...],
    vehicles: tuple[str, ...],
    each_recording: bool,
    asks_network: bool,
    out: Path | None,
    execution: Execution,
) -> None:
    """All four steps: compare, locate, discover, extend; a summary here, a page and a model to keep.

    Writes diagnosis.html (one offline page), diagnosis.json and model.toml. Five honest answers: named effects, a tie,
    nothing, an unknown effect (described by learned terms), or a data problem, which stops the analysis: spikes, a
    frozen sensor, a swapped sign or a wrong clock would be taken for physics.

    \b
    bench diagnose flights/                                a folder with a dataset.toml (`bench data init` drafts it)
    bench diagnose nanobench --set gyroscope=true          a registered data set, with an option of it
    bench diagnose flights/ --system mine.py:Tailsitter    your own physics
    bench diagnose flights/ --without mass --out second/   another look
    bench diagnose flights/ --ignore-problem spike --exclude flight_3
    bench diagnose flights/ --ceiling                      is anything left that these signals tell?

    Six flights of 30 s at 100 Hz take about a minute of two processors, 25 minutes of flight about eight. On Linux
    up to four share the work; `taskset -c 0 bench diagnose flights/` keeps it to one, with the same answer.

    A fleet is a folder of such folders, one a vehicle, or one folder whose dataset.toml names the column that holds
    the vehicle, `vehicle = {column = "tail"}`. Each is diagnosed by itself; fleet.html says which lack what, which
    differ from the others and, where they are dated, which drift. What is finished is kept: after Ctrl-C or a crash
    the same command goes on. Vehicles that cannot be diagnosed are listed, and the exit code is then 2.

    \b
    bench diagnose fleet/ --workers 8                      vehicles side by side, one process each
    bench diagnose fleet/ --cluster tcp://127.0.0.1:8786   on the workers of a Dask cluster
    bench diagnose fleet/ --vehicle N7 --vehicle N9        these two only
    bench diagnose flights/ --each-recording               each flight by itself: in what do they differ?
    """
    names, folder = chosen(catalogue, without), folder_for(data.source, out)
    if fleet := fleets.fleet_of(data.source, vehicles, execution, data.exclude, each_recording):
        _refuse_for_fleets(asks_network, data.settings)
        wanted = fleets.fleet_options(
            data.system, data.model_file, horizon, catalogue=catalogue, without=without, ignore=ignore
        )
        return fleets.diagnose_fleet(data.source, fleet, wanted, folder, to_json, execution)
    given = [data.measured(catalogue)]  # popped: not to be held
    from bench.diagnose.diagnose import diagnose

    with announcer(options.console(), stages.DIAGNOSE) as tick:
        subject = given[0] if asks_network else None
        found, extended = diagnose(given.pop(), tick=tick, catalogue=names, horizon_s=horizon, ignore=ignore)
    again = data.asked(out, catalogue=catalogue, without=without, ignore_problem=ignore)
    found = replace(found, evidence=replace(found.evidence, source=data.source, asked=again))
    print_diagnosis(found)
    _written(found, extended, folder, to_json)
    if subject is not None and found.verdict != "data_problem":
        _written(with_network(found, subject, extended, horizon), extended, folder, to_json)


def _refuse_for_fleets(ceiling: bool, settings: tuple[str, ...]) -> None:
    for option, given in (("--ceiling", ceiling), ("--set", settings)):
        if given:
            raise BenchError(f"{option} is for one vehicle: give the folder of that one.")


def _written(found: "Diagnosis", model: "PhysicsModel", folder: Path, to_json: Path | None) -> None:
    """Write page, figures and model, and say so."""
    from bench.diagnose.report.output_folder import write

    written = write(folder, found, model)
    if to_json is not None:
        found.write(to_json)
    print_written(options.console(), written)
