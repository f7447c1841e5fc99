"""`bench cluster`: workers for `bench run` and `bench sweep`."""

import os

import click


@click.group("cluster")
def cluster_command() -> None:
    """A Dask cluster for `bench run` and `bench sweep`; SLURM and Kubernetes: docs/how-to/cluster.md."""


@cluster_command.command("start")
@click.option("--workers", type=click.IntRange(1, 512), help="Processes, one thread each; default: one a core.")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option("--port", type=click.IntRange(0, 65535), default=8786, show_default=True, help="0: any that is free.")
def start_command(workers: int | None, host: str, port: int) -> None:
    """Start a scheduler and workers on this machine; Ctrl-C stops them.

    \b
    bench cluster start --workers 4
    bench run washout_vs_mlp --cluster tcp://127.0.0.1:8786      in another terminal
    dask worker tcp://127.0.0.1:8786 --nthreads 1                one more worker

    Whoever reaches a scheduler can run code: it listens on this machine only, unless --host says otherwise.
    """
    from bench.execution.cluster import serve

    def ready(address: str) -> None:
        click.echo(f"Scheduler: {address}\nbench run STUDY --cluster {address}\nCtrl-C stops it.")

    def warn(sentence: str) -> None:
        click.echo(f"bench: {sentence}", err=True)

    serve(workers or os.cpu_count() or 1, host, port, ready, warn)
