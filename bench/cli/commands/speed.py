"""`bench speed`: what training costs on this machine, and how far that is from what the machine can do."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console
from rich.table import Table

from bench.cli import options
from bench.cli.progress import meter
from registry.atomic_io import writing
from registry.errors import BenchError

if TYPE_CHECKING:
    from bench.speed.measure import Measured
    from bench.speed.rows import Row


@click.command("speed")
@click.option("--quick", is_flag=True, help="A few small rows, briefly: that everything runs; seconds.")
@click.option(
    "--only",
    metavar="TEXT",
    multiple=True,
    callback=options.not_blank,
    help='Rows whose name holds TEXT, such as "MLFC". Repeatable.',
)
@click.option("--diagnose", is_flag=True, help="Diagnoses of 6 to 1,000 flights instead; about ten minutes.")
@click.option("--gpu", is_flag=True, help="Updates on a GPU beside one CPU thread instead; two minutes.")
@click.option("--json", "target", type=options.Output(), help="Write everything as JSON.")
def speed_command(quick: bool, only: tuple[str, ...], diagnose: bool, gpu: bool, target: Path | None) -> None:
    """Measure how fast networks train here: ms of one step, on one thread, all in turns in one run.

    With --diagnose: what a diagnosis takes as recordings become more. With --gpu: from which size on networks are
    better trained on a GPU.

    \b
    reference   the equations under autograd, a Linear a gate, a loop over the time steps
    torch.nn    nn.LSTM or nn.RNN of that size, which do less: no peepholes, nothing fed back
    PyTorch     this suite, hand-written gradients, any machine
    native      this suite, the same in C++, compiled on first use
    products    the floor: the matrix products that a step cannot do without, alone

    \b
    bench speed                                  about ten minutes
    bench speed --quick                          seconds
    bench speed --only "1x50" --json speed.json
    bench speed --diagnose                       seconds and memory of `bench diagnose`, 6 to 1,000 flights
    bench speed --gpu                            CPU or GPU? `BENCH_DEVICE` decides for all, else the size does

    A step is forward, cost, backward and fused Adam. Times are CPU time of the process, so that other load matters
    little; with two processes wall time, for which the machine should be idle.
    """
    if diagnose or gpu:
        asked = "--diagnose" if diagnose else "--gpu"
        if only or (diagnose and gpu):
            more = "--only chooses among networks" if only else "--gpu measures something else"
            raise BenchError(f"{more}: leave it out with {asked}.")
        return (_diagnoses if diagnose else _on_gpu)(options.console(), quick, target)

    from bench.speed.measure import machine, measure
    from bench.speed.timing import QUICK, Effort

    out, chosen = options.console(), _chosen(quick, only)
    host = machine()
    rows: list[Measured] = []
    try:
        with meter(out, sum(map(_cost, chosen)), len(chosen), "rows") as progress:
            for row in chosen:
                progress.start(row.name)
                rows.append(measure(row, QUICK if quick else Effort()))
                progress.tick(_cost(row))
                progress.record()
    except KeyboardInterrupt:
        out.print(f"Stopped after {len(rows)} of {len(chosen)} rows.")
    if target is not None:
        _write(target, {**host, "rows": [m.plain() for m in rows]})
    if rows:
        _show(out, host, rows)


def _diagnoses(out: Console, quick: bool, target: Path | None) -> None:
    """Diagnose more and more recordings; after Ctrl-C what is done is shown."""
    from bench.speed import diagnosis
    from bench.speed.measure import machine

    rows = diagnosis.QUICK if quick else diagnosis.ROWS
    done: list[diagnosis.Cost] = []
    try:
        with meter(out, sum(map(diagnosis.seconds, rows)), len(rows), "rows") as progress:
            for recordings in rows:
                progress.start(f"{recordings} recordings")
                with TemporaryDirectory() as folder:
                    done.append(diagnosis.measure(recordings, Path(folder)))
                progress.tick(diagnosis.seconds(recordings))
                progress.record()
    except KeyboardInterrupt:
        out.print(f"Stopped after {len(done)} of {len(rows)} rows.")
    if target is not None:
        _write(target, {**machine(), "diagnoses": [asdict(cost) for cost in done]})
    table = Table(title=f"Diagnoses of recordings of {diagnosis.SECONDS:g} s", title_justify="left")
    for title in ("recordings", "samples", "time [s]", "CPU [s]", "memory [MB]"):
        table.add_column(title, justify="right")
    table.add_column("effects named")
    for cost in done:
        table.add_row(
            f"{cost.recordings:,}",
            f"{cost.samples:,}",
            f"{cost.wall_s:.0f}",
            f"{cost.cpu_s:.0f}",
            f"{cost.peak_mb:.0f}",
            ", ".join(cost.effects),
        )
    if done:
        out.print(table)


def _on_gpu(out: Console, quick: bool, target: Path | None) -> None:
    """Updates of larger and larger networks on both; after Ctrl-C what is done is shown."""
    from bench.speed import gpu
    from bench.speed.measure import machine
    from bench.speed.timing import QUICK, Effort

    known, rows = gpu.name(), gpu.ROWS[:2] if quick else gpu.ROWS
    done: list[gpu.OnBoth] = []
    try:
        with meter(out, len(rows), len(rows), "rows") as progress:
            for row in rows:
                progress.start(row.name)
                done.append(gpu.measure(row, QUICK if quick else Effort()))
                progress.tick(1)
                progress.record()
    except KeyboardInterrupt:
        out.print(f"Stopped after {len(done)} of {len(rows)} rows.")
    if target is not None:
        _write(target, {**machine(), "gpu": known, "rows": [asdict(both) for both in done]})
    table = Table(title=f"Milliseconds of an update, wall time: one CPU thread, {known}", title_justify="left")
    for title in ("network", "T", "B", "CPU", "GPU", "trains on"):
        table.add_column(title, justify="left" if title in ("network", "trains on") else "right")
    for both in done:
        times = (f"{t:.3g}" for t in (both.cpu_ms, both.gpu_ms))
        table.add_row(both.row.spec, str(both.row.horizon), str(both.row.batch), *times, both.taken)
    if done:
        out.print(table)


def _chosen(quick: bool, only: Sequence[str]) -> "list[Row]":
    from bench.speed.rows import ROWS, SMALL

    rows = [r for r in (*ROWS, SMALL) if r.quick] if quick else list(ROWS)
    found = [r for r in rows if not only or any(text.lower() in r.name.lower() for text in only)]
    if not found:
        raise BenchError(f"No row has {' or '.join(map(repr, only))} in its name, such as {rows[0].name!r}.")
    return found


def _cost(row: "Row") -> float:
    """Rough seconds that it takes to measure a row, for progress only."""
    from bench.speed.floor import floating_operations

    return 15 + floating_operations(row.products, row.batch) * row.models * row.processes / 1e9 / 2


def _show(out: Console, host: dict[str, Any], rows: "Sequence[Measured]") -> None:
    table = Table(title="Milliseconds of one step", title_justify="left")
    for title in ("network", "T", "B", "", "reference", "torch.nn", "PyTorch", "native", "products", "%"):
        table.add_column(title, justify="left" if title in ("network", "") else "right")
    for m in rows:
        times = (m.naive_ms, m.library_ms, m.torch_ms, m.native_ms, m.floor_ms)
        share = None if m.floor_ms is None or m.ours_ms is None else m.floor_ms / m.ours_ms
        table.add_row(
            f"{m.row.model} {m.row.layers}x{m.row.hidden}",
            str(m.row.horizon),
            str(m.row.batch),
            m.row.manner,
            *("" if t is None else f"{t:.3g}" if t < 100 else f"{t:.0f}" for t in times),
            "" if share is None else f"{100 * share:.0f}",
        )
    out.print(table)
    out.print("%: the share of the products in the time of the best kernel.", style="dim", highlight=False)
    for line in _sentences(host, rows):
        out.print(line, highlight=False)


def _sentences(host: dict[str, Any], rows: "Sequence[Measured]") -> list[str]:
    """What the machine can do, how far off training is, and which aims hold."""
    from bench.speed.gates import GATES

    lines = [
        f"One thread of this {host['cpu'] or 'CPU'} ({host['instructions']}) multiplies large matrices at "
        f"{host['gigaflops']:.0f} billion operations a second."
    ]
    trained = [m for m in rows if m.gigaflops and m.row.processes == 1 and m.row.task == "train"]
    if trained:
        best = max(trained, key=lambda m: m.gigaflops or 0)
        lines.append(
            f"Training does {best.gigaflops:.0f} billion a second at best ({best.row.name}), "
            f"{min(m.gigaflops or 0 for m in trained):.0f} billion at worst."
        )
    lines += [
        f"{m.row.name}: {100 * m.outside:.0f} % of it is spent outside the networks."
        for m in rows
        if m.outside is not None
    ]
    if "native" not in host["kernels"]:
        lines.append("There is no native kernel here (it needs a C++ compiler): the aims are about that one.")
    plain = [m.plain() for m in rows]
    known = [(g, v) for g in GATES if (v := g.value(plain)) is not None]
    counts = host["instructions"].startswith("AVX512")
    if known and not counts:
        lines.append("The aims below were set for CPUs with AVX-512; here they are only printed.")
    if known:
        held = sum(g.holds(v) for g, v in known)
        lines.append(f"[bold]{held} of {len(known)} aims hold:[/]")
    for gate, value in known:
        mark = "[green]holds[/]" if gate.holds(value) else f"[{'red' if counts else 'yellow'}]missed[/]"
        limit = gate.limit(plain)
        why = "" if limit is None or gate.holds(limit) else f"; products alone give {gate.written(limit)} here"
        lines.append(f"  {mark}  {gate.name}: {gate.written(value)} {gate.what} ({gate.bound}{why})")
    return lines


def _write(target: Path, content: dict[str, Any]) -> None:
    with writing(target):
        target.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
