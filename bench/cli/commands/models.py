"""What a diagnosed model is good for: `bench design`, the next flight, and `bench export-model`, other programs."""

import math
from dataclasses import replace
from pathlib import Path

import click

from bench.cli import options
from bench.cli.data_options import DataOptions, data_options_after_diagnosis
from bench.cli.diagnosing import check_effects, folder_for, print_next, write_json
from bench.cli.names import check_system
from bench.cli.progress import announcer
from registry.errors import BenchError

ENDINGS = {"numpy": ".py", "casadi": ".casadi", "onnx": ".onnx"}


@click.command("export-model")
@click.argument("model", metavar="MODEL.toml|KEY", callback=options.not_empty)
@click.option("--to", "target", type=click.Choice(list(ENDINGS)), required=True, help="What will read it.")
@click.option("--out", type=options.Output(made=True), help="The file; default: as MODEL.toml, beside it, or as KEY.")
@click.option(
    "--rate",
    type=options.Positive(1e6),
    metavar="HZ",
    help="Of the inputs of a physics model: the length of a step.  [default: 100]",
)
@click.option(
    "--system", metavar="NAME|FILE.py:CLASS", help="Your own class of physics; default: what MODEL.toml names."
)
@options.results
def export_model_command(
    model: str, target: str, out: Path | None, rate: float | None, system: str | None, results: Path
) -> None:
    """Write a physics model with its effects, or a trained network, for use elsewhere.

    \b
    numpy    one Python file that needs numpy alone: derivative, step, simulate; arrays of any batch shape
    casadi   functions of symbols for MPC and estimation: MODEL.casadi is the derivative, MODEL_step.casadi one
             Runge-Kutta step, MODEL_initial.casadi the full state after rest; needs the extra `export`
    onnx     the network of a run, with initializer and scalers: from measured history (past_inputs, past_outputs)
             and inputs to outputs, SI units, any number of windows and steps; needs the extra `onnx`

    \b
    bench export-model diagnosis/model.toml --to numpy --out quadrotor.py
    bench export-model diagnosis/model.toml --to casadi --rate 50
    bench export-model 3f2a --to onnx --out network.onnx        a run, by the first characters of its key

    Delays, lags and swinging loads come along. Their length in samples rests on --rate. `bench runs list` shows the
    keys of runs; an ONNX file names its signals, units and rate in its metadata, and is held against `bench predict`
    before it is written.
    """
    if target == "onnx":
        _export_network(model, out, results, [f"--{n}" for n, v in (("rate", rate), ("system", system)) if v])
    else:
        _export_physics(Path(model), target, out, rate or 100.0, system)


def _export_network(key: str, out: Path | None, results: Path, foreign: list[str]) -> None:
    if foreign:
        raise BenchError(f"{foreign[0]} is for physics models: a network is written at the rate of its run.")
    if key.endswith(".toml"):
        raise BenchError(f"{key} is a physics model, which goes --to numpy or casadi: name a run (`bench runs list`).")
    _check_ending(out, "onnx")

    from bench.export import onnx_file
    from bench.records import record

    run = record.find(results / "runs", key)
    out = out or Path(f"{run.key[:12]}.onnx")
    apart = onnx_file.write(out, run)
    s = run.summary
    click.echo(f"{s['spec']} on {s['dataset']}, {s['rate_hz']:g} Hz, {s['history']} samples of history: {out}")
    click.echo(
        f"Over {s['horizon']} steps of {onnx_file.CHECKED} made-up windows, within {apart:.1g} of the outputs' "
        "deviation of `bench predict`."
    )


def _check_ending(out: Path | None, target: str) -> None:
    if out is not None and out.suffix != ENDINGS[target]:
        raise BenchError(f"--out {out}: what {target} reads ends in {ENDINGS[target]}.")


def _export_physics(model: Path, target: str, out: Path | None, rate: float, system: str | None) -> None:
    _check_ending(out, target)
    if not model.suffix and not model.exists():
        raise BenchError(f"{model} is no file: {target} takes a model.toml; the network of a run goes --to onnx.")
    out = out or model.with_suffix(ENDINGS[target])
    if target == "numpy" and not out.stem.isidentifier():
        raise BenchError(f"--out {out}: Python imports no such name; use letters, digits and _.")
    check_system(system)

    from bench.diagnose.logs.own_system import own_class
    from bench.export.equations import equations
    from registry.model_file import read

    kind = own_class(system) if system and system.rpartition(":")[0].endswith(".py") else system or ""
    found = equations(read(model, kind), 1 / rate)
    if target == "numpy":
        from bench.export import numpy_file

        written = [numpy_file.write(out, found)]
    else:
        from bench.export import casadi_file

        written = casadi_file.write(out, found)
    click.echo(f"{found.about}, {rate:g} Hz: {', '.join(map(str, written))}")


def parse_limits(given: tuple[str, ...]) -> dict[str, tuple[float, float, float | None]]:
    """By signal (low, high, rate or None), of "SIGNAL=LOW:HIGH" or "SIGNAL=LOW:HIGH:RATE".

    Raises:
        BenchError: another form, or no finite numbers.
    """
    out: dict[str, tuple[float, float, float | None]] = {}
    for text in given:
        name, _, ends = text.partition("=")
        try:
            low, high, *rate = map(float, ends.split(":"))
            if len(rate) > 1 or not all(map(math.isfinite, (low, high, *rate))) or (rate and rate[0] <= 0):
                raise ValueError
        except ValueError as error:
            raise BenchError(
                f"--limit {text}: write SIGNAL=LOW:HIGH or SIGNAL=LOW:HIGH:RATE, such as voltage=-1:1:5 "
                "(SI, the rate in the unit per second)."
            ) from error
        out[name.strip()] = (low, high, rate[0] if rate else None)
    return out


@click.command("design")
@data_options_after_diagnosis
@click.option(
    "--seconds",
    type=options.Positive(1e6),
    multiple=True,
    metavar="S",
    help="Lengths to report the chance for; the shortest is that of the manoeuvre. Repeatable; default: 10, 30 and 60.",
)
@click.option(
    "--limit",
    "limits",
    multiple=True,
    metavar="SIGNAL=LOW:HIGH[:RATE]",
    help="How far, and how fast, a signal may be driven or a state may go, SI; default: as recorded. Repeatable.",
)
@click.option(
    "--between",
    multiple=True,
    metavar="EFFECT",
    help="Tell these effects apart; default: what the diagnosis left open. Repeatable.",
)
@click.option(
    "-o", "--output", type=options.Output(made=True), help="The CSV; default: design.csv beside the diagnosis."
)
def design_command(
    data: DataOptions,
    seconds: tuple[float, ...],
    limits: tuple[str, ...],
    between: tuple[str, ...],
    output: Path | None,
    to_json: Path | None,
) -> None:
    """After a diagnosis: which input or flight would tell what these recordings could not.

    Of a tie, the candidates are simulated over many staircases and multisines, with the measured noise, and the one
    that takes them furthest apart is written: inputs over time, set-points of a vehicle that needs a pilot, or states
    from which to let an undriven system go. Without a tie, wide intervals are narrowed. Amplitudes and rates are those
    that the recordings show, and states stay where they were. Printed is the chance that a diagnosis then names the
    right candidate, and what the effect's own manoeuvre would need. Writes a CSV and, beside it, a page.

    \b
    bench diagnose rail/                                      says: a tie
    bench design rail/                                        what to do about it
    bench design rail/ --limit voltage=-1:1:5 --seconds 20    it may also be driven backwards, and faster
    bench design rail/ --between offset_force --between coulomb_friction -o next.csv
    """
    given = parse_limits(limits)
    check_effects(between)
    folder = folder_for(data.source, None)
    target = output or folder / "design.csv"
    file = data.model_file or folder / "model.toml"
    if not file.is_file() and (data.model_file is not None or not between):
        raise BenchError(f"There is no {file}: `bench diagnose {data.source}` writes it, and designs go out from it.")
    subject, model = replace(data, model_file=file if file.is_file() else None).load()

    from bench.diagnose.manoeuvre import page
    from bench.diagnose.manoeuvre.design import design

    with announcer(options.console()) as tick:
        found = design(
            subject,
            model,
            between,
            None if between else file.with_name("diagnosis.json"),
            seconds=seconds or None,
            limits=given,
            tick=tick,
        )
    click.echo(found.headline)
    for line in page.sentences(found):
        click.echo(f"  {line}")
    drawn = target.with_suffix(".html")
    page.write_csv(target, found)
    page.write_page(drawn, found)
    write_json(to_json, {"dataset": found.dataset, "rows": found.to_frame().to_dict("records")})
    click.echo(f"\nWrote {target}, {drawn}")
    print_next(replace(data, model_file=None).next_command("diagnose"), "with its recordings beside the others")
