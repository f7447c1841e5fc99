"""`bench list` and `bench show`: what is registered, with options, units and sources."""

import dataclasses
import inspect
from typing import Any

import click
from rich.markup import escape
from rich.table import Table

from bench.cli.options import console
from bench.experiment import study
from bench.experiment.notation import parse
from registry.core import EFFECTS, INITIALIZERS, PHYSICS, PREDICTORS, REGISTRIES
from registry.errors import BenchError, near
from registry.units import SIGNALS

KINDS = ("predictors", "initializers", "datasets", "studies", "physics", "effects")


@click.command("list")
@click.argument("kind", required=False, metavar="[" + "|".join(KINDS) + "]")
@click.option(
    "--system", metavar="NAME|FILE.py:CLASS", help="With effects: those that this physics model may lack, all of them."
)
def list_command(kind: str | None, system: str | None) -> None:
    """What can be compared, one line each: everything, or one kind of it.

    \b
    bench list physics                       the systems that --system names
    bench list effects                       single terms of polynomials in one line a system
    bench list effects --system quadrotor
    bench list effects --system mine.py:Arm  your own physics
    """
    kind = "physics" if kind == "systems" else kind
    if kind is not None and kind not in KINDS:
        raise BenchError(f"There is no kind {kind!r}: {near(kind, KINDS)}")
    if system is not None and kind != "effects":
        raise BenchError("--system chooses among effects: bench list effects --system NAME.")
    out = console()
    for shown in [kind] if kind else KINDS:
        lines = study.titles() if shown == "studies" else REGISTRIES[shown].outline()
        if shown == "effects":
            lines = _together(lines) if system is None else _of(system, lines)
        table = Table(box=None, show_header=False, pad_edge=False, title=shown, title_justify="left")
        table.add_column(no_wrap=True)
        table.add_column()
        for name, about in lines.items():
            table.add_row(f"  {name}", escape(about))
        out.print(table)
    if kind is None:
        out.print("\n`bench show NAME` explains one; `bench run STUDY` or `bench run SPEC` runs it.")


def _together(lines: dict[str, str]) -> dict[str, str]:
    """Effects, single terms of a system ("lorenz.dx.x2") as one line."""
    terms: dict[str, list[str]] = {}
    for name in (n for n in lines if "." in n):
        terms.setdefault(name.partition(".")[0], []).append(name)
    out = {name: about for name, about in lines.items() if "." not in name}
    for system, names in terms.items():
        out[f"{system}.…"] = f"{len(names)} terms such as {names[-1]}: bench list effects --system {system}"
    return dict(sorted(out.items()))


def _of(system: str, lines: dict[str, str]) -> dict[str, str]:
    """Those that act in a physics model."""
    if ":" not in system:
        kind: Any = PHYSICS.get(system)
    else:
        from bench.diagnose.logs.load import physics_class  # imports torch

        kind = physics_class(system)
    return {name: about for name, about in lines.items() if EFFECTS.get(name).suits(kind)}


@click.command("show")
@click.argument("name")
def show_command(name: str) -> None:
    """One entry or study in full: what it is, its options with defaults, ranges and units, its source.

    \b
    bench show LSTM
    bench show "LSTM: 1x50 - MLP: 60x10"    the parts of a configuration
    """
    out = console()
    if name in study.titles():
        _show_study(out, study.get(name))
        return
    known = set(study.titles())
    for kind, registry in REGISTRIES.items():
        names = list(registry.outline())
        known.update(names)
        if match := [n for n in names if n.lower() == name.lower()]:
            _show_entry(out, kind, match[0], registry.get(match[0]))
            return
    if ":" not in name:
        raise BenchError(f"Nothing is called {name!r}: {near(name, known)}")
    predictor, initializer = parse(name)
    _show_entry(out, "predictors", PREDICTORS.name_of(type(predictor)), type(predictor))
    if initializer is not None:
        out.print()
        _show_entry(out, "initializers", INITIALIZERS.name_of(type(initializer)), type(initializer))


def _show_study(out: Any, s: study.Study) -> None:
    out.print(f"[bold]{escape(s.name)}[/]  (study): {escape(s.title)}\n")
    out.print(s.question, markup=False)
    out.print(f"Source: the paper, {s.source}.\nDefault data set: {s.default_dataset}.\n", markup=False)
    for preset, about in s.presets.items():
        out.print(f"  --preset {preset:8} {about}", markup=False)


def _show_entry(out: Any, kind: str, name: str, entry: type) -> None:
    from registry.dynamics import Effect, PhysicsModel

    out.print(f"[bold]{name}[/]  ({kind})")
    paragraphs = (inspect.getdoc(entry) or "").split("\n\n")
    about = "\n\n".join(p if "\n " in p else p.replace("\n", " ") for p in paragraphs)
    out.print(about, highlight=False, markup=False)
    for fact in ("equation", "source", "system", "inputs", "targets", "chain", "needs", "requires"):
        value = getattr(entry, fact, None)
        if value and not callable(value) and not isinstance(value, property):
            text = ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)
            out.print(f"{fact}: {text}", highlight=False, markup=False)
    if issubclass(entry, PhysicsModel):
        groups = dict.fromkeys(c.group for c in entry.state_channels)
        driven = " or ".join(map(_signal, entry.input_signals))
        out.print(f"states: {', '.join(map(_signal, groups))}", highlight=False, markup=False)
        out.print(f"driven by: {driven or 'nothing'}", highlight=False, markup=False)
    if issubclass(entry, Effect):
        suited = ", ".join(n for n in PHYSICS.outline() if entry.suits(PHYSICS.get(n)))
        out.print(f"acts in: {entry.acts_in or suited}", highlight=False, markup=False)
        if entry.manoeuvre:
            out.print(f"to see it: {entry.manoeuvre}", highlight=False, markup=False)
    fields = [f for f in dataclasses.fields(entry) if f.init and f.repr]  # or an integrator sets it
    if not fields:
        return
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for column in ("option", "default", "range", "unit", "meaning"):
        table.add_column(column)
    for f in fields:
        meta = f.metadata
        default = "required" if f.default is dataclasses.MISSING else repr(f.default)
        span = " | ".join(map(str, meta.get("choices") or ()))
        if not span and (meta.get("low") is not None or meta.get("high") is not None):
            low, high = meta.get("low"), meta.get("high")
            span = f"{'' if low is None else f'{low:g}'} .. {'' if high is None else f'{high:g}'}"
        meaning = str(meta.get("help", ""))
        if meta.get("source"):
            meaning += f" ({meta['source']})"
        table.add_row(*map(escape, (f.name, default, span, str(meta.get("unit", "")), meaning)))
    out.print()
    out.print(table)


def _signal(name: str) -> str:
    """As a dataset.toml has it: its columns and unit; a state that cannot be measured is named only."""
    if name not in SIGNALS:
        return f"{name} (inside)"
    known = SIGNALS[name]
    axes = f" ({', '.join(known.axes)})" if len(known.axes) > 1 else ""
    return f"{name}{axes} [{known.unit}]"
