"""`bench run`: a study or one configuration, from data to table, figure and MLflow page; `bench settle`: more seeds."""

import sys
from pathlib import Path

import click
from rich.markup import escape

from bench.cli import options
from bench.cli.execution_options import Execution, execution_options
from bench.cli.names import check_dataset, check_request
from bench.experiment import study
from bench.experiment.seeds import MOST_SEEDS
from registry.errors import BenchError

ALL = "all"


@click.command("run")
@click.argument("target", metavar="STUDY|SPEC|all")
@options.dataset
@click.option(
    "--preset",
    type=click.Choice(study.PRESETS),
    default="laptop",
    show_default=True,
    help="Size of a study. Simulated data are as many as the paper's, for smoke a small part of them.",
)
@click.option(
    "--seeds", type=click.IntRange(1, 100), help="How many seeds. Default: 1 of a SPEC, of a study what its preset has."
)
@options.horizon
@options.outputs
@click.option(
    "--physics",
    type=click.Path(exists=True, dir_okay=False, resolve_path=True),
    metavar="MODEL.TOML",
    help="The physics of `physics` and `Hybrid`, as `bench diagnose` and `bench extend` write it; default: nominal.",
)
@click.option("--only", multiple=True, metavar="PATTERN", help="Of a study, only configurations like this one.")
@options.assignments
@execution_options
@click.option("--dry-run", is_flag=True, help="Say what would be run and how long it would take; train nothing.")
@click.pass_context
def run_command(
    ctx: click.Context,
    target: str,
    dataset: str | None,
    preset: str,
    seeds: int | None,
    horizon: int | None,
    outputs: str | None,
    physics: str | None,
    only: tuple[str, ...],
    assignments: tuple[str, ...],
    execution: Execution,
    dry_run: bool,
) -> None:
    """Run a STUDY of the paper (`bench list studies`), one configuration SPEC, or all studies.

    SPEC is the paper's notation: predictor: layers x size - initializer: [size x] history.

    \b
    bench run washout_vs_mlp
    bench run washout_vs_mlp --dataset nanodrone --seeds 6
    bench run mlfc_vs_lstm --only "MLFC A_o: *"          some of its configurations, beside the baselines
    bench run "LSTM: 2x50 - MLP: 100x10" --dataset nanodrone --seeds 3 -T 190
    bench run quadrotor_hybrid --dataset my_flights --physics my_flights/diagnosis/model.toml
    bench run all --dry-run                              what the lot would cost
    bench run all --cluster tcp://127.0.0.1:8786         workers of a Dask cluster

    Runs that are already recorded are not trained again: after Ctrl-C, a crash or a power cut, the same command
    goes on where it stopped.
    """
    changes = options.parsed(assignments)
    if target == ALL:
        check_dataset(dataset)
    else:
        check_request(ctx, target, dataset)

    from bench.cli.cost import estimate
    from bench.cli.job import Job, carry_out
    from bench.execution import engine
    from bench.experiment.request import Options, by_owner, request
    from bench.training.split import remarks

    out = options.console()
    asked = Options(dataset, preset, seeds, *by_owner(changes, horizon, outputs), physics, only)
    planned = []
    for name in study.titles() if target == ALL else [target]:
        try:
            made = Job(request(name, asked), [name if a == ALL else a for a in sys.argv[1:]])
            for sentence in remarks(made.configs[0]):
                out.print(escape(sentence), highlight=False)
            planned.append((made, engine.plan(made.configs, execution.runs)))
        except BenchError as error:
            if target != ALL:
                raise
            out.print(f"{escape(name)} is left out: {escape(str(error))}")
    if dry_run:
        estimate(out, planned, execution)
        return
    for made, todo in planned:
        carry_out(out, made, todo, execution)


@click.command("settle")
@click.argument("target", metavar="[STUDY|CLAIM]", required=False)
@click.option("--dataset", metavar="NAME", callback=options.not_empty, help="Only claims on this data set.")
@click.option(
    "--budget",
    type=options.Duration(),
    default="1h",
    show_default=True,
    help="Time to spend, such as 45m or 1h30m; trainings that are not expected to end within it are not begun.",
)
@click.option(
    "--max-seeds",
    "most",
    type=click.IntRange(2, MOST_SEEDS),
    default=MOST_SEEDS,
    show_default=True,
    help="Seeds a configuration, those that are there included.",
)
@click.option(
    "--claims", "file", type=click.Path(path_type=Path, dir_okay=False), help="Default: results/paper/claims.toml."
)
@click.option(
    "--published", type=click.Path(path_type=Path, file_okay=False), help="Default: the checkout's results/published."
)
@execution_options
@click.option("--dry-run", is_flag=True, help="Say what is open, what would settle it and how long; train nothing.")
def settle_command(
    target: str | None,
    dataset: str | None,
    budget: float,
    most: int,
    file: Path | None,
    published: Path | None,
    execution: Execution,
    dry_run: bool,
) -> None:
    """Train more seeds of a study until its open claims have a verdict, or the budget is gone.

    Open are claims that `bench check` finds "not enough evidence" for. Some need more trainings, some more recordings,
    some are too near a limit for either: the plan says which, and how long it takes. Then every configuration that
    they are about gets one more seed, claims are judged again, and so on.

    \b
    bench settle --dry-run                       what is open, and what it would take
    bench settle mlfc_vs_lstm                    the open claims of one study
    bench settle fewer-weights --budget 30m      one claim, half an hour at most
    bench settle --dataset helicopter_twin --max-seeds 6

    Each look at the growing evidence takes its share of the 5 % of verdicts that may be wrong, so that to stop where a
    verdict is found makes no more of them wrong; see docs/explanations/claims.md. No seed is chosen: they are 0, 1, 2
    and so on. Evidence of `bench run STUDY --seeds N` counts, and the records are the same, bit for bit. After Ctrl-C,
    a crash or a power cut, the same command goes on where it stopped.
    """
    from bench.api.check import published_folder, refuse_spoilt
    from bench.cli.settling import plan, settle, show_plan, show_result
    from bench.settle.sources import Scope

    check_dataset(dataset)
    refuse_spoilt(published)
    wanted = Scope(execution.results, published_folder(published), file, target, dataset, most)
    wanted.check()
    out = options.console()
    steps = plan(out, wanted, execution)
    if not steps:
        out.print("Nothing is open: every claim that was asked for has its verdict.")
        return
    show_plan(out, steps, wanted, execution)
    if dry_run or not any(s.reachable(most) for s in steps):
        return
    settle(out, steps, wanted, execution, budget)
    show_result(out, steps, wanted)
