"""What can be compared: predictors, initializers, datasets, physics models and effects."""

from registry.core import (
    DATASETS,
    EFFECTS,
    INITIALIZERS,
    PHYSICS,
    PREDICTORS,
    REGISTRIES,
    Registry,
    option,
)

__all__ = ["DATASETS", "EFFECTS", "INITIALIZERS", "PHYSICS", "PREDICTORS", "REGISTRIES", "Registry", "option"]
