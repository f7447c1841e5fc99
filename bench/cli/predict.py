"""`bench predict`: a recorded model on new inputs."""

from pathlib import Path

import click

from bench.cli import options
from registry.errors import BenchError


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
    predicted step.
    """
    from bench.records import record
    from bench.training import predict

    predicted = predict.predict_table(record.find(results / "runs", run), predict.read_table(source), str(source))
    if output is None:
        click.echo(predicted.to_csv(index=False), nl=False)
        return
    try:
        if output.suffix == ".parquet":
            predicted.to_parquet(output, index=False)
        else:
            predicted.to_csv(output, index=False)
    except OSError as error:
        raise BenchError(f"{output} cannot be written: {error.strerror or error}.") from error
    click.echo(f"Wrote {len(predicted)} predicted steps to {output}.")
