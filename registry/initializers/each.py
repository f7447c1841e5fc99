"""An initializer of its own for each network of a composite predictor."""

from collections.abc import Sequence
from typing import cast

from torch import Tensor, nn

from registry.contracts import Composite, Initializer, InitializerEntry, Predictor


class EachInitializer(Initializer):
    """Initializes the parts of a `Composite` one by one and joins their states."""

    def __init__(self, parts: Sequence[Initializer]) -> None:
        super().__init__()
        self.parts = nn.ModuleList(parts)

    @property
    def uses_state_cost(self) -> bool:  # type: ignore[override]
        """As the parts do."""
        return any(part.uses_state_cost for part in self.parts)

    def initialize(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> Tensor:
        """See `Initializer.initialize`."""
        assert isinstance(predictor, Composite)
        states = [
            cast(Initializer, initializer).initialize(part, *predictor.part_history(i, inputs, outputs))
            for i, (initializer, part) in enumerate(zip(self.parts, predictor.parts(), strict=True))
        ]
        return predictor.join(states, inputs, outputs)


def build(entry: InitializerEntry, predictor: Predictor) -> Initializer:
    """The initializer of a predictor, or of every part of a composite one."""
    if isinstance(predictor, Composite):
        return EachInitializer([entry.build(part, part.problem) for part in predictor.parts()])
    return entry.build(predictor, predictor.problem)
