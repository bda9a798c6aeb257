"""The page of error against run time: verdicts, each with its plots and its numbers."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from . import svg_plots as svg
from .html_report import STYLE, document, table_of
from .tables import to_csv

COLORS = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5195", "#444444",
    "#8c564b", "#999933", "#882255", "#332288",
)  # fmt: skip
SHAPES = "circle", "square", "diamond", "up", "down", "left", "right"
HEIGHT = 420  # of a plot, in pixels
LOWER = 0.85  # times: points of the next line that lie on the floor, below those of the one before

Row = dict[str, Any]  # of a table


@dataclass(frozen=True)
class PlotAxis:
    """A column that stands along an axis, by factors.

    title: what it is.
    floor: where values are drawn that are less; 0 for none. says: what it is.
    tail: the column to which a thin line leads from each point; "" for none.
    """

    column: str
    title: str
    floor: float = 0.0
    says: str = ""
    tail: str = ""


@dataclass(frozen=True)
class Plot:
    """A plot of what ways take, and how wrong they are.

    line: the column that tells which points belong together.
    label: the text beside a point, of the columns in braces.
    foretold: columns of a point's predicted x and y; None for none.
    """

    line: str
    x: PlotAxis
    y: PlotAxis
    label: str
    foretold: tuple[str, str] | None = None


@dataclass(frozen=True)
class Section:
    """A part of the page.

    name: of its files.
    means: what the error means. verdict: what follows for the user. Sentences.
    rows: of its table, its CSV, and its plots.
    """

    name: str
    title: str
    means: str
    verdict: str
    plots: Sequence[Plot] = ()
    rows: Sequence[Row] = ()

    @property
    def panels(self) -> list[svg.Panel]:
        """The plots that there are points for, drawn."""
        panels = []
        for plot in self.plots:
            x, y = plot.x.column, plot.y.column
            known = [row for row in self.rows if None not in (row[x], row[y])]
            panels += [_panel(plot, known)] if known else []
        return panels


def _panel(plot: Plot, rows: Sequence[Row]) -> svg.Panel:
    """Return a plot of rows; the default is marked by a star."""
    series, foretold, stars = [], [], []
    for number, name in enumerate(dict.fromkeys(row[plot.line] for row in rows)):
        own = [row for row in rows if row[plot.line] == name]
        look = COLORS[number % len(COLORS)], SHAPES[number % len(SHAPES)]
        floor = plot.y.floor * LOWER**number
        series.append(_line(plot, own, floor, look))
        stars += [_point(plot, row, floor) for row in own if row["default"]]
        if plot.foretold is not None:
            takes, off = plot.foretold
            points = [(row[takes], max(row[off], floor)) for row in own if row[takes] is not None]
            foretold.append(svg.Series("predicted", _array(points), *look, hollow=True, line=False))
    star = svg.Series("default", _array(stars), "#000000", "star", hollow=True, line=False)
    drawn = [*series, *foretold, star]
    x, y = _axes(plot, drawn)
    marks = [svg.level(x, y, plot.y.floor, plot.y.says)]
    marks.append(svg.curves(x, y, [row for row in drawn if row.line]))
    taken: list[tuple[float, float]] = []
    for row in drawn:
        says = [f"{row.name}: {a:.3g}, {b:.3g}" for a, b in row.values]
        marks.append(svg.bars(x, y, row))
        marks.append(svg.mark(x, y, row, row.shape, says))
        marks.append(svg.labels(x, y, row, taken))
    legend = [*series, *foretold[:1], star]
    return svg.Panel(svg.plot(plot.y.title, x, y, "\n".join(marks)), HEIGHT, legend)


def _line(plot: Plot, rows: Sequence[Row], floor: float, look: tuple[str, str]) -> svg.Series:
    """Return the points that belong together, with what is known around them."""
    least, most = (f"{plot.x.column}_{end}" for end in ("least", "most"))
    spread = [(row[least], row[most]) for row in rows if least in row]
    tails = [max(row[plot.y.tail or plot.y.column], floor) for row in rows]
    return svg.Series(
        rows[0][plot.line],
        _array([_point(plot, row, floor) for row in rows]),
        *look,
        line=len(rows) > 1,
        spread=_array(spread) if spread else None,
        tails=np.array(tails, np.float64),
        labels=[plot.label.format_map(row) for row in rows],
    )


def _point(plot: Plot, row: Row, floor: float) -> tuple[float, float]:
    """Return the point of a row; one below the floor lies on it."""
    return row[plot.x.column], max(row[plot.y.column], floor)


def _array(points: Sequence[tuple[float, float]]) -> np.ndarray:
    return np.array(points, np.float64).reshape(-1, 2)


def _axes(plot: Plot, drawn: Sequence[svg.Series]) -> tuple[svg.Scale, svg.Scale]:
    """Return the axes, by factors, that hold all points and their tails."""
    shown = np.concatenate([row.values for row in drawn])
    tails = np.concatenate([row.tails for row in drawn if row.tails is not None])
    low, high = shown.min(axis=0), shown.max(axis=0)
    x = svg.across(plot.x.title, low[0] / 1.4, high[0] * 1.8, log=True)
    least, most = min(low[1], tails.min()), max(high[1], 3 * plot.y.floor)
    return x, svg.up(plot.y.title, most * 1.5, least / 1.5, log=True, height=HEIGHT)


def write_page(folder: Path, title: str, caption: str, sections: Sequence[Section]) -> list[str]:
    """Write report.html, and of each section with rows a CSV and an SVG; return their names.

    caption: the machine, and how it was measured.
    """
    heading = f"{escape(title)}: error against run time"
    parts = [f"<h1>{heading}</h1>", f"<p>{escape(caption)}</p>"]
    files = {}
    for section in sections:
        parts.append(f"<h2>{escape(section.title)}</h2>")
        parts.append(f'<p class="verdict">{escape(section.verdict)}</p>')
        parts.append(f"<p>{escape(section.means)}</p>")
        if panels := section.panels:
            sheet = svg.sheet(section.title, caption, panels)
            files[f"{section.name}.svg"] = sheet
            parts.append(f'<div class="scroll">{sheet}</div>')
        if section.rows:
            files[f"{section.name}.csv"] = f"# {caption}\n{to_csv(list(section.rows))}"
            head = [name.replace("_", " ") for name in section.rows[0]]
            cells = [[_cell(value) for value in row.values()] for row in section.rows]
            parts.append(table_of(head, cells))
    files["report.html"] = document(heading, STYLE, parts)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return sorted(files)


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    return "-" if value is None else escape(str(value))
