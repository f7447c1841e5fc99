"""Find the missing physics: compare a model with measurements, see where it fails, learn what is missing, add it.

    import bench

    subject = bench.load("my_flights")
    print(bench.compare(subject).error("nominal"))
    print(bench.locate(subject, subject.model).regions)
    print([f.id for f in bench.discover(subject).found])
    print(bench.extend(subject, subject.model, ["rotor_drag"]).effects)

`diagnose` does all of it; the package may be called in its place. `ceiling` asks a network how much is left to
find, `design` says which flight would tell what is left open.
"""

from bench.callable_package import make_callable
from bench.diagnose.ceiling.ceiling import Ceiling, ceiling
from bench.diagnose.compare import Comparison, compare
from bench.diagnose.diagnose import diagnose
from bench.diagnose.discover import discover
from bench.diagnose.extend import Extension, extend
from bench.diagnose.locate import Location, locate
from bench.diagnose.logs.load import load
from bench.diagnose.logs.subject import Subject
from bench.diagnose.manoeuvre.design import Design, design
from bench.diagnose.result import Diagnosis
from bench.diagnose.select.discovery import Discovery

__all__ = [
    "Ceiling",
    "Comparison",
    "Design",
    "Diagnosis",
    "Discovery",
    "Extension",
    "Location",
    "Subject",
    "ceiling",
    "compare",
    "design",
    "diagnose",
    "discover",
    "extend",
    "load",
    "locate",
]

make_callable(__name__)
