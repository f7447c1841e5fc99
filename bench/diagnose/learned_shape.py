"""What a diagnosis says of a learned term: where it acts, what it follows and how, and its drawing."""

from dataclasses import dataclass

WAVE = "wave"
"""The shape of what swings at one frequency and follows no signal; each recording has its amplitude and phase."""

SWING, RELAXATION = "swing", "relaxation"
"""The shapes of hidden modes: what signals drive and no sensor sees swings, or relaxes."""


@dataclass(frozen=True)
class LearnedShape:
    """A term that no catalogue has: f of one signal, times another one if there are two; a wave; or a hidden mode."""

    axis: str
    """Along which it acts, such as "world_force_x" or "speed.q" (then a rate of change); of a mode with commas."""
    signals: tuple[str, ...]
    shape: str
    """A formula of `registry.terms.shapes`, "spline", `WAVE`, `SWING` or `RELAXATION`."""
    formula: str
    """As text, such as "k x"."""
    described: str
    """All of it in a line, such as "world force x = f(position x), linear, k = −0.31 N/m (−0.32 to −0.30)"."""
    nearest: tuple[str, ...] = ()
    """Ids of the effects of the catalogue that come nearest to it; empty: none comes near."""
    likeness: float = 0.0
    """Share of the squared rates that the term makes of the recordings that the first would make too, 0 to 1."""
    known_as: str = ""
    """What has such a shape elsewhere, such as "a spring"; empty: nothing that is well known."""

    @property
    def name(self) -> str:
        """As `bench extend --add` takes it."""
        if self.shape in (SWING, RELAXATION):
            return f"{self.axis} ~ {self.shape}"
        alone = WAVE if self.shape == WAVE else "1"  # a function of signals may be a wave as well
        return f"{self.axis} ~ {' * '.join(self.signals) or alone}"


@dataclass(frozen=True)
class LearnedCurve:
    """The shape of a learned term over the data that it was learned from, SI."""

    x_signal: str
    x_unit: str
    y_quantity: str
    y_unit: str
    x: tuple[float, ...]
    """Where the curve is given."""
    y: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    """95 % band."""
    dots_x: tuple[float, ...]
    dots_y: tuple[float, ...]
    """What is left of the measurements without the term, as means over short windows."""
