"""Small drawings written straight as SVG: axes with units, curves, bands, boxes, points with labels.

Text stays text and colours follow the page, a drawing takes a few kilobytes, and the same numbers give the same bytes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from markupsafe import Markup, escape
from matplotlib.ticker import MaxNLocator

Values = Sequence[float] | np.ndarray

CHARACTER = 6.9
"""Width of a character of the drawings' text; an upper bound of the mean in the fonts of the page."""
LINE = 14.0
"""Height of a line of text."""
SHADES = 6
"""Of a cloud of points, from one alone to many in one place."""
FINEST = 1 / 2500
"""Of the height of a frame: to what a trace is rounded."""
FAR = 40_000
"""In that unit: how far outside the frame a trace is still drawn where it is."""


@dataclass(frozen=True)
class Look:
    """How a line is drawn."""

    colour: str
    dashes: tuple[float, ...] = ()
    """Of `bench.reporting.figures`: in units of the width; empty: solid."""
    width: float = 1.7
    opacity: float = 1.0

    @property
    def stroke(self) -> str:
        """As attributes of an SVG element."""
        dashes = " ".join(f"{self.width * d:.3g}" for d in self.dashes)
        return (
            f'stroke="{self.colour}" stroke-width="{self.width:g}"'
            + (f' stroke-dasharray="{dashes}"' if dashes else "")
            + (f' stroke-opacity="{self.opacity:g}"' if self.opacity < 1 else "")
        )


@dataclass(frozen=True)
class Scale:
    """From values to a length; ``log`` for positive values only."""

    low: float
    high: float
    log: bool = False
    whole: bool = False
    """Of counts: no ticks between them."""

    def __call__(self, value: float) -> float:
        """0 at ``low``, 1 at ``high``."""
        low, high, at = (
            (math.log(v) for v in (self.low, self.high, value)) if self.log else (self.low, self.high, value)
        )
        return (at - low) / (high - low)

    def ticks(self, count: int) -> list[float]:
        """At most about ``count`` round values within."""
        found: list[float] = []
        if self.log:
            decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
            for parts in ((1,), (1, 3), (1, 2, 5)):
                within = [10.0**d * p for d in decades for p in parts if self.low <= 10.0**d * p <= self.high]
                found = within if len(within) <= count + 1 or not found else found
            found = found[:: -(-len(found) // count)] if found else found
        if len(found) < 2:
            found = list(
                MaxNLocator(count, steps=[1, 2, 2.5, 5, 10], integer=self.whole).tick_values(self.low, self.high)
            )
        slack = 1e-9 * (self.high - self.low)
        return [float(t) for t in found if self.low - slack <= t <= self.high + slack]


def around(values: Sequence[float], log: bool = False, zero: bool = False, room: float = 0.06) -> Scale:
    """A scale that holds all finite values with some room; ``zero``: it begins at 0."""
    finite = [v for v in values if math.isfinite(v) and (v > 0 or not log)] or [1.0]
    low, high = min(finite), max(finite)
    if log:
        room = max((high / low) ** room, 1.15)
        return Scale(low / room, high * room, log=True)
    if zero:
        return Scale(0.0, (high or 1.0) * (1 + room))
    space = room * (high - low) or 0.1 * abs(high) or 1.0
    return Scale(low - space, high + space)


def tick_label(value: float) -> str:
    """Such as "0.25", "−2" or "20 000"."""
    text = f"{value:,.0f}".replace(",", "\u202f") if abs(value) >= 1e4 else f"{value:.6g}"
    return text.replace("-", "−")


@dataclass
class Panel:
    """One drawing with two axes; draw into it, then ask for `svg`.

    The name of the y axis stands above it, so that it is read without turning the head.
    """

    x: Scale
    y: Scale
    x_name: str
    """With its unit, as `y_name`: "time after k0 [s]"."""
    y_name: str
    width: float = 330.0
    height: float = 190.0
    right: float = 14.0
    """Room at the right, for labels."""
    marks: list[str] = field(default_factory=list)
    outside: list[str] = field(default_factory=list)
    """What may leave the frame."""

    def __post_init__(self) -> None:
        self.y_ticks = self.y.ticks(5)
        self.left = 8 + CHARACTER * max((len(tick_label(t)) for t in self.y_ticks), default=1)
        self.top, self.bottom = 22.0, 32.0
        self.wide, self.high = self.width - self.left - self.right, self.height - self.top - self.bottom

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Point within the frame; values far outside stay drawable."""
        share = min(9.0, max(-9.0, self.y(y) if not self.y.log or y > 0 else -9.0))
        return self.wide * self.x(x), self.high * (1 - share)

    def _path(self, xs: Values, ys: Values) -> list[str]:
        """Points of a curve; it is broken where a value is not finite."""
        pieces, pen = [], "M"
        for x, y in zip(xs, ys, strict=True):
            if not math.isfinite(y):
                pen = "M"
                continue
            across, down = self.at(x, y)
            pieces.append(f"{pen}{across:.1f} {down:.1f}")
            pen = "L"
        return pieces

    def line(self, xs: Values, ys: Values, look: Look) -> None:
        """A curve."""
        if path := self._path(xs, ys):
            self.marks.append(f'<path d="{"".join(path)}" fill="none" stroke-linejoin="round" {look.stroke}/>')

    def trace(self, pieces: Sequence[tuple[np.ndarray, np.ndarray]], step: float, look: Look, name: str) -> None:
        """A long curve in few bytes: whole numbers, of x in steps and of y in `FINEST` of the frame.

        A script finds in ``data-of`` what they are: x and y of the frame's corner, and the size of both units.

        Args:
            pieces: the curve between its breaks: x (n,) in steps, whole numbers, and y (n,).
            step: one of them in units of x.
            look: its width and dashes stay as the frame is zoomed.
            name: put in ``data-name``.
        """
        unit = (self.y.high - self.y.low) * FINEST
        parts, last = [], (0, 0)
        for xs, ys in pieces:
            finite = np.isfinite(ys)
            up = np.where(finite, np.clip((np.where(finite, ys, 0.0) - self.y.low) / unit, -FAR, FAR), 0.0)
            pen = "m"
            for x, y, there in zip(xs.tolist(), np.rint(up).astype(int).tolist(), finite.tolist(), strict=True):
                if not there:
                    pen = "m"
                    continue
                parts.append(f"{pen}{x - last[0]}{'' if y < last[1] else ' '}{y - last[1]}")
                pen, last = " ", (x, y)
        (left, low), (across, up_one) = self.at(0.0, self.y.low), self.at(step, self.y.low + unit)
        matrix = f"matrix({across - left:.6g} 0 0 {up_one - low:.6g} {left:.6g} {low:.6g})"
        of = f"{step:.9g} {self.y.low:.9g} {unit:.9g}"
        fixed = 'fill="none" stroke-linejoin="round" vector-effect="non-scaling-stroke"'
        self.marks.append(
            f'<g class="trace" data-name="{escape(name)}" data-of="{of}" transform="{matrix}">'
            f'<path d="{"".join(parts)}" {fixed} {look.stroke}/></g>'
        )

    def dots(self, xs: Values, ys: Values, colour: str, hollow: bool = False, radius: float = 3.2) -> None:
        """A dot a point."""
        paint = f'fill="none" stroke="{colour}" stroke-width="1.2"' if hollow else f'fill="{colour}" fill-opacity=".8"'
        for x, y in zip(xs, ys, strict=True):
            if math.isfinite(y):
                across, down = self.at(x, y)
                self.marks.append(f'<circle cx="{across:.1f}" cy="{down:.1f}" r="{radius:g}" {paint}/>')

    def cloud(self, xs: Values, ys: Values) -> None:
        """Many points, darker where there are more of them: `SHADES` paths, of which each covers a place but once."""
        spots = [self.at(x, y) for x, y in zip(xs, ys, strict=True) if math.isfinite(y)]
        for some in (spots[i::SHADES] for i in range(min(SHADES, len(spots)))):
            path = "".join(f"M{across:.1f} {down:.1f}h0" for across, down in some)
            self.marks.append(f'<path class="cloud" d="{path}"/>')

    def band(self, xs: Values, low: Values, high: Values, colour: str) -> None:
        """The area between two curves."""
        finite = [(x, a, b) for x, a, b in zip(xs, low, high, strict=True) if math.isfinite(a) and math.isfinite(b)]
        if finite:
            there = self._path([x for x, _, _ in finite], [b for _, _, b in finite])
            back = self._path([x for x, _, _ in reversed(finite)], [a for _, a, _ in reversed(finite)])
            outline = "".join(there) + "".join(back).replace("M", "L") + "Z"
            self.marks.append(f'<path d="{outline}" fill="{colour}" fill-opacity=".14"/>')

    def box(
        self, x: float, width: float, whiskers: tuple[float, float], box: tuple[float, float], median: float
    ) -> None:
        """Whiskers, box and median at x; ``width`` in units of x."""
        half = self.wide * (self.x(x + width / 2) - self.x(x))
        (across, low), (_, high) = (self.at(x, w) for w in whiskers)
        bottom, top, middle = (self.at(x, v)[1] for v in (*box, median))
        left, cap = across - half, half / 2
        ends = "".join(f"M{across - cap:.1f} {end:.1f}h{half:.1f}" for end in (low, high))
        stem = f"M{across:.1f} {low:.1f}V{bottom:.1f}M{across:.1f} {top:.1f}V{high:.1f}"
        size = f'width="{2 * half:.1f}" height="{max(bottom - top, 0):.1f}"'
        self.marks.append(
            f'<path class="whisker" d="{stem}{ends}"/><rect class="box" x="{left:.1f}" y="{top:.1f}" {size}/>'
            f'<path class="median" d="M{left:.1f} {middle:.1f}h{2 * half:.1f}"/>'
        )

    def points(self, points: Sequence[tuple[float, float, float, float, str, str]]) -> None:
        """Points with a vertical interval and a label each: x, y, low, high, colour, label.

        Labels stand below one another at the right of the frame, in the order of the points' heights, so that none
        covers another; a thin line leads to each.
        """
        rest = sorted(
            (*self.at(x, y)[::-1], self.at(x, low)[1], self.at(x, high)[1], colour, label)
            for x, y, low, high, colour, label in points
        )
        first, last = -4.0, self.high + 6
        spots: list[float] = []
        for down, *_ in rest:
            spots.append(max(down, spots[-1] + LINE if spots else first))
        for i in reversed(range(len(spots))):  # push back up what went out at the bottom
            spots[i] = min(spots[i], spots[i + 1] - LINE if i + 1 < len(spots) else last)
        for spot, (down, across, low, high, colour, label) in zip(spots, rest, strict=True):
            if math.isfinite(low) and math.isfinite(high):
                self.marks.append(
                    f'<path d="M{across:.1f} {low:.1f}V{high:.1f}" stroke="{colour}" stroke-width="1.5"/>'
                )
            self.outside.append(
                f'<path class="leader" d="M{across:.1f} {down:.1f}L{self.wide + 4:.1f} {spot:.1f}h5"/>'
                f'<circle cx="{across:.1f}" cy="{down:.1f}" r="4.5" fill="{colour}"/>'
                f'<text class="label" x="{self.wide + 12:.1f}" y="{spot + 4:.1f}">{escape(label)}</text>'
            )

    def svg(self, title: str) -> Markup:
        """The drawing as an inline SVG element; ``title`` is read to those who cannot see it."""

        def text(kind: str, x: float, y: float, said: str, anchor: str = "middle") -> str:
            return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(said)}</text>'

        base = self.top + self.high
        frame = [f'<path class="axis" d="M{self.left:.1f} {base:.1f}h{self.wide:.1f}"/>']
        for tick in self.y_ticks:
            down = base - self.high * self.y(tick)
            frame.append(f'<path class="rule" d="M{self.left:.1f} {down:.1f}h{self.wide:.1f}"/>')
            frame.append(text("tick", self.left - 5, down + 4, tick_label(tick), "end"))
        for tick in self.x.ticks(max(2, int(self.wide / 60))):
            across = self.left + self.wide * self.x(tick)
            frame.append(f'<path class="axis" d="M{across:.1f} {base:.1f}v3"/>')
            frame.append(text("tick", across, base + 14, tick_label(tick)))
        frame.append(text("name", 0, 11, self.y_name, "start"))
        frame.append(text("name", self.left + self.wide / 2, self.height - 3, self.x_name))
        place = f'x="{self.left:.1f}" y="{self.top:.1f}" width="{self.wide:.1f}" height="{self.high:.1f}"'
        over = f'<g transform="translate({self.left:.1f} {self.top:.1f})">{"".join(self.outside)}</g>'
        return Markup(
            f'<svg class="panel drawn" viewBox="0 0 {self.width:g} {self.height:g}" role="img" '
            f'aria-label="{escape(title)}">{"".join(frame)}<svg {place}>{"".join(self.marks)}</svg>'
            f"{over if self.outside else ''}</svg>"
        )


def align(panels: Sequence[Panel]) -> None:
    """Let the frames of drawings below one another begin at the same place."""
    left = max(p.left for p in panels)
    for p in panels:
        p.left, p.wide = left, p.width - left - p.right


def swatch(look: Look) -> Markup:
    """A line as a legend shows it."""
    return Markup(
        '<svg class="swatch" viewBox="0 0 34 10" aria-hidden="true">'
        f'<path d="M0 5h34" fill="none" {look.stroke}/></svg>'
    )


def interval(ratio: float, low: float, high: float, band: tuple[float, float], scale: Scale, tone: str) -> Markup:
    """A ratio with its interval on a log scale; the pale band is what counts as alike, the line is 1."""

    def at(value: float) -> float:
        return 4 + 112 * min(1.0, max(0.0, scale(value)))

    marks = (
        f'<rect class="alike" x="{at(band[0]):.1f}" y="1" width="{at(band[1]) - at(band[0]):.1f}" height="14"/>'
        f'<path class="one" d="M{at(1):.1f} 0v16"/>'
    )
    if math.isfinite(low) and math.isfinite(high):
        marks += f'<path class="span {tone}" d="M{at(low):.1f} 8H{at(high):.1f}"/>'
    if math.isfinite(ratio):
        marks += f'<circle class="dot {tone}" cx="{at(ratio):.1f}" cy="8" r="4"/>'
    return Markup(f'<svg class="ratio" viewBox="0 0 120 16" aria-hidden="true">{marks}</svg>')
