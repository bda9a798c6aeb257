"""Plots of `crowd-lod report error`, as SVG files that stand for themselves."""

from collections.abc import Callable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from ..validation.error_vs_runtime import LEVEL_OFFSETS
from . import svg_plots as svg

COLORS = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"
SHAPES = "circle", "square", "diamond", "up", "down", "left", "right"
HEIGHT = 420  # of a plot, in pixels
SOLID = ""
DASHED = "6 4"
DOTTED = "2 4"
PER_FRAME = "ms per frame (bars: least to most)"

Row = dict[str, Any]  # of a table of error_vs_runtime
Value = Callable[[Row], float]


def draw_plots(folder: Path, tables: dict[str, list[Row]], caption: str) -> None:
    """Write error_behavior.svg, error_culling.svg and error_levels.svg to `folder`.

    tables: by name, the rows of error_vs_runtime.
    caption: where the times were measured.
    """
    sheets = {
        "behavior": (
            "Behavior: distance from the exact way",
            [_behavior(tables["behavior"]), _drift(tables["drift"])],
        ),
        "culling": (
            "Culling: agents a frame that differ from the exact six planes",
            [
                _culling(tables["culling"], "missed", "missed: visible agents culled"),
                _culling(tables["culling"], "surplus", "surplus: agents kept for nothing"),
            ],
        ),
        "levels": (
            "LOD assignment: difference from exact arithmetic",
            [_distances(tables["levels"]), _ids(tables["levels"])],
        ),
    }
    for name, (title, panels) in sheets.items():
        (folder / f"error_{name}.svg").write_text(
            svg.sheet(title, caption, panels), encoding="utf-8"
        )


def _log_plot(
    x_title: str, y_title: str, rows: Sequence[svg.Series], floor: float = 0.0
) -> svg.Panel:
    """Return the rows over axes by factors. floor: the line at which zeros are drawn; 0 for
    none.
    """
    points = np.concatenate([row.values for row in rows])
    across = np.concatenate(
        [points[:, 0], *[row.spread.ravel() for row in rows if row.spread is not None]]
    )
    least = float(points[:, 1].min())
    most = float(points[:, 1].max())
    if floor:
        least = floor
        most = max(most, 1000 * floor)
    x = svg.across(x_title, float(across.min()) / 1.3, float(across.max()) * 1.3, log=True)
    y = svg.up(y_title, most * 2, least / 2, log=True, height=HEIGHT)
    marks = [svg.level(x, y, floor, "0 (none)")] if floor else []
    marks += [svg.curves(x, y, [row for row in rows if row.line])]
    marks += [svg.bars(x, y, row) for row in rows]
    for row in rows:
        says = [f"{row.name}: {a:.3g}, {b:.3g}" for a, b in row.values]
        marks.append(svg.mark(x, y, row, row.shape, says))
        marks.append(svg.labels(x, y, row))
    return svg.Panel(svg.plot(y_title, x, y, "\n".join(marks)), HEIGHT, rows)


def _timed(
    name: str, rows: Sequence[Row], value: Value, floor: float, color: str, **style: Any
) -> svg.Series:
    """Return value(row) against milliseconds, with their range as bars."""
    points = np.array([(row["ms"], max(value(row), floor)) for row in rows])
    spread = np.array([(row["ms_least"], row["ms_most"]) for row in rows])
    return svg.Series(name, points, color, spread=spread, **style)


def _stars(rows: Sequence[Row], value: Value, floor: float) -> list[svg.Series]:
    points = np.array([(row["ms"], max(value(row), floor)) for row in rows if row["default"]])
    if not len(points):
        return []
    return [svg.Series("default", points, "#000000", shape="star", hollow=True, line=False)]


def _grouped(rows: Sequence[Row], key: Callable[[Row], Any]) -> dict[Any, list[Row]]:
    groups: dict[Any, list[Row]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return groups


def _convergence(rows: Sequence[Row]) -> str:
    """Return in words how a method's error falls with its step."""
    order = rows[0]["order"]
    apart = rows[-1]["apart"]
    order_text = "" if np.isnan(order) else f"order {order:.2f}"
    if apart > 0.001:
        outcome = f"does not converge: {apart:.1%} of agents end over a cell away"
        return ", ".join(filter(None, (order_text, outcome)))
    return order_text or "exact up to rounding"


def _behavior(rows: list[Row]) -> svg.Panel:
    floor = 1e-17
    series = []
    for color, (name, group) in zip(COLORS, groupby(rows, lambda row: row["method"]), strict=False):
        method = list(group)
        if name == "exact walk":
            series.append(
                _timed(f"{name} (in one go)", method, lambda row: row["mean_m"], floor, color)
            )
            continue
        labels = f"{name}, mean ({_convergence(method)})", f"{name}, median", f"{name}, worst"
        for k, (column, dash) in enumerate(
            {"mean_m": SOLID, "median_m": DASHED, "worst_m": DOTTED}.items()
        ):
            value = _column(column)
            series.append(
                _timed(labels[k], method, value, floor, color, dash=dash, shape=SHAPES[k])
            )
    series += _stars(rows, lambda row: row["mean_m"], floor)
    steps = [row["dt_s"] for row in rows if row["dt_s"]]
    y = f"error, m  (dt from {max(steps):.3g} s to {min(steps):.2g} s, left to right)"
    return _log_plot("ms per second of scene (bars: least to most)", y, series, floor)


def _drift(rows: list[Row]) -> svg.Panel:
    series = []
    for k, ((precision, offset), group) in enumerate(
        groupby(rows, lambda row: (row["precision"], row["offset_m"]))
    ):
        run = list(group)
        is_default = precision == "float64"
        label = f"{precision}, {f'{offset / 1000:g} km away' if offset else 'at the origin'}"
        label += " (default)" if is_default else ""
        for statistic, dash in (("worst", SOLID), ("mean", DASHED)):
            points = np.array([(row["steps"], row[f"{statistic}_m"]) for row in run])
            shape = "star" if is_default else SHAPES[k]
            series.append(
                svg.Series(f"{label}, {statistic}", points, COLORS[k], dash=dash, shape=shape)
            )
    return _log_plot("steps of 1/24 s", "drift of summed positions, m", series)


def _culling(rows: list[Row], column: str, title: str) -> svg.Panel:
    floor = _least(rows, column)
    value = _column(column)
    series = []
    kinds = _grouped(
        rows,
        lambda row: (
            row["method"],
            row["precision"] if "no bound" in row["method"] else "",
            row["offset_m"],
        ),
    )
    for k, ((name, precision, offset), kind) in enumerate(kinds.items()):
        label = ", ".join(
            filter(None, (name, precision, f"{offset / 1000:g} km away" if offset else ""))
        )
        is_fixed = name == "fixed Delta"
        deltas = [f"{row['delta_m']:g} m" if is_fixed and row[column] else "" for row in kind]
        style = {"shape": SHAPES[k % 7], "hollow": bool(offset), "line": is_fixed, "labels": deltas}
        series.append(_timed(label, kind, value, floor, COLORS[k % 7], **style))
    series += _stars(rows, value, floor)
    return _log_plot(
        PER_FRAME, f"{title}, per frame of {rows[0]['visible']:,.0f} visible", series, floor
    )


def _distances(rows: list[Row]) -> svg.Panel:
    """Return the worst error of distances against time, by precision."""
    floor = _least(rows, "worst_m")
    value = _column("worst_m")
    series = []
    for row in rows:
        if row["offset_m"] in LEVEL_OFFSETS[:2]:
            away = f", {row['offset_m'] / 1000:g} km away" if row["offset_m"] else ""
            label = f"{row['precision']}{away}"
            style = _level_style(row, rows) | {"hollow": bool(away), "line": False}
            series.append(_timed(label, [row], value, floor, **style))
    series += _stars(rows, value, floor)
    return _log_plot(PER_FRAME, "worst error of the distance, m", series, floor)


def _ids(rows: list[Row]) -> svg.Panel:
    """Return the LOD ids that differ against the crowd's distance from the origin."""
    floor = 0.2e6 / rows[0]["of"]
    series = []
    kinds = _grouped(rows, lambda row: (row["precision"],))
    for k, (names, kind) in enumerate(kinds.items()):
        beside = 1.06**k  # kinds that agree stand side by side
        points = [
            (max(row["offset_m"], LEVEL_OFFSETS[1] / 100) * beside, max(row["differ_ppm"], floor))
            for row in kind
        ]
        series.append(svg.Series(", ".join(names), np.array(points), **_level_style(kind[0], rows)))
    x_title = "crowd's distance from the world's origin, m (left: at the origin)"
    return _log_plot(
        x_title, f"LOD ids that differ, of a million ({rows[0]['of']:,} looked at)", series, floor
    )


def _level_style(row: Row, rows: Sequence[Row]) -> dict[str, Any]:
    precisions = list(dict.fromkeys(other["precision"] for other in rows))
    return {"color": COLORS[precisions.index(row["precision"])]}


def _least(rows: Sequence[Row], what: str) -> float:
    """Return a place for zeros below the least value above 0."""
    return min((row[what] for row in rows if row[what]), default=1.0) / 5


def _column(name: str) -> Value:
    return lambda row: row[name]
