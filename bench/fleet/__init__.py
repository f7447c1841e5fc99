"""Many vehicles of a kind: a diagnosis of each, and what they say of the fleet.

import bench

found = bench.fleet("fleet", workers=8)
print(found.headline)
print(found.to_frame())
"""

from bench.callable_package import make_callable
from bench.fleet.fleet import fleet
from bench.fleet.result import FleetDiagnosis

__all__ = ["FleetDiagnosis", "fleet"]

make_callable(__name__)
