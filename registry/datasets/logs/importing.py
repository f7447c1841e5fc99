"""Logs of autopilots, robots and ground stations as a folder of CSV files with a drafted `dataset.toml`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from registry.atomic_io import writing
from registry.datasets.folder.columns import recognised
from registry.datasets.folder.description import FILE
from registry.datasets.folder.draft import MOTION, Known, draft
from registry.datasets.logs import flights, ground_station
from registry.datasets.logs.ardupilot import read_dataflash
from registry.datasets.logs.flights import DRIVERS
from registry.datasets.logs.formats import dataflash, usd
from registry.datasets.logs.matlab import read_matlab
from registry.datasets.logs.px4 import read_ulog
from registry.datasets.logs.series import Log, round_rate
from registry.datasets.logs.table import Table, joined, same_recording, write
from registry.datasets.logs.vehicles import vehicle as constants_of_vehicle
from registry.errors import BenchError
from registry.regular_file import regular

FORMATS = {
    ".ulg": "PX4 ULog",
    ".bin": "ArduPilot log",
    ".bag": "ROS bag",
    ".mcap": "ROS bag",
    ".db3": "ROS bag",
    ".csv": "table",
    ".mat": "MATLAB file",
}
"""By the ending of a file's name."""
BEGINNINGS = {b"ULog": "PX4 ULog", dataflash.HEAD: "ArduPilot log", bytes([usd.START]): "Crazyflie log"}
"""By the first bytes of a file, whatever it is called."""
FIRMWARE = ("stateEstimate", "stabilizer.", "kalman.", "motor.m")
"""How names begin that only a Crazyflie has; the units and signs of all its variables are known."""
PACE = ("body_rates", *DRIVERS)
"""Signals whose rates limit the common one."""


def convert(files: Sequence[Path], folder: Path, rate: float | None = None, vehicle: str = "") -> list[str]:
    """Write ``files`` as CSV files with a drafted dataset.toml into ``folder``.

    Args:
        files: logs of one format: PX4 ULogs (.ulg), ArduPilot logs (.bin), ROS 1 bags (.bag), ROS 2 bags (.mcap, .db3
            or their folder), MATLAB files (.mat), Crazyflie logs of the memory card, or of cfclient (.csv).
        folder: made where it does not exist; must not hold a dataset.toml.
        rate: common sample rate [Hz]; default: as the signals have it.
        vehicle: whose constants to state, see `registry.datasets.logs.vehicles.vehicle`; "": those in the log alone.

    Returns:
        What was done, in sentences.

    Raises:
        BenchError: a file cannot be read or lacks the motion or its cause, or the folder cannot be written.
    """
    if (folder / FILE).exists():
        raise BenchError(f"{folder / FILE} exists already: choose another folder.")
    formats = {format_of(file) for file in files}
    if len(formats) > 1:
        raise BenchError(f"The files are of different formats ({', '.join(sorted(formats))}): import one at a time.")
    names = [_stem(file) for file in files]
    if len(set(names)) < len(names):
        raise BenchError("Two of the files have the same name: import them into folders of their own.")
    known = constants_of_vehicle(vehicle) if vehicle else {}
    (kind,) = formats
    if read := _reader(kind):
        return flights.write({name: read(file) for name, file in zip(names, files, strict=True)}, folder, rate, known)
    notes, recordings = _tables(kind, dict(zip(names, files, strict=True)), rate)
    columns = (c for tables in recordings.values() for t in tables for c in t.columns)
    sure = kind == "Crazyflie log" or (kind == "table" and any(c.startswith(FIRMWARE) for c in columns))
    return [*notes, *_write(recordings, folder, rate, Known(0.0, known, sure))]


def format_of(file: Path) -> str:
    """The format of a log.

    Raises:
        BenchError: it does not exist or has none that can be read.
    """
    if not file.exists():
        raise BenchError(f"{file} does not exist.")
    if (file / "metadata.yaml").is_file():
        return "ROS bag"
    regular(file)
    with file.open("rb") as stream:
        first = stream.read(max(map(len, BEGINNINGS)))
    for beginning, name in BEGINNINGS.items():
        if first.startswith(beginning):
            return name
    if file.suffix.lower() in FORMATS:
        return FORMATS[file.suffix.lower()]
    raise BenchError(
        f"{file} is neither a PX4 ULog (.ulg), an ArduPilot log (.bin), a ROS bag (.bag, .mcap, .db3 or a ROS 2 bag's "
        "folder), a MATLAB file (.mat), nor a Crazyflie's log of its memory card or of cfclient (.csv)."
    )


def _reader(kind: str) -> Callable[[Path], Log] | None:
    """Of a format whose signals have clocks of their own; None: another one."""
    if kind == "ROS bag":
        from registry.datasets.logs.ros_bag import read_bag  # its library is an option

        return read_bag
    return {"PX4 ULog": read_ulog, "ArduPilot log": read_dataflash}.get(kind)


def _stem(file: Path) -> str:
    return file.name if file.is_dir() else file.stem


def _tables(kind: str, files: Mapping[str, Path], rate: float | None) -> tuple[list[str], dict[str, list[Table]]]:
    """Of a format that has columns: what is to be notes of the files, and the tables of each recording."""
    notes: list[str] = []
    if kind == "table":
        return notes, same_recording((name, ground_station.read_csv(file)) for name, file in files.items())
    if kind == "MATLAB file":
        found = {name: tables for file in files.values() for name, tables in read_matlab(file, rate).items()}
        return notes, found
    recordings = {}
    for name, file in files.items():
        events, whole = usd.read_usd_events(file)
        if not events:
            raise BenchError(f"{file} holds no events: nothing was logged.")
        if not whole:
            notes.append(
                f"{name}: its checksum does not fit, as of a log that was cut short: read up to its last event."
            )
        recordings[name] = list(events.values())
    return notes, recordings


def _write(recordings: Mapping[str, Sequence[Table]], folder: Path, rate: float | None, known: Known) -> list[str]:
    """The recordings as CSV files, described by the names of their columns; what was done, in sentences."""
    whole = {name: joined(tables) for name, tables in recordings.items()}
    for name, table in whole.items():
        if len(table.t) < 3:
            raise BenchError(f"{name} holds {len(table.t)} samples: log for longer, or leave it out.")
    common = set.intersection(*(set(table.columns) for table in whole.values()))
    if not common:
        raise BenchError("The files have no column in common: import them into folders of their own.")
    found = recognised([c for c in next(iter(whole.values())).columns if c in common])
    pace = [c for s, columns in found.columns.items() if s in PACE for c in columns]
    chosen = rate or _pace(recordings, pace)
    notes, left = [], sorted({c for table in whole.values() for c in table.columns} - common)
    for name, tables in recordings.items():
        rates = ", ".join(f"{len(t.columns)} columns of {t.source} ({t.rate:.4g} Hz)" for t in tables)
        others = [t.source for t in tables if abs(t.rate - chosen) > 0.01 * chosen]
        made = f"; {', '.join(others)}: values between samples are interpolated when it is read" if others else ""
        notes.append(f"{name}: {whole[name].t[-1] - whole[name].t[0]:.1f} s at {chosen:g} Hz: {rates}{made}.")
    if known.sure and set(found.signals) & set(MOTION) and not set(found.signals) & set(DRIVERS):
        notes.append(
            "No motor signal is in the log: log motor.m1 to motor.m4, without which only networks can predict."
        )
    if left:
        notes.append(f"Left out, because not every file has it: {', '.join(left)}.")
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name, table in whole.items():
            write(folder / f"{name}.csv", table, common)
        text = draft(folder, known=replace(known, rate=chosen))
        (folder / FILE).write_text(text, encoding="utf-8")
    return notes


def _pace(recordings: Mapping[str, Sequence[Table]], columns: Sequence[str]) -> float:
    """The common rate [Hz]: that of the slowest table that holds one of the columns, or else of the fastest of all."""
    rates = [t.rate for tables in recordings.values() for t in tables if t.rate]
    held = [t.rate for tables in recordings.values() for t in tables if t.rate and set(columns) & set(t.columns)]
    if not rates:
        raise BenchError("The clock of the log stands still: log it again.")
    return round_rate(min(held) if held else max(rates))
