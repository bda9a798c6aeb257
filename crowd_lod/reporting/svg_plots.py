"""Plots as SVG inside a web page: no scripts, no fonts, and the page's own CSS colors.

Colors are CSS, such as var(--ink), so that plots follow the page into dark mode. Each mark says its
numbers where the pointer rests on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

WIDTH, HEIGHT = 560, 250
LEFT, RIGHT, TOP, BOTTOM = 58, 14, 12, 38  # of the frame around the data, in the same pixels
STEPS = 1, 2, 2.5, 5, 10  # of ticks, times powers of ten
MARKS = {
    "circle": "M-4,0a4,4 0 1,0 8,0a4,4 0 1,0 -8,0Z",
    "square": "M-5.5,-5.5H5.5V5.5H-5.5Z",
    "diamond": "M0,-6L6,0L0,6L-6,0Z",
}


@dataclass(frozen=True)
class Series:
    """A named row of values.

    values: (F,), or for points and curves (m, 2) of x and y.
    color: CSS.
    """

    name: str
    values: np.ndarray
    color: str


@dataclass(frozen=True)
class Scale:
    """An axis from `low` to `high`; `begin` to `end` are its pixels. log: by factors, for values above 0."""

    title: str
    low: float
    high: float
    begin: float
    end: float
    log: bool = False

    def place(self, values: np.ndarray | float) -> np.ndarray:
        """Return the pixels of the values."""
        low, high, at = (np.log10(each) if self.log else np.asarray(each) for each in (self.low, self.high, values))
        return self.begin + (self.end - self.begin) * (at - low) / (high - low)

    @property
    def ticks(self) -> list[float]:
        """At most seven round values; none on an axis without values."""
        if self.high <= self.low:
            return []
        if self.log:
            decades = 10.0 ** np.arange(np.floor(np.log10(self.low)), np.ceil(np.log10(self.high)) + 1)
            for factors in ((1, 2, 5), (1, 3), (1,)):
                found = [v for decade in decades for v in np.multiply(factors, decade) if self.low <= v <= self.high * (1 + 1e-9)]
                if len(found) <= 7:
                    break
            return [float(v) for v in found]
        rough = (self.high - self.low) / 5
        unit = 10.0 ** np.floor(np.log10(rough))
        step = unit * next(each for each in STEPS if each * unit >= rough * (1 - 1e-9))
        return [float(k * step) for k in range(int(np.ceil(self.low / step - 1e-9)), int(self.high / step + 1e-9) + 1)]


def across(title: str, low: float, high: float, log: bool = False, width: float = WIDTH) -> Scale:
    """Return the axis along the plot's lower edge."""
    return Scale(title, *_apart(low, high, log), LEFT, width - RIGHT, log)


def up(title: str, high: float, low: float = 0.0, log: bool = False, height: float = HEIGHT) -> Scale:
    """Return the axis along the plot's left edge, with some room above."""
    return Scale(title, *_apart(low, high if log else high + 0.04 * (high - low), log), height - BOTTOM, TOP, log)


def _apart(low: float, high: float, log: bool) -> tuple[float, float]:
    """Return the two values, or others around them if they are the same."""
    if high > low:
        return low, high
    return (low / 2, low * 2) if log else (low, low + max(1.0, abs(low)))


def plot(about: str, x: Scale, y: Scale, inside: str) -> str:
    """Return the SVG of a plot: both axes, and `inside` of it the marks (SVG).

    about: what it shows, for who cannot see it.
    """
    wide, high = f"{x.end + RIGHT:g}", f"{y.begin + BOTTOM:g}"
    lines = [f'<svg viewBox="0 0 {wide} {high}" role="img" aria-label="{escape(about)}">']
    for value in y.ticks:
        at = _text(y.place(value))
        lines.append(f'<path class="grid" d="M{x.begin:g},{at}H{x.end:g}"/>')
        lines.append(f'<text x="{x.begin - 7:g}" y="{at}" dy=".33em" text-anchor="end">{short(value)}</text>')
    for value in x.ticks:
        at = _text(x.place(value))
        lines.append(f'<path class="grid" d="M{at},{y.begin:g}v4"/>')
        lines.append(f'<text x="{at}" y="{y.begin + 16:g}" text-anchor="middle">{short(value)}</text>')
    lines.append(inside)
    middle = (x.begin + x.end) / 2
    lines.append(f'<path class="axis" d="M{x.begin:g},{y.begin:g}H{x.end:g}"/>')
    lines.append(f'<text x="{middle:g}" y="{y.begin + 33:g}" text-anchor="middle">{escape(x.title)}</text>')
    if y.title:
        turned = f'transform="rotate(-90)" x="{-(y.begin + y.end) / 2:g}" y="12" text-anchor="middle"'
        lines.append(f"<text {turned}>{escape(y.title)}</text>")
    return "\n".join([*lines, "</svg>"])


def edges(numbers: np.ndarray) -> np.ndarray:
    """Return where each frame's column begins, and the last ends, (F + 1,): half-way between frames.

    numbers: (F,) of the timeline, increasing.
    """
    numbers = np.asarray(numbers, np.float64)
    if len(numbers) == 1:
        return numbers[0] + np.array([-0.5, 0.5])
    half = np.diff(numbers) / 2
    return np.concatenate([[numbers[0] - half[0]], numbers[:-1] + half, [numbers[-1] + half[-1]]])


def stacked(x: Scale, y: Scale, at: np.ndarray, rows: Sequence[Series]) -> str:
    """Return areas one upon the other, the first lowest; a column for each frame.

    at: (F + 1,) of `edges`.
    """
    parts, below, places = [], np.zeros(len(at) - 1), x.place(at)
    for row in rows:
        above = below + row.values
        if row.values.any():
            there, back = _stairs(places, y.place(above)), _stairs(places[::-1], y.place(below)[::-1])
            parts.append(f'<path fill="{row.color}" d="M{there}L{back}Z">{_hover(row.name)}</path>')
        below = above
    return "\n".join(parts)


def steps(x: Scale, y: Scale, at: np.ndarray, rows: Sequence[Series]) -> str:
    """Return lines with a level stretch for each frame.

    at: (F + 1,) of `edges`.
    """
    places = x.place(at)
    return "\n".join(
        f'<path class="line" stroke="{row.color}" d="M{_stairs(places, y.place(row.values))}">{_hover(row.name)}</path>'
        for row in rows
    )


def curves(x: Scale, y: Scale, rows: Sequence[Series]) -> str:
    """Return lines through the points (m, 2) of each row."""
    parts = []
    for row in rows:
        points = " ".join(
            f"{_text(a)},{_text(b)}" for a, b in zip(x.place(row.values[:, 0]), y.place(row.values[:, 1]), strict=True)
        )
        parts.append(f'<polyline class="line" stroke="{row.color}" points="{points}">{_hover(row.name)}</polyline>')
    return "\n".join(parts)


def mark(x: Scale, y: Scale, row: Series, shape: str, says: Sequence[str]) -> str:
    """Return a mark, one of MARKS, at each point (m, 2) of the row, each of which says its text."""
    places = zip(x.place(row.values[:, 0]), y.place(row.values[:, 1]), says, strict=True)
    return "\n".join(
        f'<path class="mark" fill="{row.color}" d="{MARKS[shape]}" transform="translate({_text(a)},{_text(b)})">{_hover(text)}</path>'
        for a, b, text in places
    )


def _stairs(places: np.ndarray, levels: np.ndarray) -> str:
    """Return the path along columns from places (F + 1,) at levels (F,), without its first command."""
    parts = [f"{_text(places[0])},{_text(levels[0])}"]
    for k, end in enumerate(places[1:]):
        if k and levels[k] != levels[k - 1]:
            parts.append(f"V{_text(levels[k])}")
        parts.append(f"H{_text(end)}")
    return "".join(parts)


def _hover(text: str) -> str:
    return f"<title>{escape(text)}</title>"


def _text(value: np.ndarray | float) -> str:
    return f"{float(value):.1f}"


def short(value: float) -> str:
    """Return the value in few letters, such as 12k or 1.5M."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size * (1 - 1e-9):
            return f"{value / size:.3g}{letter}"
    return f"{value:.3g}"
