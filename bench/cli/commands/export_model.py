"""`bench export-model`: a physics model as a file that other programs take."""

from pathlib import Path

import click

from bench.cli import options
from bench.cli.names import check_system
from registry.errors import BenchError

ENDINGS = {"numpy": ".py", "casadi": ".casadi"}


@click.command("export-model")
@click.argument("model", metavar="MODEL.toml", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--to", "target", type=click.Choice(list(ENDINGS)), required=True, help="What will read it.")
@click.option("--out", type=options.Output(made=True), help="The file; default: MODEL.py or MODEL.casadi, beside it.")
@click.option(
    "--rate",
    type=options.Positive(1e6),
    default=100.0,
    show_default=True,
    metavar="HZ",
    help="Of the inputs: the length of a step.",
)
@click.option(
    "--system", metavar="NAME|FILE.py:CLASS", help="Your own class of physics; default: what MODEL.toml names."
)
def export_model_command(model: Path, target: str, out: Path | None, rate: float, system: str | None) -> None:
    """Write a physics model with its effects for use elsewhere.

    \b
    numpy    one Python file that needs numpy alone: derivative, step, simulate; arrays of any batch shape
    casadi   functions of symbols for MPC and estimation: MODEL.casadi is the derivative, MODEL_step.casadi one
             Runge-Kutta step, MODEL_initial.casadi the full state after rest; needs the extra `export`

    \b
    bench export-model diagnosis/model.toml --to numpy --out quadrotor.py
    bench export-model diagnosis/model.toml --to casadi --rate 50

    Delays, lags and swinging loads come along. Their length in samples rests on --rate.
    """
    out = out or model.with_suffix(ENDINGS[target])
    if out.suffix != ENDINGS[target]:
        raise BenchError(f"--out {out}: what {target} reads ends in {ENDINGS[target]}.")
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
