"""The command line: `bench`, or `python -m bench`."""

import errno
import logging
import os
import sys
from typing import Any

import click
from typing_extensions import override

from bench.execution.threads import one_thread_by_default
from registry.errors import BenchError


class Main(click.Group):
    """Commands are imported when they are asked for, so that `bench --help` answers at once."""

    COMMANDS = (
        ("run", "bench.cli.commands.run"),
        ("sweep", "bench.cli.commands.sweep"),
        ("check", "bench.cli.commands.check"),
        ("settle", "bench.cli.commands.run"),
        ("list", "bench.cli.commands.entries"),
        ("show", "bench.cli.commands.entries"),
        ("data", "bench.cli.commands.data"),
        ("report", "bench.cli.commands.report"),
        ("runs", "bench.cli.commands.runs"),
        ("cluster", "bench.cli.commands.cluster"),
        ("predict", "bench.cli.commands.runs"),
        ("compare", "bench.cli.commands.diagnose"),
        ("locate", "bench.cli.commands.diagnose"),
        ("discover", "bench.cli.commands.diagnose"),
        ("extend", "bench.cli.commands.diagnose"),
        ("diagnose", "bench.cli.commands.diagnose"),
        ("design", "bench.cli.commands.models"),
        ("export-model", "bench.cli.commands.models"),
        ("ui", "bench.cli.commands.track"),
        ("sync", "bench.cli.commands.track"),
        ("export", "bench.cli.commands.archive"),
        ("import", "bench.cli.commands.archive"),
        ("score-discovery", "bench.cli.commands.score"),
        ("speed", "bench.cli.commands.speed"),
    )

    def list_commands(self, ctx: click.Context) -> list[str]:
        """In the order in which a newcomer meets them."""
        return [name for name, _ in self.COMMANDS]

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """The command ``name``, imported now."""
        import importlib

        module = dict(self.COMMANDS).get(name)
        if module is None:
            return None
        command: click.Command = getattr(importlib.import_module(module), f"{name.replace('-', '_')}_command")
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """A wrong command names the near ones."""
        from registry.errors import near

        if args and args[0] not in dict(self.COMMANDS) and not args[0].startswith("-"):
            raise click.UsageError(f"There is no command {args[0]!r}: {near(args[0], dict(self.COMMANDS))}")
        return super().resolve_command(ctx, args)

    @override
    def invoke(self, ctx: click.Context) -> Any:
        """A name that no file can have is said, whichever command looks for it."""
        try:
            return super().invoke(ctx)
        except OSError as error:
            if error.errno != errno.ENAMETOOLONG:
                raise
            raise BenchError(f"There is no {str(error.filename)!r:.100}: no file has so long a name.") from error


@click.command(cls=Main, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="multistep-bench", prog_name="bench")
def cli() -> None:
    """Benchmarks of multi-step prediction of dynamic systems with recurrent networks.

    \b
    bench run washout_vs_mlp                     the paper's first comparison, on simulated flights
    bench run "LSTM: 1x50 - MLP: 60x10"          one configuration
    bench sweep "LSTM: 1x50 - MLP: 60x10"        better options for it, found by trial
    bench list studies                           what else there is
    bench check                                  which claims of the paper reproduce here
    bench settle                                 more seeds for those that are open
    bench ui                                     the results in the MLflow UI

    Find the physics that a model misses, with your own logs:

    \b
    bench data init flights/                     describe a folder of logs (`bench data import`: PX4, ROS and others)
    bench diagnose flights/                      all four steps: a summary, a page, a better model
    bench compare flights/                       1  how far is the model off, beside the noise floor?
    bench locate flights/                        2  where?
    bench discover flights/                      3  which effect is missing?
    bench extend flights/ --add rotor_drag       4  add it, watch the error fall; then discover again
    bench design flights/                        after a tie: which flight would tell?
    """


def main() -> None:
    """Entry point: a user's mistake is one sentence and exit code 2, Ctrl-C is exit code 130."""
    one_thread_by_default()
    os.environ["PYTHONSAFEPATH"] = "1"  # no child imports what lies in the working directory
    _log_to_stderr()
    try:
        code = cli.main(standalone_mode=False)  # that of `click.exceptions.Exit`, which is not raised again
        if isinstance(code, int) and code:
            sys.exit(code)
    except BenchError as error:
        click.echo(f"bench: {error}", err=True)
        sys.exit(2)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        sys.exit(2)
    except click.UsageError as error:
        click.echo(f"bench: {error.format_message()}", err=True)
        hint = error.ctx.command_path if error.ctx else "bench"
        click.echo(f"Try `{hint} --help`.", err=True)
        sys.exit(2)
    except (click.Abort, KeyboardInterrupt):
        click.echo("\nbench: stopped. Nothing is half written; the same command does what is not finished.", err=True)
        sys.exit(130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)


def _log_to_stderr() -> None:
    """What the registry logs, such as that it is simulating, goes to stderr."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(message)s"))
    log = logging.getLogger("registry")
    log.addHandler(handler)
    log.setLevel(logging.INFO)
