"""Hashes that `provenance.json` holds of ``record.json`` and of itself; ``record.json`` holds those of all other files.

They lie in the one file that is no function of the run key, so that what is compared bit for bit stays as it was.
A record of a time before them has none.
"""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

RECORD, OWN = "record_sha256", "sha256"


def canonical(content: Mapping[str, Any]) -> str:
    """JSON as every file of a record has it: sorted keys, no NaN."""
    return json.dumps(content, sort_keys=True, indent=1, allow_nan=False) + "\n"


def stamped(provenance: Mapping[str, Any], record: bytes) -> dict[str, Any]:
    """The provenance with the hash of ``record.json`` and its own."""
    content = {**provenance, RECORD: hashlib.sha256(record).hexdigest()}
    return {**content, OWN: hashlib.sha256(canonical(content).encode()).hexdigest()}


def genuine(provenance: Mapping[str, Any]) -> bool:
    """Whether it is as it was written; one without stamps says nothing against itself."""
    if not {RECORD, OWN} & set(provenance):
        return True
    try:
        text = canonical({k: v for k, v in provenance.items() if k != OWN})
    except (ValueError, RecursionError):
        return False
    return bool(provenance.get(OWN) == hashlib.sha256(text.encode()).hexdigest())


def plain(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """The provenance without its stamps."""
    return {k: v for k, v in provenance.items() if k not in (RECORD, OWN)}
