"""The thresholds of a diagnosis: each with its unit, its meaning, and what its value rests on.

Code takes the instance of a class below, so that a test (or a study of a threshold) replaces that one:
``replace(LOCATING, regions=12)``.
"""

from dataclasses import Field, fields, is_dataclass
from typing import Any

from bench.diagnose.settings.ceiling import Ceiling
from bench.diagnose.settings.checks import (
    Aligning,
    Disagreeing,
    Freezing,
    Hitting,
    Inverting,
    Leaving,
    Shifting,
    Spiking,
)
from bench.diagnose.settings.conventions import Lifting, Mending, Mounting, Offsetting, Sampling, Trying, Turning
from bench.diagnose.settings.learn import Learning, Sketching, Splining, Wording
from bench.diagnose.settings.logs import Hearing, Reading, Sloping
from bench.diagnose.settings.manoeuvre import Assuring, Composing, Designing, Limiting, Separating
from bench.diagnose.settings.regression import Calibrating, Folding, Following, Linearising, Mapping, Waving
from bench.diagnose.settings.select import (
    Choosing,
    Commanding,
    Differing,
    Forecasting,
    Growing,
    Inverse,
    Mattering,
    Releasing,
    Searching,
    Stepping,
    Timing,
    Verifying,
)
from bench.diagnose.settings.simulate import Beginning, Playing, Running, Shooting, Simulating
from bench.diagnose.settings.steps import Comparing, Deciding, Discovering, Extending, Locating, Observing, Telling
from bench.diagnose.settings.unseen import Hiding, Unseen

COMPARING = Comparing()
OBSERVING = Observing()
CEILING = Ceiling()
LOCATING = Locating()
DISCOVERING = Discovering()
EXTENDING = Extending()
DECIDING = Deciding()
TELLING = Telling()
ALIGNING = Aligning()
HITTING = Hitting()
DISAGREEING = Disagreeing()
SPIKING = Spiking()
FREEZING = Freezing()
INVERTING = Inverting()
SHIFTING = Shifting()
LEAVING = Leaving()
MOUNTING = Mounting()
OFFSETTING = Offsetting()
MENDING = Mending()
TRYING = Trying()
SAMPLING = Sampling()
TURNING = Turning()
LIFTING = Lifting()
READING = Reading()
HEARING = Hearing()
SLOPING = Sloping()
UNSEEN = Unseen()
HIDING = Hiding()
SEARCHING = Searching()
RELEASING = Releasing()
INVERSE = Inverse()
TIMING = Timing()
COMMANDING = Commanding()
CHOOSING = Choosing()
STEPPING = Stepping()
VERIFYING = Verifying()
MATTERING = Mattering()
DIFFERING = Differing()
FORECASTING = Forecasting()
GROWING = Growing()
SPLINING = Splining()
WORDING = Wording()
LEARNING = Learning()
SKETCHING = Sketching()
RUNNING = Running()
BEGINNING = Beginning()
SHOOTING = Shooting()
SIMULATING = Simulating()
PLAYING = Playing()
LINEARISING = Linearising()
CALIBRATING = Calibrating()
FOLDING = Folding()
FOLLOWING = Following()
WAVING = Waving()
MAPPING = Mapping()
DESIGNING = Designing()
LIMITING = Limiting()
COMPOSING = Composing()
SEPARATING = Separating()
ASSURING = Assuring()


def documented() -> list[tuple[str, Field[Any]]]:
    """Every threshold with the name of its class."""
    return [(c.__name__, f) for c in globals().values() if isinstance(c, type) and is_dataclass(c) for f in fields(c)]
