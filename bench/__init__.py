"""Multi-step prediction of dynamic systems, and the physics that models miss.

    import bench

    subject = bench.load("my_flights")              measurements and the nominal model of their system
    bench.compare(subject).plot()                   1  how far is the model off, beside the noise floor?
    bench.locate(subject, subject.model)            2  where?
    bench.discover(subject)                         3  which effect is missing?
    bench.extend(subject, subject.model, ["mass"])  4  add it, watch the error fall
    bench.diagnose("my_flights")                    all four
    bench.ceiling("my_flights", model)              how much is left to find, by a network
    bench.design("my_flights")                      after a tie: which flight would tell
    bench.fleet("fleet", workers=8)                 of every vehicle: which lack what, which differ, which drift

    bench.run("LSTM: 1x50 - MLP: 60x10", dataset="nanodrone")
    bench.sweep("LSTM: 1x50 - MLP: 60x10", dataset="nanodrone", trials=30)
    bench.check()

What `__all__` lists is the public API; everything else is private and may change. Importing it does nothing and loads
nothing: each name is imported when it is first used. SI units; results have `to_frame` and, most of them, `plot`.
"""

import sys

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:
    # `python -m bench` puts the working directory first: a `typing.py` among somebody's logs would be run.
    _here = __file__.rpartition("bench")[0].rstrip("/\\")
    if sys.path and sys.path[0] != _here:
        del sys.path[0]

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bench.api.check import Verdicts, check
    from bench.api.run import Results, run
    from bench.diagnose import (
        Ceiling,
        Comparison,
        Design,
        Diagnosis,
        Discovery,
        Extension,
        Location,
        Subject,
        ceiling,
        compare,
        design,
        diagnose,
        discover,
        extend,
        load,
        locate,
    )
    from bench.experiment.study import Study
    from bench.fleet.fleet import fleet
    from bench.fleet.result import FleetDiagnosis
    from bench.sweep.sweep import SweepResult, sweep
    from registry.errors import BenchError

__all__ = [
    "BenchError",
    "Ceiling",
    "Comparison",
    "Design",
    "Diagnosis",
    "Discovery",
    "Extension",
    "FleetDiagnosis",
    "Location",
    "Results",
    "Study",
    "Subject",
    "SweepResult",
    "Verdicts",
    "ceiling",
    "check",
    "compare",
    "design",
    "diagnose",
    "discover",
    "extend",
    "fleet",
    "load",
    "locate",
    "run",
    "sweep",
]
_PLACES = {
    "BenchError": "registry.errors",
    "FleetDiagnosis": "bench.fleet.result",
    "Results": "bench.api.run",
    "Study": "bench.experiment.study",
    "SweepResult": "bench.sweep.sweep",
    "Verdicts": "bench.api.check",
    "check": "bench.api.check",
    "run": "bench.api.run",
}
"""Modules of those that are not in `bench.diagnose`."""


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'bench' has no attribute {name!r}")
    if name in ("diagnose", "fleet", "sweep"):  # the package, which is called as its main function
        return importlib.import_module(f"bench.{name}")
    found = getattr(importlib.import_module(_PLACES.get(name, "bench.diagnose")), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
