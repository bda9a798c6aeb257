"""The page of error against run time: verdicts, each with its plots and its numbers."""

from collections.abc import Callable, Sequence
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
    label: the text beside a point; "" for none.
    foretold: columns of a point's predicted x and y; None for none.
    """

    line: str
    x: PlotAxis
    y: PlotAxis
    label: Callable[[Row], str]
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
        known = {
            plot: [row for row in self.rows if None not in (row[plot.x.column], row[plot.y.column])]
            for plot in self.plots
        }
        return [_panel(plot, rows) for plot, rows in known.items() if rows]


def _panel(plot: Plot, rows: Sequence[Row]) -> svg.Panel:
    """Return a plot of rows; the default is marked by a star."""
    x_name, y_name, bottom = plot.x.column, plot.y.column, plot.y.floor
    ends = f"{x_name}_least", f"{x_name}_most"
    series, foretold, stars = [], [], []
    for number, name in enumerate(dict.fromkeys(row[plot.line] for row in rows)):
        floor = bottom * LOWER**number
        look = COLORS[number % len(COLORS)], SHAPES[number % len(SHAPES)]
        own = [row for row in rows if row[plot.line] == name]
        points = _points(own, x_name, y_name, floor)
        stars += [point for row, point in zip(own, points, strict=True) if row["default"]]
        spread = [[row[end] for end in ends if end in row] for row in own]
        series.append(
            svg.Series(
                name,
                points,
                look[0],
                shape=look[1],
                line=len(own) > 1,
                spread=np.array(spread) if spread[0] else None,
                tails=_points(own, x_name, plot.y.tail or y_name, floor)[:, 1],
                labels=[plot.label(row) for row in own],
            )
        )
        if plot.foretold is not None:
            there = [row for row in own if row[plot.foretold[0]] is not None]
            points = _points(there, *plot.foretold, floor)
            foretold.append(svg.Series("predicted", points, *look, hollow=True, line=False))
    star = svg.Series(
        "default", np.array(stars).reshape(-1, 2), "#000000", "star", hollow=True, line=False
    )
    drawn = [*series, *foretold, *[star][: len(stars)]]
    shown = np.concatenate([row.values for row in drawn])
    low, high = shown.min(axis=0), shown.max(axis=0)
    x = svg.across(plot.x.title, low[0] / 1.4, high[0] * 1.8, log=True)
    least = min([low[1], bottom, *(row.tails.min() for row in series if row.tails is not None)])
    most = max(high[1], 3 * bottom)
    y = svg.up(plot.y.title, most * 1.5, least / 1.5, log=True, height=HEIGHT)
    marks = [svg.level(x, y, bottom, plot.y.says)]
    marks.append(svg.curves(x, y, [row for row in drawn if row.line]))
    taken: list[tuple[float, float]] = []
    for row in drawn:
        says = [f"{row.name}: {a:.3g}, {b:.3g}" for a, b in row.values]
        marks.append(svg.bars(x, y, row))
        marks.append(svg.mark(x, y, row, row.shape, says))
        marks.append(svg.labels(x, y, row, taken))
    legend = [*series, *foretold[:1], *[star][: len(stars)]]
    return svg.Panel(svg.plot(plot.y.title, x, y, "\n".join(marks)), HEIGHT, legend)


def _points(rows: Sequence[Row], x: str, y: str, floor: float) -> np.ndarray:
    """Return the points (m, 2) of the rows; those below the floor lie on it."""
    points = [(row[x], max(row[y], floor)) for row in rows]
    return np.array(points, np.float64).reshape(-1, 2)


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
