"""The recordings of a data set that train, as a folder of a user's own: python tests/training_folder.py DATASET FOLDER.

So `bench diagnose FOLDER` tells which effects the training recordings alone name; the published test recording is not
there to choose by. A single recording is cut into five parts, as any user's is.
"""

import json
import sys
from pathlib import Path

import numpy as np

from registry.core import DATASETS, PHYSICS


def write(name: str, folder: Path) -> None:
    """One CSV a recording, and a dataset.toml that says what the data set says."""
    dataset = DATASETS.get(name)()
    recordings = dataset.load().recordings
    training = dataset.split([r.name for r in recordings]).train
    folder.mkdir(parents=True)
    for r in (r for r in recordings if r.name in training):
        columns = [np.arange(len(r)) / r.rate, *r.inputs.T, *r.outputs.T]
        names = ["time", *(c.name for c in r.channels)]
        np.savetxt(
            folder / f"{r.name}.csv", np.stack(columns, 1)[r.valid], "%.9g", ",", header=",".join(names), comments=""
        )
    signals: dict[str, tuple[str, list[str]]] = {}
    for channel in recordings[0].channels:
        signals.setdefault(channel.group, (channel.unit, []))[1].append(channel.name)
    constants = PHYSICS.get(dataset.system)().parameters()
    spread = {p.name: p.uncertainty for p in constants if p.name not in dataset.physics}
    lines = [
        f'name = "{name}_training"\nsystem = "{dataset.system}"\nrate_hz = {recordings[0].rate:.12g}\nfiles = "*.csv"',
        f'time = "time"\ninput = "{dataset.inputs[0]}"\ninput_hold = "{dataset.input_hold}"\n\n[signals]',
        *(f'{group} = {{columns = {json.dumps(own)}, unit = "{unit}"}}' for group, (unit, own) in signals.items()),
        "\n[physics]",
        *(f"{p.name} = {dataset.physics.get(p.name, p.value)}" for p in constants),
        "\n[physics.uncertainty]" if spread else "",
        *(f"{key} = {share}" for key, share in spread.items()),
    ]
    lines += ["\n[processing]"] if dataset.processing else []
    for key, table in dataset.processing.items():
        lines.append(f"{key} = {{{', '.join(f'{name} = {json.dumps(value)}' for name, value in table.items())}}}")
    (folder / "dataset.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write(sys.argv[1], Path(sys.argv[2]))
