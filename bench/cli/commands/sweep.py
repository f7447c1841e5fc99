"""`bench sweep`: better options for a configuration, or the best configuration of a study, found by trial."""

import shlex
import sys
from pathlib import Path

import click

from bench.cli import options
from bench.cli.execution_options import Execution, execution_options, portable
from bench.cli.names import check_request
from bench.experiment import study
from registry.errors import BenchError


@click.command("sweep")
@click.argument("target", metavar="STUDY|SPEC")
@options.dataset
@click.option("--trials", type=click.IntRange(1, 100_000), default=30, show_default=True, help="Trials in all.")
@click.option(
    "--search",
    "searches",
    multiple=True,
    metavar="OPTION=LOW:HIGH[:log]",
    help="Search this range of an option, or these values of it (OPTION=A,B,C), in place of its default range or "
    "besides the options searched by default. May be repeated.",
)
@options.assignments
@click.option(
    "--objective",
    "objectives",
    multiple=True,
    type=click.Choice(["rmsse", "weights", "latency"]),
    help="Minimise this beside the error (rmsse, which always is). With weights or latency (of one prediction, in ms) "
    "the answer is a Pareto front, and no trial is stopped early.",
)
@options.horizon
@options.outputs
@click.option("--preset", type=click.Choice(study.PRESETS), default="laptop", show_default=True, help="Of a STUDY.")
@click.option(
    "--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True, help="Seed of the optimiser's proposals."
)
@click.option("--name", help="Of the sweep's folder, `<results>/sweeps/NAME`; default: made of what is searched.")
@click.option("--resume", is_flag=True, help="Go on with a sweep that was stopped or killed, or add trials to it.")
@execution_options
@click.option("--dry-run", is_flag=True, help="Say what would be searched and how long it would take; train nothing.")
@click.pass_context
def sweep_command(
    ctx: click.Context,
    target: str,
    dataset: str | None,
    trials: int,
    searches: tuple[str, ...],
    assignments: tuple[str, ...],
    objectives: tuple[str, ...],
    horizon: int | None,
    outputs: str | None,
    preset: str,
    seed: int,
    name: str | None,
    resume: bool,
    execution: Execution,
    dry_run: bool,
) -> None:
    """Search the options of a SPEC, or the configurations of a STUDY, for the smallest error on the validation part.

    \b
    bench sweep "LSTM: 1x50 - MLP: 60x10" --dataset nanodrone --trials 30 --workers 2
    bench sweep "LSTM: 1x50 - MLP: 60x10" --search predictor.hidden=10:200:log --set predictor.layers=1
    bench sweep washout_vs_mlp --trials 20               which of its configurations, with which learning rate
    bench sweep "LSTM: 1x50 - MLP: 60x10" --objective weights
    bench sweep "LSTM: 1x50 - MLP: 60x10" --trials 60 --resume
    bench sweep "LSTM: 1x50 - MLP: 60x10" --cluster tcp://127.0.0.1:8786

    Of a SPEC, sizes and learning rate are searched (`--dry-run` lists the ranges); what you name is the first trial.
    Of a STUDY, every configuration that is trained is a choice, on the study's first outputs and horizon (choose
    others with --outputs and -T), and the learning rate is searched along. An option given with --set is not searched.

    Each trial trains on the training part and is judged on the validation part (RMSSE of the outputs, each in units of
    its standard deviation). Optuna's TPE proposes; a trial that is worse than the median of the others at the same
    update is stopped (on a cluster where workers see the results folder; elsewhere it goes to its end). Where the
    learning rate alone is searched, the sizes being given with --set, a process trains up to nine trials at once, which
    is faster. At the end the best configuration and the default one are trained from three fresh seeds and compared on
    the validation and, for the first time, on the test part.

    No finished trial is lost: after Ctrl-C, a crash or a power cut, the same command with --resume goes on.
    """
    changes = options.parsed(assignments)
    check_request(ctx, target, dataset)

    from bench.cli.sweeping import carry_out, estimate
    from bench.experiment.request import Options, by_owner
    from bench.sweep.request import request

    out = options.console()
    asked = Options(dataset, preset, None, *by_owner(changes, horizon, outputs))
    sweep = request(target, asked, searches, objectives, seed, shlex.join(["bench", *portable(sys.argv[1:])]))
    folder = _folder(execution.results, name, sweep.title, resume)
    if dry_run:
        estimate(out, sweep, trials, execution)
        return
    try:
        carry_out(out, sweep, folder, trials, resume, execution)
    except KeyboardInterrupt:
        again = shlex.join(["bench", *(a for a in sys.argv[1:] if a != "--resume"), "--resume"])
        click.echo(f"\nbench: stopped. Every finished trial is kept; go on with {again}", err=True)
        sys.exit(130)


def _folder(results: Path, name: str | None, title: str, resume: bool) -> Path:
    """Where the sweep is kept.

    Raises:
        BenchError: ``name`` names no folder, or there is nothing to resume.
    """
    from bench.records.finished import slug
    from bench.sweep import journal as sweeps

    if name is not None and (not slug(name) or not set(name).isdisjoint("/\\")):
        raise BenchError(f"--name {name!r} is no name of a folder: use letters and digits.")
    folder = results / "sweeps" / slug(name or title)
    if resume and not (folder / sweeps.DEFINITION).is_file():
        there = "; ".join(f.name for f in sweeps.sweeps(results)) or "none"
        raise BenchError(
            f"There is no sweep in {folder} to go on with: leave --resume out, or repeat the command of one of those "
            f"in {results} with its --name ({there})."
        )
    return folder
