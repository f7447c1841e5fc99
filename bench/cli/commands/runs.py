"""`bench runs` and `bench predict`: the records in the results folder, and a recorded model on new inputs."""

import json
import shutil
from pathlib import Path

import click
from rich.markup import escape
from rich.table import Table

from bench.cli import options
from registry.atomic_io import writing
from registry.errors import BenchError, near
from registry.units import is_listed, to_si


@click.group("runs")
def runs_command() -> None:
    """Recorded runs: list, show, compare bit by bit, prune."""


@runs_command.command("list")
@options.results
@click.option("--dataset", help="Only this data set.")
def list_command(results: Path, dataset: str | None) -> None:
    """One line a run."""
    from bench.records import record

    table = Table(box=None, header_style="bold", pad_edge=False)
    for name in ("key", "spec", "dataset", "outputs", "T", "seed", "status", "RMSSE (SI)"):
        table.add_column(name, no_wrap=name != "outputs")
    found = [r.summary for r in record.all_records(results / "runs")]
    known = {s["dataset"] for s in found}
    if dataset and found and dataset not in known:
        raise BenchError(f"No run in {results / 'runs'} is of {dataset!r}: {near(dataset, known)}")
    for s in found:
        if dataset and s["dataset"] != dataset:
            continue
        first = next(iter(s["metrics"].values()), None)
        value = "–" if first is None else f"{first:.4g}"
        outputs = ", ".join(_signals(s["outputs"]))
        cells = (s["key"][:12], s["spec"], s["dataset"], outputs, str(s["horizon"]), str(s["seed"]), s["status"], value)
        table.add_row(*map(escape, cells))
    out = options.console()
    none = escape(f"No runs in {results / 'runs'} yet: start one with `bench run washout_vs_mlp`.")
    out.print(table if found else none)


@runs_command.command("show")
@click.argument("key")
@options.results
def show_command(key: str, results: Path) -> None:
    """Configuration, metrics and files of the run whose key begins with KEY."""
    from bench.records import record

    r = record.find(results / "runs", key)
    out = options.console()
    out.print(f"[bold]{escape(r.summary['spec'])}[/]  {escape(str(r.folder))}")
    out.print_json(json.dumps({k: v for k, v in r.summary.items() if k != "files"}))
    out.print("configuration")
    out.print_json(json.dumps(r.config))
    broken = record.verify(r)
    out.print(f"[red]altered since it was written: {escape(', '.join(broken))}[/]" if broken else "files: as written")


def _signals(outputs: list[str]) -> list[str]:
    """Channels, a signal's name in the place of its three axes."""
    groups = [name.partition(".")[0] for name in outputs]
    return list(dict.fromkeys(g if groups.count(g) == 3 else name for g, name in zip(groups, outputs, strict=True)))


@runs_command.command("errors")
@click.argument("keys", nargs=-1, metavar="[KEY]...")
@click.option("--study", metavar="NAME", help="The runs of a finished study: a folder in RESULTS/studies.")
@click.option("--at", default="1,10,40", show_default=True, metavar="STEPS", help="Prediction steps to print.")
@click.option("--norm", type=click.Choice(("paper", "euclidean", "axis")), help="Only this norm.")
@click.option("--si", is_flag=True, help="rad/s and rad instead of degrees.")
@options.results
def errors_command(
    keys: tuple[str, ...], study: str | None, at: str, norm: str | None, si: bool, results: Path
) -> None:
    """Mean error of runs at some prediction steps, and its sum over all of them.

    Runs that differ in their seed only share a line: the mean over seeds, and the spread of the sum.
    """
    import pandas as pd

    from bench.records import record

    runs = [record.find(results / "runs", key) for key in (*keys, *_of_study(results, study))]
    if not runs:
        raise BenchError("Name runs by their keys (`bench runs list` shows them) or a study with --study.")
    horizon = min(r.summary["horizon"] for r in runs)
    steps = [int(s) for s in at.split(",") if s.strip().isdecimal() and 1 <= int(s) <= horizon]
    if not steps:
        raise BenchError(f"--at {at!r} names no step from 1 to {horizon}: write such as 1,10,{horizon}.")
    table = Table(box=None, header_style="bold", padding=(0, 2, 0, 0), pad_edge=False)
    words = ("quantity", "configuration", "seeds", "norm", "unit")
    for name in (*words, *(f"h = {s}" for s in steps), f"sum 1..{horizon}", "over seeds"):
        table.add_column(name, justify="left" if name in words else "right", no_wrap=name not in words[:2])
    frames = [
        r.steps[(r.steps.statistic == "mean") & (r.steps.step <= horizon)].assign(spec=r.summary["spec"], run=i)
        for i, r in enumerate(runs)
        if r.finished
    ]
    means = pd.concat(frames) if frames else pd.DataFrame(columns=["quantity", "norm", "unit", "spec"])
    means = means.sort_values("quantity", key=lambda q: q.map(list(dict.fromkeys(q)).index), kind="stable")
    for (quantity, kind, unit, spec), rows in means.groupby(["quantity", "norm", "unit", "spec"], sort=False):
        if norm in (None, kind):
            shown, factor = to_si(unit) if si and is_listed(unit) else (unit, 1.0)
            values = rows.pivot(index="step", columns="run", values="value") * factor
            sums = values.sum()
            spread = f"{sums.min():.2f} to {sums.max():.2f}" if len(sums) > 1 else ""
            cells = [f"{values.loc[s].mean():.4f}" for s in steps]
            table.add_row(
                *map(escape, (quantity, spec, str(len(sums)), kind, shown, *cells, f"{sums.mean():.2f}", spread))
            )
    out = options.console()
    datasets = dict.fromkeys(f"{r.summary['dataset']}, {r.summary['windows']['test']} test windows" for r in runs)
    out.print("; ".join(datasets), markup=False)
    out.print(table)


def _of_study(results: Path, study: str | None) -> list[str]:
    if study is None:
        return []
    folder = results / "studies" / study
    if not (folder / "study.json").is_file():
        known = ", ".join(sorted(p.parent.name for p in (results / "studies").glob("*/study.json"))) or "none"
        raise BenchError(f"There is no finished study {study!r} in {results / 'studies'}: {known}.")

    from bench.records.finished import finished_study

    return finished_study(folder / "study.json").keys


@runs_command.command("diff")
@click.argument("first")
@click.argument("second")
@options.results
def diff_command(first: str, second: str, results: Path) -> None:
    """Where two runs differ: options, metrics, files. FIRST and SECOND are keys or record folders."""
    from bench.records import record

    a, b = (record.find(results / "runs", k) for k in (first, second))
    left, right = (_flat({"config": r.config, "metrics": r.summary["metrics"]}) for r in (a, b))
    table = Table(box=None, header_style="bold", pad_edge=False)
    for name in ("", a.folder.name[:12], b.folder.name[:12]):
        table.add_column(escape(name))
    for name in sorted(left.keys() | right.keys()):
        if left.get(name) != right.get(name):
            table.add_row(*map(escape, (name, str(left.get(name, "–")), str(right.get(name, "–")))))
    out = options.console()
    files = record.differences(a, b)
    if table.row_count:
        out.print(table)
    out.print(f"Files that differ: {', '.join(files)}." if files else "Bit-equal, provenance aside.", markup=False)


def _flat(nested: object, prefix: str = "") -> dict[str, object]:
    if isinstance(nested, dict):
        return {k: v for name, inner in nested.items() for k, v in _flat(inner, f"{prefix}{name}.").items()}
    return {prefix.rstrip("."): nested}


@runs_command.command("prune")
@options.results
@click.option("--diverged", is_flag=True, help="Remove diverged runs too (they are trained again when asked for).")
@click.option("--yes", is_flag=True, help="Do not ask.")
def prune_command(results: Path, diverged: bool, yes: bool) -> None:
    """Remove what a kill left behind: drafts, checkpoints of groups, records whose files were altered."""
    from bench.execution import lock
    from bench.records import record

    runs = results / "runs"
    busy = lock.holders(results / "studies")
    if busy:
        raise BenchError(f"Runs are being made ({'; '.join(busy)}): prune when that has ended.")
    doomed = [*runs.glob(".draft-*"), *runs.glob(".damaged-*"), *runs.glob(".partial")]
    doomed += [r.folder for r in record.all_records(runs) if record.verify(r) or (diverged and not r.finished)]
    if not doomed:
        click.echo("Nothing to remove.")
        return
    for path in doomed:
        click.echo(f"  {path}")
    if yes or click.confirm(f"Remove these {len(doomed)}?"):
        for path in doomed:
            shutil.rmtree(path)
        click.echo("Removed.")


@click.command("predict")
@click.argument("run")
@click.option(
    "--input", "source", type=click.Path(path_type=Path), required=True, help="CSV or Parquet, one row a sample."
)
@click.option("--output", "-o", type=options.Output(), help="CSV or Parquet; default: CSV on the terminal.")
@options.results
def predict_command(run: str, source: Path, output: Path | None, results: Path) -> None:
    """Predict with a recorded RUN (the first characters of its key, see `bench runs list`).

    The input has one column a channel in SI units, named as `bench runs show RUN` lists them, at the run's sample
    rate. Its first rows, as many as the run's history, need the measured outputs too; every later row is one
    predicted step, whose `time_s` counts from the last row of the history.
    """
    from bench.records import record
    from bench.training import predict

    predicted = predict.predict_table(record.find(results / "runs", run), predict.read_table(source), str(source))
    if output is None:
        click.echo(predicted.to_csv(index=False), nl=False)
        return
    with writing(output):
        if output.suffix == ".parquet":
            predicted.to_parquet(output, index=False)
        else:
            predicted.to_csv(output, index=False)
    click.echo(f"Wrote {len(predicted)} predicted steps to {output}.")
