"""The page of error against run time: three plots, each with a verdict and its numbers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from . import svg_plots as svg
from .html_report import STYLE, document, table_of
from .tables import to_csv

COLORS = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5195", "#444444"
SHAPES = "circle", "square", "diamond", "up", "down", "left", "right"
HEIGHT = 420  # of a plot, in pixels
DASHED = "6 4"

Row = dict[str, Any]  # of a table
Value = Callable[[Row], float]


@dataclass(frozen=True)
class Section:
    """A part of the page.

    name: of its files.
    means: what the error means. verdict: what follows for the user. Sentences.
    panels: plots; a section without any has sentences alone.
    rows: of its table, and of its CSV.
    """

    name: str
    title: str
    means: str
    verdict: str
    panels: Sequence[svg.Panel] = ()
    rows: Sequence[Row] = ()


@dataclass(frozen=True)
class PlotAxis:
    """What stands along an axis of a plot.

    floor: where values are drawn that are less; 0 for none. says: what it is.
    """

    title: str
    floor: float = 0.0
    says: str = ""


@dataclass(frozen=True)
class WayPoints:
    """Points of a plot that belong together.

    rows: their rows, in the order of the line through them.
    label: of a row; "" for none.
    zero: where values below the floor are drawn, as a part of it.
    """

    name: str
    rows: Sequence[Row]
    y: Value
    x: Value
    color: str
    shape: str = "circle"
    hollow: bool = False
    line: bool = True
    dash: str = ""
    label: Callable[[Row], str] = lambda row: ""
    spread: tuple[Value, Value] | None = None
    zero: float = 1.0


def panel(x: PlotAxis, y: PlotAxis, ways: Sequence[WayPoints]) -> svg.Panel:
    """Return a plot by factors along both axes, with the default marked by a star."""
    series = [_series(each, y.floor) for each in ways if len(each.rows)]
    defaults = [
        (each.x(row), _height(each, row, y.floor))
        for each in ways
        for row in each.rows
        if row["default"] and not (each.hollow or each.dash)
    ]
    if defaults:
        series.append(
            svg.Series(
                "default", np.array(defaults), "#000000", shape="star", hollow=True, line=False
            )
        )
    points = np.concatenate([row.values for row in series])
    low, high = points.min(axis=0), points.max(axis=0)
    across = svg.across(x.title, float(low[0]) / 1.4, float(high[0]) * 1.8, log=True)
    least = min(float(low[1]), y.floor or float(low[1])) / 2
    up = svg.up(y.title, max(float(high[1]), 10 * y.floor) * 2, least, log=True, height=HEIGHT)
    marks = [svg.level(across, up, y.floor, y.says)] if y.floor else []
    marks.append(svg.curves(across, up, [row for row in series if row.line]))
    taken: list[tuple[float, float]] = []
    for row in series:
        says = [f"{row.name}: {a:.3g}, {b:.3g}" for a, b in row.values]
        marks += [
            svg.bars(across, up, row),
            svg.mark(across, up, row, row.shape, says),
            svg.labels(across, up, row, taken),
        ]
    return svg.Panel(svg.plot(y.title, across, up, "\n".join(marks)), HEIGHT, series)


def _height(ways: WayPoints, row: Row, floor: float) -> float:
    return ways.y(row) if ways.y(row) > floor else floor * ways.zero


def _series(ways: WayPoints, floor: float) -> svg.Series:
    points = np.array([(ways.x(row), _height(ways, row, floor)) for row in ways.rows])
    spread = None
    if ways.spread is not None:
        spread = np.array([[end(row) for end in ways.spread] for row in ways.rows])
    return svg.Series(
        ways.name,
        points,
        ways.color,
        dash=ways.dash,
        line=ways.line and len(points) > 1,
        shape=ways.shape,
        hollow=ways.hollow,
        spread=spread,
        labels=[ways.label(row) for row in ways.rows],
    )


def write_page(folder: Path, title: str, caption: str, sections: Sequence[Section]) -> list[str]:
    """Write report.html, and of each section with rows a CSV and an SVG; return their names.

    caption: the machine, and how it was measured.
    """
    files = {"report.html": _page(title, caption, sections)}
    for section in sections:
        if section.rows:
            files[f"{section.name}.csv"] = f"# {caption}\n{to_csv(list(section.rows))}"
        if section.panels:
            files[f"{section.name}.svg"] = _sheet(section, caption)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return sorted(files)


def _sheet(section: Section, caption: str) -> str:
    return svg.sheet(section.title, caption, section.panels)


def _page(title: str, caption: str, sections: Sequence[Section]) -> str:
    parts = [
        f"<h1>{escape(title)}: error against run time</h1>",
        f"<p>{escape(caption)}</p>",
    ]
    for section in sections:
        parts += [
            f"<h2>{escape(section.title)}</h2>",
            f'<p class="verdict">{escape(section.verdict)}</p>',
            f"<p>{escape(section.means)}</p>" if section.means else "",
        ]
        if section.panels:
            parts.append(f'<div class="scroll">{_sheet(section, caption)}</div>')
        if section.rows:
            head = [name.replace("_", " ") for name in section.rows[0]]
            parts.append(
                table_of(head, [[_cell(value) for value in row.values()] for row in section.rows])
            )
    return document(f"{escape(title)}: error against run time", STYLE, parts)


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return "-" if np.isnan(value) else f"{value:.3g}"
    return "-" if value is None else escape(str(value))
