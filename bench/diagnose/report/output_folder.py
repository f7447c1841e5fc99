"""Page, JSON and model of one diagnosis, put in place so that a folder never holds those of two."""

import os
from pathlib import Path

from bench.diagnose.report import model_file
from bench.diagnose.result import Diagnosis
from registry import atomic_io
from registry.dynamics import PhysicsModel
from registry.errors import BenchError

PAGE, VALUES, MODEL = "diagnosis.html", "diagnosis.json", "model.toml"
FORMER = "model.previous.toml"
_DRAFT = ".diagnosis-"


def write(folder: Path, diagnosis: Diagnosis, model: PhysicsModel) -> list[Path]:
    """Write a diagnosis: all its files beside first, then those of the one before are taken away, then moved in.

    Whatever ends the process meanwhile leaves files of one diagnosis, or fewer of them. A model of before that differs
    is kept as ``model.previous.toml``; where data have a problem there is no model.

    Returns:
        The files written, and the model of before where it was moved.

    Raises:
        BenchError: the folder cannot be written.
    """
    from bench.diagnose.report import page  # it brings what draws: with all that a diagnosis holds, too much

    try:
        folder.mkdir(parents=True, exist_ok=True)
        with atomic_io.drafting(folder, _DRAFT) as draft:
            page.write(draft / PAGE, diagnosis)
            diagnosis.write(draft / VALUES)
            if diagnosis.verdict != "data_problem":
                model_file.write(draft / MODEL, model, diagnosis.effects)
            return _exchange(draft, folder)
    except OSError as error:
        raise BenchError(f"{folder} cannot be written: {error.strerror or error}.") from error


def _exchange(draft: Path, folder: Path) -> list[Path]:
    made = [name for name in (PAGE, VALUES, MODEL) if (draft / name).is_file()]
    for name in made:
        atomic_io.flush(draft / name)
    kept = []
    before = (folder / MODEL).read_bytes() if (folder / MODEL).is_file() else None
    for name in (PAGE, VALUES):
        (folder / name).unlink(missing_ok=True)
    if before is not None and (MODEL not in made or before != (draft / MODEL).read_bytes()):
        os.replace(folder / MODEL, folder / FORMER)
        kept = [folder / FORMER]
    for name in made:
        atomic_io.move(draft / name, folder / name)
    return [*(folder / name for name in made), *kept]
