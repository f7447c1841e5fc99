"""An initializer of its own for each network of a composite predictor."""

from collections.abc import Sequence
from typing import cast

from torch import Tensor, nn
from typing_extensions import override

from registry.contracts import Composite, Gradients, Initializer, InitializerEntry, InitialVJP, Predictor


class EachInitializer(Initializer):
    """Initializes the parts of a `Composite` one by one and joins their states."""

    def __init__(self, parts: Sequence[Initializer]) -> None:
        super().__init__()
        self.parts = nn.ModuleList(parts)

    @property
    def uses_state_cost(self) -> bool:  # type: ignore[override]
        """As the parts do."""
        return any(part.uses_state_cost for part in self.parts)

    @override
    def initialize(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> Tensor:
        assert isinstance(predictor, Composite)
        states = [
            cast(Initializer, initializer).initialize(part, *predictor.part_history(i, inputs, outputs))
            for i, (initializer, part) in enumerate(zip(self.parts, predictor.parts(), strict=True))
        ]
        return predictor.join(states, inputs, outputs)

    @override
    def initialize_vjp(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> tuple[Tensor, InitialVJP]:
        assert isinstance(predictor, Composite)
        names = {id(network): name for name, network in predictor.named_children()}
        parts = [
            (names[id(part)], *cast(Initializer, x).initialize_vjp(part, *predictor.part_history(i, inputs, outputs)))
            for i, (x, part) in enumerate(zip(self.parts, predictor.parts(), strict=True))
        ]

        def vjp(d_state: Tensor) -> tuple[Gradients, Gradients]:
            own: Gradients = {}
            others: Gradients = {}
            for i, ((name, _, back), d) in enumerate(zip(parts, predictor.separate(d_state), strict=True)):
                of_part, network = back(d)
                own |= {f"parts.{i}.{n}": g for n, g in of_part.items()}
                others |= {f"{name}.{n}": g for n, g in network.items()}
            return own, others

        return predictor.join([state for _, state, _ in parts], inputs, outputs), vjp


def build(entry: InitializerEntry, predictor: Predictor) -> Initializer:
    """The initializer of a predictor, or of every part of a composite one."""
    if isinstance(predictor, Composite):
        return EachInitializer([entry.build(part, part.problem) for part in predictor.parts()])
    return entry.build(predictor, predictor.problem)
