"""What the rows of error against run time show: plots, what their errors mean, and verdicts."""

from collections.abc import Sequence

from ..format import counted
from ..validation.behavior_errors import APART, LISTING, Sensitivity
from ..validation.culling_errors import FRAMES, RADAR
from .accuracy_page import Plot, PlotAxis, Row, Section

SAMPLED = 0.7  # pixels that an outline is known to, at two samples a pixel
ROUNDED = 1e-6  # meters below which errors are drawn as rounding
# kinds of ways to render a crowd
NOBODY = "without the crowd"
EVERYONE = "full detail"
TOLERANCE = "by tolerance"

_SECONDS = PlotAxis("cpu_s", "processor seconds of a frame")
_MEMORY = PlotAxis("peak_mb", "peak memory, MB")
_UNKNOWN = "0.7 px: less is not known"
_OUTLINES = PlotAxis("worst_px", "outlines are off by, px", SAMPLED, _UNKNOWN, "p99_px")
_COLORS = PlotAxis(
    "colors_worst", "colors are off by, of 1", 0.01, "0.01: hardly visible", "colors_p99"
)
_PLACES = PlotAxis(
    "worst_m", "meters from the exact place", ROUNDED, "a micrometer: rounding", "p99_m"
)
LOD_PLOTS = (
    Plot("kind", _SECONDS, _OUTLINES, "{way}", ("predicted_s", "predicted_px")),
    Plot("kind", _MEMORY, _OUTLINES, "{way}", ("predicted_mb", "predicted_px")),
    Plot("kind", _SECONDS, _COLORS, "{way}"),
)
BEHAVIOR_PLOTS = (
    Plot(
        "way",
        PlotAxis("cpu_ms", "processor ms for a second of the scene"),
        _PLACES,
        "{steps_a_second}",
    ),
)
CULLING_PLOTS = tuple(
    Plot(
        "way",
        PlotAxis("cpu_ms", "processor ms of a frame"),
        PlotAxis(column, title, 0.1, "none (spread out below)"),
        "",
    )
    for column, title in (
        ("missed", "visible agents that are missed"),
        ("outside", "agents drawn outside the view"),
        ("lods_off", "agents in a wrong LOD"),
    )
)
_TAILS = "A mark is the worst, the line from it leads to the 99th percentile"


def lod_section(rows: Sequence[Row], pictures: str) -> Section:
    """Return the section on LODs.

    rows: of operators/deliver/accuracy/renders.py.
    pictures: what was rendered, in sentences.
    """
    means = (
        "Error: how far outlines of agents lie from those at full detail, in pixels of the scene's "
        "own renders, each way, of agents who do not hide one another; and how far colors of 8 x 8 "
        f"pixels are from full detail's. {_TAILS}; hollow marks are what was predicted. LODs are "
        f"those that the scene has: a tolerance only moves where they begin. {pictures}"
    )
    return Section("lods", "LODs", means, lod_verdict(rows), LOD_PLOTS, rows)


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
    agents = counted(own["measured"], "agent")
    if not own["measured"]:
        return "outlines are not measured, for no agent stands whole and large enough in a picture"
    if own["worst_px"] is None:
        return f"all of the {agents} measured are missing"
    missing = f", {own['missing']} of them missing" * (own["missing"] > 0)
    off = f"{own['worst_px']:.1f} px at most" if own["worst_px"] > SAMPLED else "less than 0.7 px"
    return f"outlines are off by {off} ({agents} measured{missing})"


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


def behavior_section(rows: Sequence[Row], found: Sensitivity) -> Section:
    """Return the section on behavior."""
    means = (
        f"Error: how far agents are in the end from where exact arithmetic sees them, which shares "
        f"no line of the steps ({rows[0]['judged']:,} of {counted(rows[0]['agents'], 'agent')} "
        f"judged). {_TAILS}; numbers are steps a second. Listing 1.1 is the chapter's to the "
        f"letter, without timers."
    )
    verdict = behavior_verdict(rows, found)
    return Section("behavior", "Behavior", means, verdict, BEHAVIOR_PLOTS, rows)


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
    crowds = ", ".join(f"{count:,}" for count in dict.fromkeys(row["agents"] for row in rows))
    means = (
        "Error: agents whose bounding sphere the camera's planes touch and who are not drawn "
        "(missed), those drawn outside the view, and those in a wrong LOD; exact rationals decide. "
        "What frames draw outside the view is for the pixel filter, blur, and the renderer's "
        f"rounding. Lines lead from crowd to crowd: {crowds} agents."
    )
    title = "Culling and LODs of a frame"
    plots = CULLING_PLOTS[: 2 + any(row["lods_off"] for row in rows)]
    return Section("culling", title, means, culling_verdict(rows), plots, rows)


def culling_verdict(rows: Sequence[Row]) -> str:
    """Return what frames take and get wrong in the largest crowd, beside other ways."""
    largest = max(row["agents"] for row in rows)
    of_largest = [row for row in rows if row["agents"] == largest]
    own, every = (next(row for row in of_largest if row["way"] == name) for name in (FRAMES, RADAR))
    missed = "misses nobody" if not own["missed"] else f"misses {own['missed']:,.0f} agents"
    lods = "all LODs exact" if not own["lods_off"] else f"{own['lods_off']:,.0f} LODs off"
    verdict = (
        f"Of {counted(largest, 'agent')} a frame {missed}, draws {own['outside']:,.0f} agents "
        f"outside the view ({own['visible']:,.0f} are visible), {lods}, in {own['cpu_ms']:.2g} ms; "
        f"radar over every agent takes {every['cpu_ms']:.2g} ms."
    )
    by_eye = [row for row in of_largest if row["delta_m"] != ""]
    if by_eye:
        least = min(by_eye, key=lambda row: row["missed"])
        verdict += (
            f" The chapter's Delta, set by eye, misses {least['missed']:,.0f} at best (at "
            f"{least['delta_m']:g} m, drawing {least['outside']:,.0f} outside the view)."
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
    means = "Time of what a frame leaves out, beside that of plain functions that do it."
    return Section("left_out", "Left out", means, verdict, (), rows)
