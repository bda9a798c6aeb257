"""The report of a shot plan as a web page: one file without scripts, with its plots inside."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from math import isfinite
from typing import Any

import numpy as np

from ..format import counted, number
from ..levels.cost_model import NAMES
from ..shot.budget import BudgetPlan
from ..shot.coloring import PhasePlan
from ..shot.curve import WIDTH as HELD
from ..shot.curve import Curve, of_full_detail
from ..shot.shot import ShotPlan
from ..shot.shot_cost import Shot
from ..shot.survey import CULLED, MIRRORED, SEEN, SHADOW
from ..shot.switches import NOTHING, WORST, largest
from ..shot.unneeded import unneeded
from . import svg_plots as svg
from . import switch_figures
from .html_report import STYLE, cards, css_of, document, list_of, name_of, parts_of, table_of

OF_A_FRAME = 3  # switches that the table tells of each frame
STRIP = 1180, 90  # pixels of the strip over the timeline
PLOTS_STYLE = """
:root { --plan: #2a6fdb; --old: #d55e00; --entry: #a0348f; --held: #12805c; --faint: #c3c9d2; --grid: #e6e9ee }
@media (prefers-color-scheme: dark) {
  :root { --plan: #7fb0ff; --old: #ff9a4d; --entry: #e58bd6; --held: #5fd3a8; --faint: #454c58; --grid: #2b2f37 } }
.plots { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(32rem, 100%), 1fr)); gap: 1rem; margin: 1rem 0 }
.plots section { margin: 0 } section h3 { margin-bottom: .2rem } section > p { font-size: .88rem }
svg { width: 100%; height: auto; display: block; overflow: visible } svg text { font: 11px system-ui, sans-serif; fill: var(--dim) }
.grid { stroke: var(--grid); fill: none } .axis { stroke: var(--dim); fill: none } .line { fill: none; stroke-width: 1.8; stroke-linejoin: round }
.mark { stroke: var(--card); stroke-width: 1 } .legend { font-size: .85rem; margin: .3rem 0 0 } .legend span { margin-right: 1.1em; white-space: nowrap }
.legend i { display: inline-block; width: .7em; height: .7em; border-radius: 50%; margin-right: .4em; print-color-adjust: exact }
.tick:hover path, .tick:focus path { stroke: var(--ink) } .tick path { stroke-width: var(--wide) }
td span { scroll-margin-top: 5rem } tr:has(:target) td { background: var(--grid); font-weight: 600 } details { margin: .8rem 0 } summary { cursor: pointer; font-weight: 600 }
@page { margin: 12mm } @media print { body { padding: 0; max-width: none; font-size: 13px } svg text { font-size: 14px } h2 { break-after: avoid } section, .figures div { break-inside: avoid } .plots { grid-template-columns: 1fr 1fr } }
"""


@dataclass(frozen=True)
class Told:
    """What the report of a shot plan tells.

    title: of the scene.
    noticed: (s,) of shot.switches.ROW.
    names: of the G groups.
    phases: the shot's phase classes. classes: rows of them, see PhasePlan.rows.
    tints: (r, g, b) linear, of each LOD.
    milliseconds: of each stage of the survey, the mean of a frame; empty if they were not taken.
    crops: of the largest changes, see switch_figures.figures; empty if none were drawn.
    """

    title: str
    shot: Shot
    plan: ShotPlan
    noticed: np.ndarray
    curve: Curve
    names: list[str]
    phases: PhasePlan
    classes: Sequence[Mapping[str, Any]]
    tints: Sequence[Sequence[float]]
    milliseconds: Mapping[str, float]
    crops: Sequence[tuple[np.ndarray, np.ndarray] | None] = ()

    @property
    def numbers(self) -> np.ndarray:
        """(F,) int64, the frames."""
        return self.shot.survey.numbers

    @property
    def raised(self) -> float:
        """Pixels to which a budget raised the tolerance; 0 if none did."""
        return self.plan.tolerance if isinstance(self.plan, BudgetPlan) else 0.0

    @property
    def entries(self) -> np.ndarray:
        """(F,) how many agents appear at once in each frame."""
        frames = self.noticed["frame"][self.noticed["before"] == NOTHING]
        return np.bincount(np.searchsorted(self.numbers, frames), minlength=len(self.numbers))

    @property
    def colors(self) -> list[str]:
        """CSS, of each LOD."""
        return [css_of(tint) for tint in self.tints]


def shot_page(told: Told) -> str:
    """Return the web page on a planned shot; all text is escaped."""
    return document(
        f"{escape(told.title)}: shot plan",
        STYLE + PLOTS_STYLE + switch_figures.CROPS_STYLE,
        shot_parts(told),
    )


def preview_page(told: Told, plan: dict[str, Any]) -> str:
    """Return the web page of a preview that was planned first: the plan, then the pictures.

    plan: the content of plan.json.
    """
    return document(
        f"{name_of(plan)}: levels of detail",
        STYLE + PLOTS_STYLE + switch_figures.CROPS_STYLE,
        [*shot_parts(told), *parts_of(plan)],
    )


def shot_parts(told: Told) -> list[str]:
    """Return the parts of the page on a planned shot, as HTML."""
    title = escape(told.title)
    return [
        f"<h1>{title}: shot plan</h1>",
        f"<p>{escape(lead(told))}</p>",
        cards(_figures(told)),
        list_of("Warnings", _warnings(told)),
        _strip(told),
        '<div class="plots">',
        *(f"<section>{one}</section>" for one in _plots(told) if one),
        "</div>",
        _worst(told),
        list_of(
            "What the shot does not need", unneeded(told.shot, told.plan.bill.shown, told.names)
        ),
        "<h2>Tables</h2>",
        _switch_table(told),
        _frame_table(told),
        _curve_table(told),
        "<footer>switches.csv has every switch and entry, frames.csv a row of each frame, "
        "plan.json the figures, plan.npz the LODs.</footer>",
    ]


def lead(told: Told) -> str:
    """Return what the plan saves and avoids, in sentences."""
    found = told.plan.bill
    before = told.plan.thresholds
    survey = told.shot.survey
    _, triangles, memory = of_full_detail(told.shot, found)
    frames = len(told.numbers)
    engine = NAMES[told.shot.costs.engine]
    return (
        f"{counted(frames, 'frame')} of {counted(len(survey.group), 'agent')} for {engine}. The "
        f"plan takes "
        f"{triangles:.1%} of the triangles and {memory:.0%} of the memory that full detail takes, "
        f"and changes LODs "
        f"{int(found.switches.sum()):,} times in sight. Thresholds, frame by frame, change them "
        f"{int(before.switches.sum()):,} times "
        f"and cost {_less(found.above(before))}. {_in_step(told)}"
    )


def _in_step(told: Told) -> str:
    """Return a sentence on the phase classes; "" if nothing walks."""
    counts = sorted({row["classes"] for row in told.classes})
    if not counts:
        return ""
    numbers = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"
    return (
        f"Agents share {numbers} phase classes: {told.phases.in_step:.1%} of close neighbors walk "
        f"in step, with sixteen at random {told.phases.at_random:.1%}."
    )


def _less(above: float) -> str:
    return "as much or more" if above < 0.0005 else f"{above:.1%} less, at most"


def _figures(told: Told) -> list[tuple[str, str]]:
    found = told.plan.bill
    before = told.plan.thresholds
    seconds, triangles, memory = of_full_detail(told.shot, found)
    bound = f"{told.plan.bound:.2%}" if isfinite(told.plan.bound) else "not known"
    return [
        (f"{triangles:.1%}", "of full detail's triangles"),
        (
            f"{seconds:.0%}",
            f"of its time in {NAMES[told.shot.costs.engine]}, by costs of {told.shot.costs.basis}",
        ),
        (f"{memory:.0%}", "of its memory"),
        (
            f"{int(found.switches.sum()):,}",
            f"switches in sight, {int(before.switches.sum()):,} by thresholds",
        ),
        (bound, "above the least possible at most"),
        (f"{number(found.error)} px", "largest deviation of a LOD"),
        (f"{number(found.most)} px", "largest change by a switch"),
        (f"{told.phases.in_step:.1%}", "of close neighbors in step"),
        (
            f"{number(told.phases.largest_jump)} px",
            "largest jump of a foot at a change of pace, by shared phases",
        ),
    ]


def _warnings(told: Told) -> list[str]:
    """Return what the user should know before using the plan."""
    survey = told.shot.survey
    plan = told.plan
    found = []
    if told.raised:
        found.append(
            f"LODs deviate by up to {number(told.raised)} pixels, for the budget allows no finer "
            f"ones."
        )
    if survey.cuts.any():
        found.append(
            f"Another camera films from {_frames(survey.numbers[survey.cuts])} on: switches there "
            f"do not count."
        )
    if entries := int(told.entries.sum()):
        found.append(
            f"{entries:,} {'agent appears' if entries == 1 else 'agents appear'} at once, by the "
            f"near or far clip of the camera, "
            f"in {_frames(told.numbers[told.entries > 0])}: change the clip, or where the crowd "
            f"starts."
        )
    if (
        plan.thresholds.switches.sum()
        and plan.bill.switches.sum() >= plan.thresholds.switches.sum()
    ):
        found.append("The plan avoids no switch: raise Avoid Pops, or the tolerance.")
    empty = ~survey.seen.any(axis=1)
    if empty.any():
        found.append(f"No character is seen in {_frames(survey.numbers[empty])}.")
    if (np.diff(survey.numbers) > 1).any():
        found.append(
            "The frames are not all frames of the shot: a switch between two of them may be one "
            "in any frame between."
        )
    return found


def _frames(numbers: np.ndarray) -> str:
    """Return "frame 3" or "frames 3, 7, 9 and 12 more"."""
    told = [str(n) for n in numbers[:5].tolist()]
    more = f" and {len(numbers) - 5:,} more" if len(numbers) > 5 else ""
    return f"frame{'s' if len(numbers) > 1 else ''} {', '.join(told)}{more}"


def _legend(rows: Sequence[svg.Series]) -> str:
    dots = "".join(
        f'<span><i style="background:{row.color}"></i>{escape(row.name)}</span>' for row in rows
    )
    return f'<p class="legend">{dots}</p>'


def _strip(told: Told) -> str:
    """Return the timeline with a tick for each frame with a switch or an entry, high as its
    largest.
    """
    numbers = told.numbers
    found = told.noticed
    (wide, high) = STRIP
    at = svg.edges(numbers)
    most = found["change"].max(initial=0.0)
    x = svg.across("Frame", at[0], at[-1], width=wide)
    y = svg.up("Pixels", most, height=high + svg.TOP + svg.BOTTOM)
    ticks = []
    for frame in np.unique(found["frame"]).tolist():
        rows = found[found["frame"] == frame]
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
    said = (
        "Each tick is a frame in which LODs change in sight, as high as the largest change. "
        "Click it to see its rows in the table."
    )
    colors = [
        svg.Series(name, at, f"var(--{key})")
        for name, key in (("switches", "plan"), ("an agent appears at once", "entry"))
    ]
    legend = _legend(colors if told.entries.any() else colors[:1])
    return (
        f"<h2>Switches in "
        f"sight</h2><section><p>{said}</p>{svg.plot(said, x, y, marks)}{legend}</section>"
    )


def _plots(told: Told) -> list[str]:
    """Return the HTML of each plot, with its heading."""
    shot = told.shot
    found = told.plan.bill
    before = told.plan.thresholds
    survey = shot.survey
    meshes = shot.meshes
    at = svg.edges(told.numbers)
    lods = list(enumerate(told.colors[: meshes.count]))
    each = (found.shown * meshes.triangles.T[:, survey.owner]).sum(axis=2)
    kinds = [
        (survey.kind == kind).sum(axis=1) / max(len(survey.group), 1) * 100
        for kind in (SEEN, SHADOW, MIRRORED, CULLED)
    ]
    names = ("seen", "shadow only", "mirror image only", "culled")
    shares = [
        svg.Series(*row)
        for row in zip(
            names, kinds, ("var(--plan)", "var(--old)", "var(--entry)", "var(--faint)"), strict=True
        )
    ]
    shown = [row for row in shares if row.values.any()]
    switches = [
        svg.Series("thresholds", before.switches, "var(--old)"),
        svg.Series("plan", found.switches, "var(--plan)"),
    ]
    if told.entries.any():
        switches.append(svg.Series("agents that appear at once", told.entries, "var(--entry)"))
    return [
        _areas(
            at,
            "LODs of seen agents",
            "Agents",
            [svg.Series(f"LOD {k}", found.counts[:, k], tint) for k, tint in lods],
        ),
        _areas(
            at,
            "Triangles by LOD",
            "Triangles",
            [svg.Series(f"LOD {k}", each[:, k], tint) for k, tint in lods],
        ),
        _areas(at, "Seen and culled", "% of agents", shown, 100.0),
        _lines(at, "Switches in sight per frame", "Agents", switches),
        _error_plot(told.curve, len(survey.group)),
        "" if told.raised else _avoid_plot(told.curve),  # its plans would be over the budget
        _stage_plot(told.milliseconds),
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
    shown = [
        point
        for point in reversed(curve.points)
        if point.kind in ("plan", "thresholds", "hysteresis")
    ]
    errors = [point.error for point in (*sweep, *shown) if point.error > 0]
    if not errors:
        return ""  # a single LOD
    costs = ("triangles", "var(--plan)"), ("memory", "var(--held)"), ("seconds", "var(--dim)")
    most = max(
        100.0, *(100 * getattr(point, key) for point in (*sweep, *shown) for key, _ in costs)
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
        for point in shown:
            if point.error > 0:
                part = 100 * getattr(point, key)
                says = (
                    f"{point.kind}: {part:.1f} % of the {key}, {number(point.error)} pixels, "
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
    held = f", diamonds hysteresis that holds a LOD for {HELD:.0%} of its distance" * any(
        p.kind == "hysteresis" for p in shown
    )
    said = (
        f"Lines: other tolerances, frame by frame. Marks: circles the plan, squares "
        f"thresholds{held}."
    )
    if curve.agents < agents:
        said += f" From {curve.agents:,} of the agents."
    return (
        f"<h3>Error against "
        f"cost</h3><p>{said}</p>{svg.plot('Error against cost', x, y, ''.join(marks))}{_legend(rows)}"
    )


def _avoid_plot(curve: Curve) -> str:
    points = sorted(
        (max(p.above, 0.0) * 100, p.switches) for p in curve.points if p.kind in ("avoid", "plan")
    )
    others = [p for p in reversed(curve.points) if p.kind in ("plan", "thresholds")]
    most = max(p.switches for p in curve.points if p.kind in ("avoid", "plan", "thresholds"))
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
    for p in others:
        row = svg.Series(p.kind, np.array([[max(p.above, 0.0) * 100, p.switches]]), colors[p.kind])
        marks += svg.mark(
            x,
            y,
            row,
            "circle",
            [f"{p.kind}: {p.switches:,} switches, {max(p.above, 0.0):.1%} more cost"],
        )
    said = "What other values of Avoid Pops would cost. The blue mark is this plan."
    legend = _legend([svg.Series(kind, np.empty(0), color) for kind, color in colors.items()])
    return (
        f"<h3>Switches against "
        f"cost</h3><p>{said}</p>{svg.plot('Switches against cost', x, y, marks)}{legend}"
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
    said = "Means of the survey's frames; time to decide comes on top."
    return (
        f"<h3>Milliseconds by "
        f"stage</h3><p>{said}</p>{svg.plot('Milliseconds by stage', x, y, ''.join(bars))}"
    )


HEAD = ("Frame", "Agent", "From", "To", "Size, px", "Change, px")


def _cells(row: np.void) -> list[str]:
    before = "not in sight" if row["before"] == NOTHING else f"LOD {row['before']}"
    sizes = (number(float(row[name])) for name in ("size", "change"))
    return [f"{row['frame']}", f"{row['agent']}", before, f"LOD {row['after']}", *sizes]


def _worst(told: Told) -> str:
    rows = [_cells(row) for row in largest(told.noticed, WORST)]
    titles = [
        f"Frame {frame}, agent {agent}: {before} to {after}"
        for frame, agent, before, after, *_ in rows
    ]
    shown = switch_figures.figures(titles, told.crops)
    return f"<h2>The largest changes</h2>{table_of(HEAD, rows)}{shown}" if rows else ""


def _switch_table(told: Told) -> str:
    found = told.noticed
    if not len(found):
        return "<p>No LOD changes in sight.</p>"
    rows = []
    begins = np.flatnonzero(np.diff(found["frame"], prepend=found["frame"][0] - 1))
    for frame_rows in np.split(found, begins[1:]):
        for place, row in enumerate(largest(frame_rows, OF_A_FRAME)):
            cells = _cells(row)
            if not place:
                cells[0] = f'<span id="f{row["frame"]}">{row["frame"]}</span>'
            rows.append([*cells, f"{len(frame_rows):,}" if not place else ""])
    return _folded(
        f"Switches and entries: the {OF_A_FRAME} largest of each frame",
        table_of([*HEAD, "In the frame"], rows),
    )


def _frame_table(told: Told) -> str:
    found = told.plan.bill
    before = told.plan.thresholds
    survey = told.shot.survey
    head = ["Frame", "Seen", "Culled", *(f"LOD {k}" for k in range(told.shot.meshes.count))]
    head += ["Triangles", "Switches", "Change, px", "Enter at once", "Switches by thresholds"]
    columns = [
        told.numbers,
        survey.seen.sum(axis=1),
        (survey.kind == CULLED).sum(axis=1),
        *found.counts.T,
    ]
    columns += [
        found.triangles.astype(np.int64),
        found.switches,
        found.pixels,
        told.entries,
        before.switches,
    ]
    rows = [
        [number(v) if isinstance(v, float) else f"{v:,}" for v in row]
        for row in zip(*(c.tolist() for c in columns), strict=True)
    ]
    return _folded("Frames", table_of(head, rows))


def _curve_table(told: Told) -> str:
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
        for p in told.curve.points
    ]
    return _folded(f"Error against cost, from {told.curve.agents:,} agents", table_of(head, rows))


def _folded(title: str, inside: str) -> str:
    return f"<details><summary>{escape(title)}</summary>{inside}</details>"
