"""The report of a shot plan as a web page: one file without scripts, with its plots inside."""

from html import escape
from typing import Any

import numpy as np

from ..format import number
from ..shot.survey import CULLED, SEEN
from ..shot.switches import NOTHING, WORST, largest
from ..shot.unneeded import unneeded
from .html_report import STYLE, cards, document, list_of, name_of, parts_of, table_of
from .shot_plots import PLOTS_STYLE, plots_of, timeline
from .shot_report import ShotReport, figures_of, lead_of, warnings_of

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
        return "<p>No LOD changes in sight.</p>"
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
