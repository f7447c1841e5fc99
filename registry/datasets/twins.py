"""Simulated flights, the embedded default: nothing to download, the truth is known.

Flights are simulated once and kept in the user's cache folder.
"""

import hashlib
import logging
import zipfile
from abc import abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch

from registry import cache
from registry.atomic_io import replacing
from registry.contracts import Channel, Dataset, Recording, RecordingSet, Split
from registry.core import DATASETS, check_options, option
from registry.datasets.twin import helicopter as twin_helicopter
from registry.datasets.twin import quadrotor as twin_quadrotor
from registry.datasets.twin.reference import DT, REGIMES
from registry.units import SIGNALS

_log = logging.getLogger(__name__)

VERSION = 1
"""Of the simulated samples: raised with every change of them, so that no older cache is read."""
# fmt: off
PELICAN_LENGTHS = (
    31565, 19667, 11490, 3767, 37082, 27519, 34725, 41234, 37216, 25630, 46880, 30932, 6815, 48241, 20613, 38506, 28105,
    18146, 34709, 54498, 47547, 4096, 34754, 64653, 61076, 51498, 32839, 19416, 19802, 25674, 19137, 11617, 4660, 16095,
    10038, 25473, 26628, 60265, 17679, 39826, 34144, 4864, 7049, 17772, 5194, 2388, 7804, 20000, 24580, 26031, 17300,
    13871, 2120, 15180,
)
# fmt: on
"""Samples of the 54 published Pelican flights."""
HELICOPTER_LENGTHS = (5556,) * 54
"""300 k samples, as many as the published helicopter set has."""
SMALL_LENGTHS = (3000,) * 28
"""30 s each."""


def channels(*signals: str) -> tuple[Channel, ...]:
    """The channels of signals, in order; rotors are numbered from 1."""
    return tuple(Channel(f"{s}.{a}", SIGNALS[s].unit) for s in signals for a in SIGNALS[s].axes or ("1", "2", "3", "4"))


def cache_folder() -> Path:
    """Where simulated flights are kept."""
    return cache.cache_folder() / "twins"


def split_regimes(names: Sequence[str]) -> Split:
    """About 60 % train, 15 % validate and 25 % test, of every regime (the part of a name before "_")."""
    parts: tuple[list[str], list[str], list[str]] = ([], [], [])
    for regime in dict.fromkeys(n.partition("_")[0] for n in names):
        group = sorted(n for n in names if n.partition("_")[0] == regime)
        held, test = max(1, round(0.15 * len(group))), max(1, round(0.27 * len(group)))
        cuts = len(group) - held - test, len(group) - test
        for part, some in zip(parts, (group[: cuts[0]], group[cuts[0] : cuts[1]], group[cuts[1] :]), strict=True):
            part.extend(some)
    train, validation, test_names = (tuple(p) for p in parts)
    return Split(train, validation, test_names)


@dataclass(frozen=True)
class Twin(Dataset):
    """What both twins share: size, seed, cache and split."""

    size: str = option("small", "number and length of flights", choices=("small", "full"))
    seed: int = option(0, "of references, gusts and measurement errors", low=0)

    in_full: ClassVar[dict[str, str]] = {"size": "full"}

    def __post_init__(self) -> None:
        check_options(self, DATASETS.name_of(type(self)))

    @abstractmethod
    def lengths(self) -> tuple[int, ...]:
        """Samples of each flight."""

    @abstractmethod
    def simulate(self) -> list[np.ndarray]:
        """The recorded columns (N_i, len(recorded)) of each flight."""

    def read(self) -> RecordingSet:
        """The flights, from the cache or simulated now."""
        recordings = []
        for i, columns in enumerate(self._flights()):
            recordings.append(
                Recording(
                    name=f"{REGIMES[i % 4]}_{i // 4 + 1:02d}",
                    rate=1 / DT,
                    inputs=columns[:, :4],
                    outputs=columns[:, 4:],
                    input_channels=self.recorded[:4],
                    output_channels=self.recorded[4:],
                    valid=np.ones(len(columns), dtype=bool),
                )
            )
        return RecordingSet(tuple(recordings), ())

    def split(self, names: Sequence[str]) -> Split:
        """By recording: of every regime about 60 % train, 15 % validate, 25 % test."""
        return split_regimes(names)

    def _flights(self) -> list[np.ndarray]:
        label = f"{DATASETS.name_of(type(self))}-{self.size}-{self.seed}-v{VERSION}"
        file = cache_folder() / f"{label}.npz"
        lengths = self.lengths()
        cached = _read_cache(file)
        if cached is not None and cached.shape == (sum(lengths), len(self.recorded)):
            return np.split(cached, np.cumsum(lengths)[:-1])
        name = DATASETS.name_of(type(self))
        _log.info("Simulating the %d flights of %s, once; they are kept for the next time.", len(lengths), name)
        with torch.inference_mode():
            flights = self.simulate()
        _write_cache(file, np.concatenate(flights))
        return flights


def _read_cache(file: Path) -> np.ndarray | None:
    try:
        with np.load(file, allow_pickle=False) as stored:
            samples = np.asarray(stored["samples"])
            whole = str(stored["sha256"]) == hashlib.sha256(samples.tobytes()).hexdigest()
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None  # absent or torn: simulated again
    return samples if whole else None


def _write_cache(file: Path, samples: np.ndarray) -> None:
    digest = np.array(hashlib.sha256(samples.tobytes()).hexdigest())
    # A cache that cannot be written costs time, not results.
    with suppress(OSError), replacing(file, flushed=False) as draft, draft.open("wb") as out:
        np.savez(out, samples=samples, sha256=digest)


@DATASETS.register("pelican_twin")
@dataclass(frozen=True)
class PelicanTwin(Twin):
    """Simulated Pelican flights in a 5 m cube, hover to aggressive; rotor speeds to velocity and body rates."""

    source: ClassVar[str] = (
        "Simulated here. Shape, measurement and processing after the AscTec Pelican flight dataset (WAVELab, "
        "University of Waterloo); vehicle constants of the RotorS Pelican."
    )
    system: ClassVar[str] = "quadrotor"
    inputs: ClassVar[tuple[str, ...]] = ("rotor_speed",)
    targets: ClassVar[tuple[str, ...]] = ("body_rates",)
    chain: ClassVar[tuple[str, ...]] = ("velocity", "body_rates")
    truth: ClassVar[Any] = twin_quadrotor.BY_ROTOR_SPEED
    recorded: ClassVar[tuple[Channel, ...]] = channels(
        "rotor_speed", "position", "velocity", "attitude", "body_rates", "euler_rates", "rotor_command"
    )

    def lengths(self) -> tuple[int, ...]:
        """28 flights of 30 s, or 54 of the published lengths."""
        return SMALL_LENGTHS if self.size == "small" else PELICAN_LENGTHS

    def simulate(self) -> list[np.ndarray]:
        """See `twin_quadrotor.measure` for the columns."""
        return twin_quadrotor.flights(self.seed, list(self.lengths()))[0]


@DATASETS.register("helicopter_twin")
@dataclass(frozen=True)
class HelicopterTwin(Twin):
    """Simulated helicopter flights in gusts that are not recorded; pilot sticks to Euler rates."""

    source: ClassVar[str] = "Simulated here; every constant is chosen, none is of a measured aircraft."
    system: ClassVar[str] = "helicopter"
    inputs: ClassVar[tuple[str, ...]] = ("pilot",)
    targets: ClassVar[tuple[str, ...]] = ("euler_rates",)
    chain: ClassVar[tuple[str, ...]] = ("velocity", "euler_rates")
    input_hold: ClassVar[str] = "previous"
    truth: ClassVar[Any] = twin_helicopter.TRUTH
    recorded: ClassVar[tuple[Channel, ...]] = channels("pilot", "velocity", "attitude", "body_rates", "euler_rates")

    def lengths(self) -> tuple[int, ...]:
        """28 flights of 30 s, or 54 that make 300 k samples."""
        return SMALL_LENGTHS if self.size == "small" else HELICOPTER_LENGTHS

    def simulate(self) -> list[np.ndarray]:
        """See `twin_helicopter.measure` for the columns."""
        return twin_helicopter.flights(self.seed, list(self.lengths()))[0]
