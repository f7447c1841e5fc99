"""The mirror in MLflow; nothing else imports it. A record is the truth: all of this can be rebuilt from records.

One MLflow run per record and experiment, found again by its run key, so that mirroring twice changes nothing.
"""

from bench.tracking.extensions import diagnosis_experiment, log_extension
from bench.tracking.records import CHARTED, MirrorResult, attach, flat, metrics, mirror
from bench.tracking.server import VIEW, TrackingError, artifact_root, default_uri, find_experiment, prepare
from bench.tracking.trials import mirror_trials
from bench.tracking.upkeep import repair, whole
from bench.tracking.vehicles import mirror_vehicle

__all__ = [
    "CHARTED",
    "VIEW",
    "MirrorResult",
    "TrackingError",
    "artifact_root",
    "attach",
    "default_uri",
    "diagnosis_experiment",
    "find_experiment",
    "flat",
    "log_extension",
    "metrics",
    "mirror",
    "mirror_trials",
    "mirror_vehicle",
    "prepare",
    "repair",
    "whole",
]
