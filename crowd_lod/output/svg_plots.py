"""Plots as SVG, inside a web page or as files of their own (`sheet`): no scripts, no fonts.

Colors are CSS, such as var(--ink), so that plots follow the page into dark mode. Each mark says its
numbers where the pointer rests on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from textwrap import wrap

import numpy as np

WIDTH = 560
HEIGHT = 250
# of the frame around the data, in the same pixels
LEFT = 58
RIGHT = 14
TOP = 12
BOTTOM = 38
STEPS = 1, 2, 2.5, 5, 10  # of ticks, times powers of ten
MARKS = {
    "circle": "M-4,0a4,4 0 1,0 8,0a4,4 0 1,0 -8,0Z",
    "square": "M-5.5,-5.5H5.5V5.5H-5.5Z",
    "diamond": "M0,-6L6,0L0,6L-6,0Z",
    "up": "M0,-6L5.5,4H-5.5Z",
    "down": "M0,6L5.5,-4H-5.5Z",
    "left": "M-6,0L4,-5.5V5.5Z",
    "right": "M6,0L-4,-5.5V5.5Z",
    "star": "M0,-10L2.4,-3.2L9.5,-3.1L3.8,1.2L5.9,8.1L0,4L-5.9,8.1L-3.8,1.2L-9.5,-3.1L-2.4,-3.2Z",
}
SHEET_STYLE = """
text { font: 11px system-ui, sans-serif; fill: #444 } .title { font-size: 15px; fill: #000 }
.grid { stroke: #e4e4e4; fill: none } .axis { stroke: #444; fill: none }
.line { fill: none; stroke-width: 1.4 } .mark { stroke-width: 1.2 }
"""
LEGEND_ROW = 16  # pixels
LABEL = 60, 12  # pixels along x and y that the label of a point takes
# Letters that fit into a line: of a caption over two panels, and of a legend under one.
CAPTION_LETTERS = 190
LEGEND_LETTERS = 75


@dataclass(frozen=True)
class Series:
    """A named row of values.

    values: (F,), or for points and curves (m, 2) of x and y.
    color: CSS.
    shape: of its marks, one of MARKS. hollow: whether they have no filling.
    line: whether it has a line.
    spread: (m, 2), the least and the greatest x of each point; None without.
    tails: (m,), the y to which a thin line leads from each point; None without.
    labels: a text beside each point; () without.
    """

    name: str
    values: np.ndarray
    color: str
    shape: str = "circle"
    hollow: bool = False
    line: bool = True
    spread: np.ndarray | None = None
    tails: np.ndarray | None = None
    labels: Sequence[str] = ()


@dataclass(frozen=True)
class Panel:
    """A plot of a sheet: its SVG, its height in pixels, and the rows that its legend names."""

    plot: str
    height: float
    rows: Sequence[Series]


@dataclass(frozen=True)
class Scale:
    """An axis from `low` to `high`; `begin` to `end` are its pixels. log: by factors, for values
    above 0.
    """

    title: str
    low: float
    high: float
    begin: float
    end: float
    log: bool = False

    def place(self, values: np.ndarray | float) -> np.ndarray:
        """Return the pixels of the values."""
        low, high, at = (
            np.log10(each) if self.log else np.asarray(each)
            for each in (self.low, self.high, values)
        )
        return self.begin + (self.end - self.begin) * (at - low) / (high - low)

    @property
    def ticks(self) -> list[float]:
        """At most seven round values; none on an axis without values."""
        if self.high <= self.low:
            return []
        if self.log:
            decades = 10.0 ** np.arange(
                np.floor(np.log10(self.low)), np.ceil(np.log10(self.high)) + 1
            )
            for factors in ((1, 1.5, 2, 3, 4, 5, 6, 8), (1, 2, 5), (1, 3), (1,)):
                values = [
                    v
                    for decade in decades
                    for v in np.multiply(factors, decade)
                    if self.low <= v <= self.high * (1 + 1e-9)
                ]
                if len(values) <= 7:
                    break
            every = max(-(-len(values) // 7), 1)
            return [float(v) for v in values[::every]]
        rough = (self.high - self.low) / 5
        unit = 10.0 ** np.floor(np.log10(rough))
        step = unit * next(each for each in STEPS if each * unit >= rough * (1 - 1e-9))
        return [
            float(k * step)
            for k in range(int(np.ceil(self.low / step - 1e-9)), int(self.high / step + 1e-9) + 1)
        ]


def across(title: str, low: float, high: float, log: bool = False, width: float = WIDTH) -> Scale:
    """Return the axis along the plot's lower edge."""
    return Scale(title, *_apart(low, high, log), LEFT, width - RIGHT, log)


def up(
    title: str, high: float, low: float = 0.0, log: bool = False, height: float = HEIGHT
) -> Scale:
    """Return the axis along the plot's left edge, with some room above."""
    return Scale(
        title,
        *_apart(low, high if log else high + 0.04 * (high - low), log),
        height - BOTTOM,
        TOP,
        log,
    )


def _apart(low: float, high: float, log: bool) -> tuple[float, float]:
    """Return the two values, or others around them if they are the same."""
    if high > low:
        return low, high
    return (low / 2, low * 2) if log else (low, low + max(1.0, abs(low)))


def plot(about: str, x: Scale, y: Scale, inside: str) -> str:
    """Return the SVG of a plot: both axes, and `inside` of it the marks (SVG).

    about: what it shows, for who cannot see it.
    """
    wide = f"{x.end + RIGHT:g}"
    high = f"{y.begin + BOTTOM:g}"
    lines = [f'<svg viewBox="0 0 {wide} {high}" role="img" aria-label="{escape(about)}">']
    for value in y.ticks:
        at = _text(y.place(value))
        lines.append(f'<path class="grid" d="M{x.begin:g},{at}H{x.end:g}"/>')
        lines.append(
            f'<text x="{x.begin - 7:g}" y="{at}" dy=".33em" text-anchor="end">{short(value)}</text>'
        )
    for value in x.ticks:
        at = _text(x.place(value))
        lines.append(f'<path class="grid" d="M{at},{y.begin:g}v4"/>')
        lines.append(
            f'<text x="{at}" y="{y.begin + 16:g}" text-anchor="middle">{short(value)}</text>'
        )
    lines.append(inside)
    middle = (x.begin + x.end) / 2
    lines.append(f'<path class="axis" d="M{x.begin:g},{y.begin:g}H{x.end:g}"/>')
    lines.append(
        f'<text x="{middle:g}" y="{y.begin + 33:g}" text-anchor="middle">{escape(x.title)}</text>'
    )
    if y.title:
        turned = (
            f'transform="rotate(-90)" x="{-(y.begin + y.end) / 2:g}" y="12" text-anchor="middle"'
        )
        lines.append(f"<text {turned}>{escape(y.title)}</text>")
    return "\n".join([*lines, "</svg>"])


def edges(numbers: np.ndarray) -> np.ndarray:
    """Return where each frame's column begins, and the last ends, (F + 1,): half-way between
    frames.

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
    parts = []
    below = np.zeros(len(at) - 1)
    places = x.place(at)
    for row in rows:
        above = below + row.values
        if row.values.any():
            there = _stairs(places, y.place(above))
            back = _stairs(places[::-1], y.place(below)[::-1])
            parts.append(f'<path fill="{row.color}" d="M{there}L{back}Z">{_hover(row.name)}</path>')
        below = above
    return "\n".join(parts)


def steps(x: Scale, y: Scale, at: np.ndarray, rows: Sequence[Series]) -> str:
    """Return lines with a level stretch for each frame.

    at: (F + 1,) of `edges`.
    """
    places = x.place(at)
    return "\n".join(
        f'<path class="line" stroke="{row.color}" '
        f'd="M{_stairs(places, y.place(row.values))}">{_hover(row.name)}</path>'
        for row in rows
    )


def curves(x: Scale, y: Scale, rows: Sequence[Series]) -> str:
    """Return lines through the points (m, 2) of each row."""
    parts = []
    for row in rows:
        points = " ".join(
            f"{_text(a)},{_text(b)}"
            for a, b in zip(x.place(row.values[:, 0]), y.place(row.values[:, 1]), strict=True)
        )
        line = f'class="line" stroke="{row.color}" points="{points}"'
        parts.append(f"<polyline {line}>{_hover(row.name)}</polyline>")
    return "\n".join(parts)


def mark(x: Scale, y: Scale, row: Series, shape: str, says: Sequence[str]) -> str:
    """Return a mark, one of MARKS, at each point (m, 2) of the row, each of which says its text."""
    places = zip(x.place(row.values[:, 0]), y.place(row.values[:, 1]), says, strict=True)
    paint = _paint(row)
    return "\n".join(
        f'<path class="mark" {paint} d="{MARKS[shape]}" '
        f'transform="translate({_text(a)},{_text(b)})">{_hover(text)}</path>'
        for a, b, text in places
    )


def _paint(row: Series) -> str:
    return f'fill="none" stroke="{row.color}"' if row.hollow else f'fill="{row.color}"'


def bars(x: Scale, y: Scale, row: Series) -> str:
    """Return a level bar over the spread of each point of the row, and its tail, if it has any."""
    across, up = x.place(row.values[:, 0]), y.place(row.values[:, 1])
    left, right = (across, across) if row.spread is None else x.place(row.spread.T)
    tails = up if row.tails is None else y.place(row.tails)
    path = "".join(
        f"M{_text(a)},{_text(b)}H{_text(c)}M{_text(d)},{_text(b)}V{_text(e)}"
        for a, b, c, d, e in zip(left, up, right, across, tails, strict=True)
    )
    return f'<path stroke="{row.color}" stroke-width="0.8" d="{path}"/>'


def labels(x: Scale, y: Scale, row: Series, taken: list[tuple[float, float]]) -> str:
    """Return the row's labels, each to the upper right of its point (m, 2).

    taken: places of labels, to which those of the row are added; what would lie over one is left
        out.
    """
    texts = []
    places = zip(x.place(row.values[:, 0]), y.place(row.values[:, 1]), row.labels, strict=False)
    for a, b, label in places:
        is_free = all(abs(a - c) > LABEL[0] or abs(b - d) > LABEL[1] for c, d in taken)
        if label and is_free:
            taken.append((float(a), float(b)))
            texts.append(f'<text x="{_text(a + 8)}" y="{_text(b - 5)}">{escape(label)}</text>')
    return "".join(texts)


def level(x: Scale, y: Scale, value: float, says: str) -> str:
    """Return a dotted line across the plot at a value, with a text above it."""
    at = _text(y.place(value))
    line = f'<path stroke="#999" stroke-dasharray="1 3" d="M{x.begin:g},{at}H{x.end:g}"/>'
    return f'{line}<text x="{x.begin + 4:g}" y="{at}" dy="-3">{escape(says)}</text>'


def sheet(title: str, caption: str, panels: Sequence[Panel]) -> str:
    """Return an SVG file: the plots side by side, each with its legend below."""
    lines = wrap(caption, CAPTION_LETTERS)
    top = 40 + 14 * len(lines)
    legends = [[wrap(row.name, LEGEND_LETTERS) for row in panel.rows] for panel in panels]
    heights = [
        panel.height + LEGEND_ROW * (1 + sum(map(len, names)))
        for panel, names in zip(panels, legends, strict=True)
    ]
    height = top + max(heights)
    width = WIDTH * len(panels)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height:g}" '
        f'width="{width}" height="{height:g}">',
        f'<style>{SHEET_STYLE}</style><rect width="100%" height="100%" fill="#fff"/>',
        f'<text class="title" x="{width / 2:g}" y="22" text-anchor="middle">{escape(title)}</text>',
    ]
    for n, line in enumerate(lines):
        parts.append(
            f'<text x="{width / 2:g}" y="{40 + 14 * n}" text-anchor="middle">{escape(line)}</text>'
        )
    for n, panel in enumerate(panels):
        place = f'x="{WIDTH * n}" y="{top}" width="{WIDTH}" height="{panel.height:g}"'
        parts.append(f"<svg {place}>{panel.plot}</svg>")
        x = WIDTH * n + LEFT
        y = top + panel.height + LEGEND_ROW
        for row, name_lines in zip(panel.rows, legends[n], strict=True):
            entry = _legend_entry(row, name_lines)
            parts.append(f'<g transform="translate({x},{y:g})">{entry}</g>')
            y += LEGEND_ROW * len(name_lines)
    return "\n".join([*parts, "</svg>\n"])


def _legend_entry(row: Series, name_lines: Sequence[str]) -> str:
    line = f'<path class="line" stroke="{row.color}" d="M0,0H34"/>' if row.line else ""
    mark = f'<path class="mark" {_paint(row)} d="{MARKS[row.shape]}" transform="translate(17,0)"/>'
    texts = [
        f'<text x="42" y="{LEGEND_ROW * k}" dy=".33em">{escape(text)}</text>'
        for k, text in enumerate(name_lines)
    ]
    return f"{line}{mark}{''.join(texts)}"


def _stairs(places: np.ndarray, levels: np.ndarray) -> str:
    """Return the path along columns from places (F + 1,) at levels (F,), without its first
    command.
    """
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
    """Return the value in few letters, such as 12k, 1.5M or 2e-5."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size * (1 - 1e-9):
            return f"{value / size:.3g}{letter}"
    if 0 < abs(value) < 1e-3 * (1 - 1e-9):
        return np.format_float_scientific(value, 2, trim="-", exp_digits=1)
    return f"{value:.3g}"
