"""One seed per axis, derived from the run's seed and paired across models."""

import hashlib


def derive(seed: int, axis: str) -> int:
    """A 63-bit seed for one axis ("weights", "batches/3"); the same for every model of that run seed."""
    return int.from_bytes(hashlib.sha256(f"{axis}:{seed}".encode()).digest()[:8], "big") >> 1


MOST_SEEDS = 12
"""Of one configuration, before evidence that grows seed by seed is judged for the last time: four times those of the
presets, which halves the part of an interval that comes of seeds.
"""
