"""Names that a terminal library reads as markup: of data, recordings, columns, folders, studies."""

import json
from pathlib import Path

from conftest import Typed
from faults.test_foreign_code import SMALL, SPEC, TOML, spring
from rich.console import Console

from bench.cli import progress

NAME = "[/] [bold]x[/b] [red"


def test_markup_in_every_name_is_printed_as_it_is(tmp_path: Path, typed: Typed) -> None:
    def bench(*arguments: str | Path) -> str:
        code, out, error = typed(*arguments)
        assert code in (0, 2), arguments
        return out + error

    folder, results = tmp_path / NAME.replace("/", "|"), tmp_path / "[|red]results[red]"
    folder.mkdir()
    spring(folder)
    description = TOML.replace('"spring"', json.dumps(NAME)).replace('"f"', '"[f]"').replace('"t"', '"[t]"')
    (folder / "dataset.toml").write_text(description)
    for i in range(4):
        file = folder / f"r{i}.csv"
        file.write_text(file.read_text().replace("t,x,v,f", "[t],x,v,[f]", 1))
        file.rename(folder / f"[bold]r{i}[red].csv")
    bench("data", "check", folder)
    assert "[bold]r0[red]" in bench("data", "inspect", folder)
    assert NAME in bench("run", SPEC, "--dataset", folder, *SMALL, "--results", results, "--no-track", "--workers", "1")
    listed = bench("runs", "list", "--results", results)
    assert listed.count(NAME) == 3
    keys = [line.split()[0] for line in listed.splitlines() if NAME in line]
    assert NAME in bench("runs", "show", keys[0], "--results", results)
    bench("runs", "diff", *keys[:2], "--results", results)
    assert NAME in bench("runs", "errors", keys[0], "--at", "1,5", "--results", results)
    for wrong in (
        ("show", NAME),
        ("run", NAME),
        ("runs", "show", NAME),
        ("diagnose", NAME),
        ("check", "--claim", NAME),
    ):
        assert "[/]" in bench(*wrong)


def test_markup_in_what_is_being_done() -> None:
    for terminal in (True, False):
        console = Console(force_terminal=terminal, quiet=True)
        with progress.meter(console, 1.0, 1) as meter:
            meter.start(NAME)
            meter.tick(1.0)
        with progress.announcer(console) as tick:
            tick(NAME)
