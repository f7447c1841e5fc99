"""The compiled core: every .cpp file of this folder in one shared library, built once a machine.

It is compiled with the machine's own compiler into the user's cache folder, under a name made of sources, flags,
compiler and CPU. Where that fails the PyTorch kernel does the work, which is said once. The environment variable
``BENCH_KERNEL`` chooses: auto (default), native (an error where it cannot be had), pytorch; ``BENCH_ARCH`` another
instruction set than the machine's own, such as x86-64-v2, as a run on an older processor would have.
"""

import ctypes
import errno
import hashlib
import logging
import os
import platform
import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import torch
from torch import Tensor

from registry.atomic_io import replacing
from registry.cache import cache_folder
from registry.errors import BenchError, near

NUMERICS = 2
"""Raised whenever a change of the C++ sources alters the numbers of a run."""
PYTORCH_NUMERICS = 2
"""Raised whenever a change of the PyTorch kernels does."""

_SOURCES = Path(__file__).parent
_FLAGS = ("-O3", "-std=c++17", "-fPIC", "-shared", "-fno-math-errno", "-fno-trapping-math")
_CHOICES = ("auto", "native", "pytorch")


@dataclass(frozen=True)
class Core:
    """The loaded library and what its bits depend on besides CPU and threads."""

    functions: ctypes.CDLL
    compiler: str


def core() -> Core | None:
    """The compiled core, built if need be; None where the PyTorch kernel is to be used.

    Raises:
        BenchError: ``BENCH_KERNEL`` is native and there is no native kernel, or is none of its values.
    """
    return _chosen(os.environ.get("BENCH_KERNEL", "auto"), _arch())


@lru_cache
def _chosen(choice: str, arch: str) -> Core | None:
    if choice not in _CHOICES:
        raise BenchError(f"BENCH_KERNEL={choice!r} is no kernel: {near(choice, _CHOICES)}")
    if choice == "pytorch":
        return None
    try:
        return _load(arch)
    except _Unavailable as reason:
        if choice == "native":
            raise BenchError(f"There is no native kernel: {reason}; unset BENCH_KERNEL to do without.") from None
        logging.getLogger(__name__).warning("Training takes the slower PyTorch kernel: %s.", reason)
        os.environ["BENCH_KERNEL"] = "pytorch"  # worker processes follow, and do not say it again
        return None


def core_for(first: Tensor, *others: Tensor | None) -> Core | None:
    """`core`, where all are of one type that it knows, on the CPU, and no model is being exported."""
    known = (
        not torch.compiler.is_exporting()
        and first.device.type == "cpu"
        and first.dtype in (torch.float32, torch.float64)
    )
    same = known and all(x is None or (x.device == first.device and x.dtype == first.dtype) for x in others)
    return core() if same else None


def name() -> str:
    """The kernel in use and what its bits depend on: "pytorch 2", or "native 1, g++ 12"."""
    found = core()
    return f"native {NUMERICS}, {found.compiler}" if found else f"pytorch {PYTORCH_NUMERICS}"


class _Unavailable(Exception):
    """Why there is no native kernel: a clause."""


def _arch() -> str:
    """The instruction set that is asked for, as the compiler says it."""
    return os.environ.get("BENCH_ARCH", "native")


def _load(arch: str) -> Core:
    return _library(_SOURCES, _FLAGS, arch)


def built(sources: Path, flags: Sequence[str] = ()) -> ctypes.CDLL | None:
    """The library of the .cpp files of another folder; None where ``BENCH_KERNEL`` is pytorch, or it cannot be had.

    Args:
        sources: the folder.
        flags: of the compiler, beside those of the core.

    Raises:
        BenchError: ``BENCH_ARCH`` is no instruction set.
    """
    if os.environ.get("BENCH_KERNEL", "auto") == "pytorch":
        return None
    try:
        return _library(sources, (*_FLAGS, *flags), _arch()).functions
    except _Unavailable:
        return None


def _library(folder_of_sources: Path, flags: Sequence[str], arch: str) -> Core:
    if not re.fullmatch(r"[\w.+-]+", arch):
        raise BenchError(f"BENCH_ARCH={arch!r} is no instruction set, such as native or x86-64-v3.")
    compiler, version = _compiler()
    option = "-mcpu" if platform.machine() in ("arm64", "aarch64") else "-march"
    command = [compiler, f"{option}={arch}", *flags]
    sources = sorted(p for p in folder_of_sources.iterdir() if p.suffix in (".cpp", ".h"))
    content = [p.name.encode() + b"\0" + p.read_bytes() for p in sources]
    parts = [*content, *(part.encode() for part in (*command, version, _cpu()))]
    key = hashlib.sha256(b"".join(hashlib.sha256(p).digest() for p in parts)).hexdigest()[:32]
    folder = cache_folder() / "native"
    library = folder / f"{key}.so"
    label = f"{Path(compiler).name.split('-')[0]} {_major(version)}" + (f", {arch}" if arch != "native" else "")
    if library.exists():
        try:
            return Core(ctypes.CDLL(str(library)), label)
        except OSError:  # torn: made anew
            pass
    _build([*command, *(str(p) for p in sources if p.suffix == ".cpp")], library)
    try:
        return Core(ctypes.CDLL(str(library)), label)
    except OSError as error:
        raise _Unavailable(f"what {compiler} made cannot be loaded ({error})") from None


def _compiler() -> tuple[str, str]:
    """A C++ compiler and what it says of its version."""
    wanted = os.environ.get("CXX", "").split()[:1] or ["g++", "clang++", "c++"]
    found = next((path for path in map(shutil.which, wanted) if path), None)
    if found is None:
        raise _Unavailable(f"no C++ compiler ({', '.join(wanted)}) is installed")
    try:
        version = _run(found, "--version")
    except (OSError, subprocess.SubprocessError) as error:
        raise _Unavailable(f"{found} does not run ({error})") from None
    return found, version


def _run(*command: str, cwd: Path | None = None) -> str:
    """What a program prints; one that asks for input gets none, rather than waiting for it."""
    none = subprocess.DEVNULL
    done = subprocess.run(command, stdin=none, cwd=cwd, capture_output=True, text=True, timeout=600, check=True)
    return done.stdout


def _major(version: str) -> str:
    """The major version in what a compiler says: "g++ (Debian 12.2.0-14) 12.2.0" → "12"."""
    words = version.partition("\n")[0].split()
    return next((w.partition(".")[0] for w in reversed(words) if w[0].isdigit()), "0")


def _cpu() -> str:
    """What `-march=native` looks at."""
    try:
        lines = Path("/proc/cpuinfo").read_text().partition("\n\n")[0].splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    stable = ("vendor_id", "cpu family", "model", "stepping", "flags", "Features", "CPU implementer", "CPU part")
    return "\n".join(line for line in lines if line.partition(":")[0].strip() in stable)


def _build(command: list[str], library: Path) -> None:
    """Compile under another name and rename: a process sees a whole library or none; of two, the last one stays."""
    try:
        library.parent.mkdir(parents=True, exist_ok=True)
        if not os.access(library.parent, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise _Unavailable(f"the cache folder {library.parent} cannot be written ({error.strerror})") from None
    try:
        with replacing(library, flushed=False) as draft:
            _run(*command, "-o", str(draft), cwd=library.parent)
    except subprocess.CalledProcessError as error:
        lines = [line for line in error.stderr.splitlines() if "error" in line] or error.stderr.splitlines() or ["?"]
        raise _Unavailable(f"{command[0]} does not compile it ({lines[0].strip()})") from None
    except (OSError, subprocess.SubprocessError) as error:
        raise _Unavailable(f"{command[0]} does not compile it ({error})") from None
