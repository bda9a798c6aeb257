"""The report of a shot plan as a web page: one file without scripts, with its plots inside."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from ..format import number
from ..shot.curve import WIDTH as HELD
from ..shot.curve import Curve
from ..shot.needed_meshes import unneeded
from ..shot.survey import CULLED, MIRRORED, SEEN, SHADOW
from ..shot.switches import NOTHING, WORST, largest
from . import svg_plots as svg
from .html_report import STYLE, cards, document, list_of, name_of, parts_of, table_of
from .shot_report import ShotReport, figures_of, lead_of, warnings_of

STRIP = 1180, 90  # pixels of the strip over the timeline
PLOTS_STYLE = """
:root { --plan: #2a6fdb; --old: #d55e00; --entry: #a0348f; --held: #12805c;
  --hidden: #8a8f2a; --faint: #c3c9d2; --grid: #e6e9ee }
@media (prefers-color-scheme: dark) {
  :root { --plan: #7fb0ff; --old: #ff9a4d; --entry: #e58bd6; --held: #5fd3a8;
    --hidden: #c9cc5a; --faint: #454c58; --grid: #2b2f37 } }
.plots { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(32rem, 100%), 1fr));
  gap: 1rem; margin: 1rem 0 }
.plots section { margin: 0 } section h3 { margin-bottom: .2rem } section > p { font-size: .88rem }
svg { width: 100%; height: auto; display: block; overflow: visible }
svg text { font: 11px system-ui, sans-serif; fill: var(--dim) }
.grid { stroke: var(--grid); fill: none } .axis { stroke: var(--dim); fill: none }
.line { fill: none; stroke-width: 1.8; stroke-linejoin: round }
.mark { stroke: var(--card); stroke-width: 1 } .legend { font-size: .85rem; margin: .3rem 0 0 }
.legend span { margin-right: 1.1em; white-space: nowrap }
.legend i { display: inline-block; width: .7em; height: .7em; border-radius: 50%;
  margin-right: .4em; print-color-adjust: exact }
.tick:hover path, .tick:focus path { stroke: var(--ink) } .tick path { stroke-width: var(--wide) }
td span { scroll-margin-top: 5rem }
tr:has(:target) td { background: var(--grid); font-weight: 600 } details { margin: .8rem 0 }
summary { cursor: pointer; font-weight: 600 }
@page { margin: 12mm } @media print { body { padding: 0; max-width: none; font-size: 13px }
svg text { font-size: 14px } h2 { break-after: avoid }
section, .figures div { break-inside: avoid } .plots { grid-template-columns: 1fr 1fr } }
"""


def timeline(report: ShotReport) -> str:
    """Return the HTML of a timeline whose ticks are frames with switches or entries.

    A tick is as high as the largest change of its frame, in pixels.
    """
    numbers = report.numbers
    switches = report.noticed
    (wide, high) = STRIP
    at = svg.edges(numbers)
    most = switches["change"].max(initial=0.0)
    x = svg.across("Frame", at[0], at[-1], width=wide)
    y = svg.up("Pixels", most, height=high + svg.TOP + svg.BOTTOM)
    ticks = []
    for frame in np.unique(switches["frame"]).tolist():
        rows = switches[switches["frame"] == frame]
        place = float(x.place(frame))
        largest = rows["change"].max()
        color = "var(--entry)" if (rows["before"] == NOTHING).any() else "var(--plan)"
        says = f"Frame {frame}: {len(rows):,} of {number(float(largest))} pixels at most"
        ticks.append(
            f'<a class="tick" href="#f{frame}"><title>{says}</title>'
            f'<path stroke="{color}" '
            f'd="M{place:.1f},{y.begin:g}V{min(float(y.place(largest)), y.begin - 3):.1f}"/></a>'
        )
    column = (x.end - x.begin) / len(numbers)
    marks = f'<g style="--wide:{max(min(0.7 * column, 8), 1.5):.1f}">' + "\n".join(ticks) + "</g>"
    text = (
        "Each tick is a frame with visible LOD switches, as high as the largest pop. "
        "Click it to see its rows in the table."
    )
    colors = [
        svg.Series(name, at, f"var(--{key})")
        for name, key in (("switches", "plan"), ("an agent appears at once", "entry"))
    ]
    legend = _legend(colors if report.entries.any() else colors[:1])
    return (
        f"<h2>Switches in "
        f"sight</h2><section><p>{text}</p>{svg.plot(text, x, y, marks)}{legend}</section>"
    )


def plots_of(report: ShotReport) -> list[str]:
    """Return the HTML of each plot, with its heading."""
    shot = report.shot
    bill = report.plan.bill
    before = report.plan.thresholds
    survey = shot.survey
    meshes = shot.meshes
    at = svg.edges(report.numbers)
    lods = list(enumerate(report.colors[: meshes.count]))
    triangles = (bill.agents_shown * meshes.triangles.T[:, survey.owner]).sum(axis=2)
    counts = [survey.count(kind) for kind in (SEEN, SHADOW, MIRRORED)]
    counts += [survey.hidden, survey.count(CULLED) - survey.hidden]
    kinds = [count / max(len(survey.group), 1) * 100 for count in counts]
    names = ("seen", "shadow or sky only", "mirror image only", "occluded", "culled")
    shares = [
        svg.Series(*row)
        for row in zip(
            names,
            kinds,
            ("var(--plan)", "var(--old)", "var(--entry)", "var(--hidden)", "var(--faint)"),
            strict=True,
        )
    ]
    nonzero_shares = [row for row in shares if row.values.any()]
    switches = [
        svg.Series("thresholds", before.switches, "var(--old)"),
        svg.Series("plan", bill.switches, "var(--plan)"),
    ]
    if report.entries.any():
        switches.append(
            svg.Series("agents that appear or vanish at once", report.entries, "var(--entry)")
        )
    return [
        _areas(
            at,
            "LODs of seen agents",
            "Agents",
            [svg.Series(f"LOD {k}", bill.counts[:, k], tint) for k, tint in lods],
        ),
        _areas(
            at,
            "Triangles by LOD",
            "Triangles",
            [svg.Series(f"LOD {k}", triangles[:, k], tint) for k, tint in lods],
        ),
        _areas(at, "Seen and culled", "% of agents", nonzero_shares, 100.0),
        _lines(at, "Switches in sight per frame", "Agents", switches),
        _error_plot(report.curve, len(survey.group)),
        "" if report.raised else _avoid_plot(report.curve),  # its plans would be over the budget
        _stage_plot(report.milliseconds),
    ]


def _areas(
    at: np.ndarray, title: str, unit: str, rows: Sequence[svg.Series], most: float | None = None
) -> str:
    highest = most or float(np.sum([row.values for row in rows], axis=0).max(initial=0.0))
    x = svg.across("Frame", at[0], at[-1])
    y = svg.up(unit, highest)
    return f"<h3>{title}</h3>{svg.plot(title, x, y, svg.stacked(x, y, at, rows))}{_legend(rows)}"


def _lines(at: np.ndarray, title: str, unit: str, rows: Sequence[svg.Series]) -> str:
    x = svg.across("Frame", at[0], at[-1])
    y = svg.up(unit, max(float(row.values.max(initial=0)) for row in rows))
    return f"<h3>{title}</h3>{svg.plot(title, x, y, svg.steps(x, y, at, rows))}{_legend(rows)}"


def _error_plot(curve: Curve, agents: int) -> str:
    sweep = [point for point in curve.points if point.kind == "tolerance"]
    points = [
        point
        for point in reversed(curve.points)
        if point.kind in ("plan", "thresholds", "hysteresis")
    ]
    errors = [point.error for point in (*sweep, *points) if point.error > 0]
    if not errors:
        return ""  # a single LOD
    costs = ("triangles", "var(--plan)"), ("memory", "var(--held)"), ("seconds", "var(--dim)")
    most = max(
        100.0, *(100 * getattr(point, key) for point in (*sweep, *points) for key, _ in costs)
    )
    x = svg.across("Largest deviation, pixels", min(errors), max(errors), log=True)
    y = svg.up("% of full detail", most)
    rows = [
        svg.Series(
            key,
            np.array(
                [(point.error, 100 * getattr(point, key)) for point in sweep if point.error > 0]
            ),
            color,
        )
        for key, color in costs
    ]
    marks = [svg.curves(x, y, [row for row in rows if len(row.values)])]
    shapes = {"plan": "circle", "thresholds": "square", "hysteresis": "diamond"}
    for key, color in costs:
        for point in points:
            if point.error > 0:
                part = 100 * getattr(point, key)
                says = (
                    f"{point.kind}: {part:.1f}% of the {key}, {number(point.error)} pixels, "
                    f"{point.switches:,} switches"
                )
                marks.append(
                    svg.mark(
                        x,
                        y,
                        svg.Series(point.kind, np.array([[point.error, part]]), color),
                        shapes[point.kind],
                        [says],
                    )
                )
    hysteresis = f", diamonds hysteresis that holds a LOD for {HELD:.0%} of its distance" * any(
        p.kind == "hysteresis" for p in points
    )
    text = (
        f"Lines: other tolerances, frame by frame. Marks: circles the plan, squares "
        f"thresholds{hysteresis}."
    )
    if curve.agents < agents:
        text += f" From {curve.agents:,} of the agents."
    plot = svg.plot("Error against cost", x, y, "".join(marks))
    return f"<h3>Error against cost</h3><p>{text}</p>{plot}{_legend(rows)}"


def _avoid_plot(curve: Curve) -> str:
    points = sorted(
        (max(p.above, 0.0) * 100, p.switches)
        for p in curve.points
        if p.kind in ("pop_reduction", "plan")
    )
    marked_points = [p for p in reversed(curve.points) if p.kind in ("plan", "thresholds")]
    most = max(
        p.switches for p in curve.points if p.kind in ("pop_reduction", "plan", "thresholds")
    )
    if not most:
        return ""
    x = svg.across("Cost above that of thresholds, %", 0.0, max(above for above, _ in points))
    y = svg.up("Switches in sight", most)
    marks = svg.curves(
        x,
        y,
        [svg.Series("plans with more or less weight of pops", np.array(points), "var(--plan)")],
    )
    colors = {"plan": "var(--plan)", "thresholds": "var(--old)"}
    for p in marked_points:
        row = svg.Series(p.kind, np.array([[max(p.above, 0.0) * 100, p.switches]]), colors[p.kind])
        marks += svg.mark(
            x,
            y,
            row,
            "circle",
            [f"{p.kind}: {p.switches:,} switches, {max(p.above, 0.0):.1%} more cost"],
        )
    text = "What other values of Pop Reduction would cost. The blue mark is this plan."
    legend = _legend([svg.Series(kind, np.empty(0), color) for kind, color in colors.items()])
    return (
        f"<h3>Switches against "
        f"cost</h3><p>{text}</p>{svg.plot('Switches against cost', x, y, marks)}{legend}"
    )


def _stage_plot(milliseconds: Mapping[str, float]) -> str:
    """Return bars of the mean milliseconds of a frame's stages."""
    if not milliseconds:
        return ""
    height = 26 * len(milliseconds) + svg.TOP + svg.BOTTOM
    x = svg.across("ms per frame", 0.0, max(milliseconds.values()) * 1.12 or 1.0)
    y = svg.Scale("", 0.0, 0.0, height - svg.BOTTOM, svg.TOP)
    x = svg.Scale(x.title, 0.0, x.high, 110.0, x.end)
    bars = []
    for k, (name, ms) in enumerate(milliseconds.items()):
        top = svg.TOP + 26 * k + 4
        end = float(x.place(ms))
        bars.append(
            f'<rect x="{x.begin:g}" y="{top}" width="{max(end - x.begin, 0.5):.1f}" height="18" '
            f'fill="var(--plan)"/>'
        )
        bars.append(
            f'<text x="{x.begin - 7:g}" y="{top + 13}" text-anchor="end">{escape(name)}</text>'
        )
        bars.append(f'<text x="{end + 5:.1f}" y="{top + 13}">{number(ms)}</text>')
    text = "Means of the survey's frames; time to decide comes on top."
    return (
        f"<h3>Milliseconds by "
        f"stage</h3><p>{text}</p>{svg.plot('Milliseconds by stage', x, y, ''.join(bars))}"
    )


def _legend(rows: Sequence[svg.Series]) -> str:
    dots = "".join(
        f'<span><i style="background:{row.color}"></i>{escape(row.name)}</span>' for row in rows
    )
    return f'<p class="legend">{dots}</p>'


OF_A_FRAME = 3  # switches of each frame in the table
HEAD = ("Frame", "Agent", "From", "To", "Size, px", "Change, px")


def shot_page(report: ShotReport) -> str:
    """Return the web page on a planned shot; all text is escaped."""
    return document(
        f"{escape(report.title)}: shot plan",
        STYLE + PLOTS_STYLE,
        shot_parts(report),
    )


def preview_page(report: ShotReport, plan: dict[str, Any]) -> str:
    """Return the web page of a preview that was planned first: the plan, then the pictures.

    plan: the content of plan.json.
    """
    return document(
        f"{name_of(plan)}: levels of detail",
        STYLE + PLOTS_STYLE,
        [*shot_parts(report), *parts_of(plan)],
    )


def shot_parts(report: ShotReport) -> list[str]:
    """Return the parts of the page on a planned shot, as HTML."""
    title = escape(report.title)
    return [
        f"<h1>{title}: shot plan</h1>",
        f'<p class="verdict">{escape(report.verdict.sentence)}</p>',
        f"<p>{escape(lead_of(report))}</p>",
        cards(figures_of(report)),
        list_of("Warnings", warnings_of(report)),
        timeline(report),
        '<div class="plots">',
        *(f"<section>{plot}</section>" for plot in plots_of(report) if plot),
        "</div>",
        _worst(report),
        list_of(
            "What the shot does not need",
            [
                *unneeded(report.shot, report.plan.bill.agents_shown, report.names),
                *(item.reason for item in report.left_out),
            ],
        ),
        "<h2>Tables</h2>",
        _switch_table(report),
        _frame_table(report),
        _curve_table(report),
        "<footer>switches.csv has every switch, entry and exit, frames.csv a row of each frame, "
        "plan.json the figures, plan.npz the LODs.</footer>",
    ]


def _worst(report: ShotReport) -> str:
    rows = [_cells(row) for row in largest(report.noticed, WORST)]
    return f"<h2>The largest changes</h2>{table_of(HEAD, rows)}" if rows else ""


def _switch_table(report: ShotReport) -> str:
    switches = report.noticed
    if not len(switches):
        return "<p>No visible LOD switches.</p>"
    rows = []
    begins = np.flatnonzero(np.diff(switches["frame"], prepend=switches["frame"][0] - 1))
    for frame_rows in np.split(switches, begins[1:]):
        for place, row in enumerate(largest(frame_rows, OF_A_FRAME)):
            cells = _cells(row)
            if not place:
                cells[0] = f'<span id="f{row["frame"]}">{row["frame"]}</span>'
            rows.append([*cells, f"{len(frame_rows):,}" if not place else ""])
    return _folded(
        f"Switches, entries and exits: the {OF_A_FRAME} largest of each frame",
        table_of([*HEAD, "In the frame"], rows),
    )


def _frame_table(report: ShotReport) -> str:
    bill = report.plan.bill
    before = report.plan.thresholds
    survey = report.shot.survey
    head = ["Frame", "Seen", "Culled", *(f"LOD {k}" for k in range(report.shot.meshes.count))]
    head += [
        "Triangles",
        "Switches",
        "Change, px",
        "Enter or vanish at once",
        "Switches by thresholds",
    ]
    columns = [
        report.numbers,
        survey.count(SEEN),
        survey.count(CULLED),
        *bill.counts.T,
    ]
    columns += [
        bill.triangles.astype(np.int64),
        bill.switches,
        bill.pixels,
        report.entries,
        before.switches,
    ]
    rows = [
        [number(v) if isinstance(v, float) else f"{v:,}" for v in row]
        for row in zip(*(c.tolist() for c in columns), strict=True)
    ]
    return _folded("Frames", table_of(head, rows))


def _curve_table(report: ShotReport) -> str:
    head = [
        "LODs by",
        "Tolerance, px",
        "Largest deviation, px",
        "Triangles, %",
        "Time, %",
        "Memory, %",
        "Above thresholds, %",
        "Switches",
    ]
    rows = [
        [
            escape(p.kind),
            number(p.tolerance),
            number(p.error),
            *(number(100 * part) for part in (p.triangles, p.seconds, p.memory, p.above)),
            f"{p.switches:,}",
        ]
        for p in report.curve.points
    ]
    return _folded(f"Error against cost, from {report.curve.agents:,} agents", table_of(head, rows))


def _cells(row: np.void) -> list[str]:
    lods = (
        "not in sight" if level == NOTHING else f"LOD {level}"
        for level in (row["before"], row["after"])
    )
    sizes = (number(float(row[name])) for name in ("size", "change"))
    return [f"{row['frame']}", f"{row['agent']}", *lods, *sizes]


def _folded(title: str, inside: str) -> str:
    return f"<details><summary>{escape(title)}</summary>{inside}</details>"
