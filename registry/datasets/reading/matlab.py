"""MATLAB files, read as arrays only."""

from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
import scipy.io

from registry.errors import BenchError

_HDF5 = b"\x89HDF\r\n\x1a\n"


def read_v5(file: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """The numeric variables ``names`` of a v5 file, as float arrays.

    Raises:
        BenchError: the file is damaged or lacks a variable.
    """
    try:
        content = scipy.io.loadmat(str(file), variable_names=list(names))
        arrays = {name: np.asarray(content[name], dtype=float) for name in names if name in content}
    except Exception as error:  # damaged files bring out every kind of error in the parser
        raise BenchError(f"{file} is damaged or not a MATLAB v5 file ({error}): download it again.") from error
    for name in names:
        if name not in arrays:
            raise BenchError(f"{file} has no variable {name}: download it again.")
    return arrays


def read_cell_structs(file: Path, fields: Sequence[str]) -> list[dict[str, np.ndarray]]:
    """The structs of the file's one cell array, v5 or v7.3, each field as a float matrix (rows, columns).

    Raises:
        BenchError: the file is damaged, holds no cell array of structs or a struct lacks a field.
    """
    try:
        with file.open("rb") as stream:
            head = stream.read(512 + len(_HDF5))
        v73 = head[:8] == _HDF5 or head[512 : 512 + 8] == _HDF5
        structs = _cells_v73(file) if v73 else _cells_v5(file)
    except Exception as error:  # damaged files bring out every kind of error in the parsers
        raise BenchError(f"{file} is damaged or not a MATLAB file ({error}): download it again.") from error
    if not structs:
        raise BenchError(f"{file} holds no cell array of structs: download it again.")
    for i, cell in enumerate(structs):
        for name in fields:
            if name not in cell:
                raise BenchError(f"{file}: cell {i + 1} has no field {name}: download it again.")
    return structs


def _cells_v5(file: Path) -> list[dict[str, np.ndarray]]:
    for name, value in scipy.io.loadmat(str(file)).items():
        if not name.startswith("__") and isinstance(value, np.ndarray) and value.dtype == object:
            cells = [cell.reshape(-1)[0] for cell in value.reshape(-1, order="F")]
            return [{f: np.asarray(cell[f], dtype=float) for f in cell.dtype.names} for cell in cells]
    return []


def _cells_v73(file: Path) -> list[dict[str, np.ndarray]]:
    with h5py.File(file, "r") as content:
        for name, value in content.items():
            if name.startswith("#") or not isinstance(value, h5py.Dataset) or value.dtype != h5py.ref_dtype:
                continue
            cells = [content[reference] for reference in np.asarray(value).reshape(-1)]
            # MATLAB stores matrices column by column, so they come out transposed.
            return [{f: np.asarray(cell[f], dtype=float).T for f in cell} for cell in cells]
    return []
