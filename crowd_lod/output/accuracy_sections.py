"""What the rows of error against run time show: plots, what their errors mean, and verdicts."""

from collections.abc import Callable, Sequence
from functools import partial
from operator import itemgetter
from typing import Any

from ..format import counted
from ..validation.behavior_errors import APART, LISTING, Sensitivity
from ..validation.culling_errors import BY_EYE, FRAMES, RADAR
from . import svg_plots as svg
from .accuracy_page import COLORS, DASHED, SHAPES, PlotAxis, Row, Section, WayPoints, panel

SAMPLED = 0.7  # pixels that an outline is known to, at two samples a pixel
ROUNDED = 1e-6  # meters below which errors are drawn as rounding
FEW_COLORS = 0.01  # of 1
# kinds of ways to render a crowd
NOBODY = "without the crowd"
EVERYONE = "full detail"
TOLERANCE = "by tolerance"
# columns of an error: the worst, and the 99th percentile
OUTLINES = "worst_px", "p99_px"
COLOR_ERRORS = "colors_worst", "colors_p99"


def _of(name: str) -> Callable[[Row], Any]:
    return itemgetter(name)


def lod_section(rows: Sequence[Row], pictures: str) -> Section:
    """Return the section on LODs.

    rows: of operators/deliver/accuracy/lod_rows.py.
    pictures: what was rendered, in sentences.
    """
    seconds = PlotAxis("processor seconds of a frame")
    memory = PlotAxis("peak memory, MB")
    outlines = PlotAxis("outlines are off by, px", SAMPLED, "0.7 px: less cannot be measured")
    colors = PlotAxis("colors are off by, of 1", FEW_COLORS, "0.01: hardly visible")
    plots = [
        (seconds, outlines, _lod_ways(rows, "cpu_s", OUTLINES, "predicted_s")),
        (memory, outlines, _lod_ways(rows, "peak_mb", OUTLINES, "predicted_mb")),
        (seconds, colors, _lod_ways(rows, "cpu_s", COLOR_ERRORS)),
    ]
    panels = [panel(x, y, ways) for x, y, ways in plots if any(each.rows for each in ways)]
    means = (
        "Error: how far outlines of agents lie from those at full detail, in pixels of the scene's "
        "own renders, each way, of agents who do not hide one another; and how far colors of 8 x 8 "
        "pixels are from full detail's. Hollow marks are what was predicted. LODs are those that "
        f"the scene has: a tolerance only moves where they begin. {pictures}"
    )
    return Section("lods", "LODs", means, lod_verdict(rows), panels, rows)


def _lod_ways(
    rows: Sequence[Row], cost: str, error: tuple[str, str], predicted: str = ""
) -> list[WayPoints]:
    """Return the points of a plot: by tolerance, a line; of other ways, a mark each.

    cost, error: columns. predicted: that of the cost which was predicted, "" for none.
    """
    worst, p99 = error
    rows = [row for row in rows if row[worst] is not None and row[cost] is not None]
    tolerant = [row for row in rows if row["kind"] == TOLERANCE]
    foretold = [row for row in tolerant if predicted and row[predicted] is not None]
    spread = (_of("cpu_s_least"), _of("cpu_s_most")) if cost == "cpu_s" else None
    marks = partial(WayPoints, label=_of("way"), spread=spread)
    ways = [
        marks("LODs by tolerance, worst", tolerant, _of(worst), _of(cost), COLORS[0]),
        WayPoints(
            "99th percentile", tolerant, _of(p99), _of(cost), COLORS[5], "square", dash=DASHED
        ),
        WayPoints(
            "predicted, worst",
            foretold,
            _of("predicted_px"),
            _of(predicted),
            COLORS[0],
            hollow=True,
            line=False,
        ),
    ]
    others = [row for row in rows if row["kind"] != TOLERANCE]
    for row, color, shape in zip(others, COLORS[1:5] + COLORS[6:], SHAPES[2:] * 2, strict=False):
        ways.append(marks(row["way"], [row], _of(worst), _of(cost), color, shape))
    return ways


def lod_verdict(rows: Sequence[Row]) -> str:
    """Return what the scene's own LODs gain and cost, and what other tolerances would."""
    bare, full = (next(row for row in rows if row["kind"] == kind) for kind in (NOBODY, EVERYONE))
    own = next(row for row in rows if row["default"])
    time = own["cpu_s"] / full["cpu_s"]
    lead = f"At {own['way']}" if own["tolerance_px"] else f"With LODs {own['way']},"
    verdict = f"{lead} a frame takes {time:.2f} of full detail's time"
    if full["crowd_mb"]:
        verdict += f", and the crowd {own['crowd_mb'] / full['crowd_mb']:.2f} of its memory"
    verdict += f"; {_outlines(own)}"
    if own["colors_worst"] is not None:
        verdict += f", colors are off by {own['colors_worst']:.2f} of 1"
    verdict += "."
    if own["cpu_s"] - bare["cpu_s"] < 0.5 * own["cpu_s"]:
        verdict += f" The empty scene alone takes {bare['cpu_s'] / full['cpu_s']:.2f} of it."
    if own["runs"] == 1:
        verdict += " Times are of one run, and tell large differences alone."
    return " ".join([verdict, *_neighbors(rows, own)])


def _outlines(own: Row) -> str:
    """Return how far the outlines of a way are off, in words."""
    if not own["measured"]:
        return "outlines are not measured, for no agent stands whole and large enough in a picture"
    if own["worst_px"] is None:
        return f"all of the {counted(own['measured'], 'agent')} measured are missing"
    measured = f"{counted(own['measured'], 'agent')} measured"
    if own["missing"]:
        measured += f", {own['missing']} of them missing"
    return f"outlines are off by {_pixels(own['worst_px'])} ({measured})"


def _neighbors(rows: Sequence[Row], own: Row) -> list[str]:
    """Return a sentence on the next finer and the next coarser tolerance."""
    if own["kind"] != TOLERANCE:
        return []
    tolerant = [row for row in rows if row["kind"] == TOLERANCE]
    place = tolerant.index(own)
    sentences = []
    for row in (*tolerant[place + 1 : place + 2], *tolerant[max(place - 1, 0) : place]):
        percent = 100 * (row["cpu_s"] / own["cpu_s"] - 1)
        if row["triangles"] == own["triangles"]:
            sentences.append(f"A tolerance of {row['way']} shows the same LODs in these frames.")
        elif not _differ(row, own):
            sentences.append(f"{row['way']}: no difference in time beyond that between runs.")
        elif percent < 0:
            sentences.append(f"{row['way']} would save {-percent:.0f} % more.")
        else:
            sentences.append(f"{row['way']} would cost {percent:.0f} % more.")
    return sentences


def _differ(row: Row, other: Row) -> bool:
    """Return whether no run of one took as long as one of the other, of several runs."""
    several = min(row["runs"], other["runs"]) > 1
    apart = row["cpu_s_most"] < other["cpu_s_least"] or other["cpu_s_most"] < row["cpu_s_least"]
    return bool(several and apart)


def _pixels(error: float) -> str:
    return f"{error:.1f} px at most" if error > SAMPLED else f"less than {SAMPLED} px"


def behavior_section(rows: Sequence[Row], found: Sensitivity) -> Section:
    """Return the section on behavior."""
    ways = []
    names = list(dict.fromkeys(row["way"] for row in rows))
    for number, name in enumerate(names):
        own = [row for row in rows if row["way"] == name]
        marks = partial(
            WayPoints, rows=own, x=_of("cpu_ms"), color=COLORS[number], shape=SHAPES[number]
        )
        steps = _steps if len(own) > 1 else (lambda row: "")
        ways += [
            marks(f"{name}, worst agent", y=_of("worst_m"), label=steps),
            marks(f"{name}, 99th percentile", y=_of("p99_m"), hollow=True, dash=DASHED),
        ]
    x = PlotAxis("processor ms for a second of the scene")
    y = PlotAxis("meters from the exact place", ROUNDED, "a micrometer: rounding")
    means = (
        f"Error: how far agents are in the end from where exact arithmetic sees them, which shares "
        f"no line of the steps ({rows[0]['judged']:,} of {counted(rows[0]['agents'], 'agent')} "
        f"judged). Listing 1.1 is the chapter's to the letter, without timers. Labels: steps a "
        f"second."
    )
    return Section(
        "behavior", "Behavior", means, behavior_verdict(rows, found), [panel(x, y, ways)], rows
    )


def _steps(row: Row) -> str:
    return f"{row['steps_a_second']}"


def behavior_verdict(rows: Sequence[Row], found: Sensitivity) -> str:
    """Return how exact the agents' ways are, and until when places mean something."""
    own = next(row for row in rows if row["default"])
    same = [row for row in rows if row["way"] == LISTING]
    listing = min(same, key=lambda row: abs(row["steps_a_second"] - own["steps_a_second"]))
    verdict = (
        f"Frames move {counted(own['agents'], 'agent')} in {own['cpu_ms']:.0f} ms for a second of "
        f"the scene, and end within {_meters(own['worst_m'])} of the exact places"
    )
    if own["apart"]:
        verdict += (
            f"; {own['apart']:.1%} of the agents are more than a centimeter off: where they turn "
            f"follows from when a step ends, not from the table alone"
        )
    verdict += (
        f". Listing 1.1 takes {listing['cpu_ms']:.0f} ms and ends within "
        f"{_meters(listing['worst_m'])} of them. "
    )
    if found.until is None:
        return verdict + (
            f"Starts that are moved by {found.shift:.0e} m end {found.farthest:.0e} m apart: the "
            f"table does not amplify rounding."
        )
    return verdict + (
        f"The table amplifies rounding: starts that are moved by {found.shift:.0e} m end up to "
        f"{_meters(found.farthest)} apart ({found.apart} of {counted(found.judged, 'agent')} by "
        f"more than {APART} m), so the places of these mean something for the first "
        f"{counted(found.until, 'frame')}."
    )


def _meters(length: float) -> str:
    return "a micrometer" if length < ROUNDED else f"{length:.2g} m"


def culling_section(rows: Sequence[Row]) -> Section:
    """Return the section on culling and LODs of a frame."""
    x = PlotAxis("processor ms of a frame")
    panels = []
    for column, says in (
        ("missed", "visible agents that are missed, of 1,000 visible"),
        ("in_vain", "agents kept in vain, of 1,000 visible"),
    ):
        y = PlotAxis(says, 0.01, "none (spread out below)")
        panels.append(panel(x, y, _culling_ways(rows, _of_thousand(column))))
    means = (
        "Error: agents whose bounding sphere the camera's planes touch and who were left out "
        "(missed), or the other way round (kept in vain), and LODs off by one or more; exact "
        "rationals decide. What frames keep in vain is for the pixel filter, blur, and the "
        "renderer's rounding. Lines lead from crowd to crowd."
    )
    return Section(
        "culling", "Culling and LODs of a frame", means, culling_verdict(rows), panels, rows
    )


def _culling_ways(rows: Sequence[Row], value: Callable[[Row], float]) -> list[WayPoints]:
    """Return the points of a plot, a line for each way; those without any error lie apart."""
    ways = []
    names = dict.fromkeys((row["way"], row["delta_m"]) for row in rows)
    for number, (name, delta) in enumerate(names):
        ways.append(
            WayPoints(
                name if delta == "" else f"{name}, {delta:g} m",
                [row for row in rows if (row["way"], row["delta_m"]) == (name, delta)],
                value,
                _of("cpu_ms"),
                COLORS[number % len(COLORS)],
                SHAPES[number % len(SHAPES)],
                label=_crowd if number == 0 else (lambda row: ""),
                zero=0.85**number,
            )
        )
    return ways


def _of_thousand(column: str) -> Callable[[Row], float]:
    return lambda row: 1000 * row[column] / max(row["visible"], 1)


def _crowd(row: Row) -> str:
    return svg.short(row["agents"])


def culling_verdict(rows: Sequence[Row]) -> str:
    """Return what frames take and get wrong in the largest crowd, beside other ways."""
    largest = max(row["agents"] for row in rows)
    of_largest = [row for row in rows if row["agents"] == largest]
    own = next(row for row in of_largest if row["way"] == FRAMES)
    every = next(row for row in of_largest if row["way"] == RADAR)
    missed = "misses nobody" if not own["missed"] else f"misses {own['missed']:,.0f} agents"
    lods = "all LODs exact" if not own["lods_off"] else f"{own['lods_off']:,.0f} LODs off"
    verdict = (
        f"Of {counted(largest, 'agent')} a frame {missed}, keeps {own['in_vain']:,.0f} in vain "
        f"({own['visible']:,.0f} are visible), {lods}, in {own['cpu_ms']:.2g} ms; radar over every "
        f"agent takes {every['cpu_ms']:.2g} ms."
    )
    by_eye = [row for row in of_largest if row["way"] == BY_EYE]
    if by_eye:
        least = min(by_eye, key=lambda row: row["missed"])
        verdict += (
            f" The chapter's Delta, set by eye, misses {least['missed']:,.0f} at best (at "
            f"{least['delta_m']:g} m, keeping {least['in_vain']:,.0f} in vain)."
        )
    return verdict


def left_out_section(rows: Sequence[Row]) -> Section:
    """Return the section on what the scene does not need: what leaving it out saves."""
    sentences = [
        f"{row['part']}: {row['with_ms']:.2g} ms a frame in place of {row['without_ms']:.2g} ms"
        + ("." if row["steady"] else " (times that are not steady).")
        for row in rows
    ]
    verdict = " ".join(sentences) or "This scene needs every step of a frame: nothing is skipped."
    return Section("left_out", "Left out", "", verdict, (), rows)
