"""`bench design`: the manoeuvre that would tell what a diagnosis could not."""

from pathlib import Path

import click

from bench.cli import options
from bench.cli.diagnosing import check_effects, check_writable, folder_for, load, say_next, write_json
from bench.cli.progress import announcer
from registry.errors import BenchError


def parse_limits(given: tuple[str, ...]) -> dict[str, tuple[float, float, float | None]]:
    """By signal (low, high, rate or None), of "SIGNAL=LOW:HIGH" or "SIGNAL=LOW:HIGH:RATE".

    Raises:
        BenchError: another form, or no finite numbers.
    """
    import math

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
@click.argument("source", metavar="DATA", callback=options.named)
@click.option(
    "--seconds",
    type=options.Positive(1e6),
    multiple=True,
    metavar="S",
    help="Lengths to speak of; the shortest is that of the manoeuvre. Repeatable; default: 10, 30 and 60.",
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
    "--model",
    "model_file",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The model.toml to design with; default: that of the diagnosis. Its diagnosis.json lies beside it.",
)
@click.option(
    "--system",
    metavar="NAME|FILE.py:CLASS",
    help="Physics model: one of `bench list physics`, or your own class; default: what the data name.",
)
@click.option(
    "-o", "--output", type=options.Output(made=True), help="The CSV; default: design.csv beside the diagnosis."
)
@click.option("--json", "to_json", type=options.Output(made=True), help="Write the figures there too.")
def design_command(
    source: str,
    seconds: tuple[float, ...],
    limits: tuple[str, ...],
    between: tuple[str, ...],
    model_file: Path | None,
    system: str | None,
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
    folder = folder_for(source, None)
    target = output or folder / "design.csv"
    check_writable(target.parent, to_json)
    file = model_file or folder / "model.toml"
    if not file.is_file() and (model_file is not None or not between):
        raise BenchError(f"There is no {file}: `bench diagnose {source}` writes it, and designs go out from it.")
    subject, model = load(source, system, file if file.is_file() else None)

    from bench.diagnose.design import design
    from bench.diagnose.report import design_page

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
    for line in design_page.sentences(found):
        click.echo(f"  {line}")
    page = target.with_suffix(".html")
    design_page.write_csv(target, found)
    design_page.write_page(page, found)
    write_json(to_json, {"dataset": found.dataset, "rows": found.to_frame().to_dict("records")})
    click.echo(f"\nWrote {target}, {page}")
    say_next(f"bench diagnose {source}", "with its recordings beside the others")
