"""The report of a proof by renders as a web page: one file without scripts, beside its pictures."""

from collections.abc import Iterable, Sequence
from html import escape

from ..format import counted, number
from ..validation import render_proof
from ..validation.color_patches import LARGEST
from .html_report import STYLE, document, list_of, table_of

CHECKS = ("Check", "Found", "Limit", "Result")
COLUMNS = (
    "Frame",
    "Agents",
    "Visible",
    "For shadows",
    "For mirrors",
    "By outline",
    "By presence",
    "Not judged",
    "Missing or too much",
    "Off by too much",
    "Largest error, px",
    "Limit, px",
    "Color difference",
    "Pixels that culling changes",
    "Sky's light changes in, %",
    "Result",
)
AGENT_COLUMNS = (
    "Frame",
    "Agent",
    "LOD",
    "Judged by",
    "Error, px",
    "Predicted, px",
    "Limit, px",
    "Result",
)
MOST_AGENTS = 10  # rows of the table of agents: those that are wrong, and the worst
STYLE_OF_CHECKS = """
.checks th, .checks td { text-align: left } .wrong { color: #c0392b; font-weight: 600 }
"""


def verify_page(title: str, result: dict) -> str:
    """Return the web page on a proof; all text is escaped.

    title: of the scene.
    result: the content of verify.json.
    """
    rows = result["frames"]
    agents = sorted(result["agents"], key=lambda agent: agent["ok"] is not False)[:MOST_AGENTS]
    checks = _checks(result)
    return document(
        f"{escape(title)}: {_word(result['ok'])}",
        STYLE + STYLE_OF_CHECKS,
        [
            f"<h1>{escape(title)}: {_word(result['ok'])}</h1>",
            f'<p class="verdict">{escape(_headline(result, checks))}</p>',
            f'<div class="checks">{table_of(CHECKS, [*map(_check_cells, checks)])}</div>',
            f"<p>{escape(_about_limits(rows))}</p>",
            "<h2>Worst places</h2>",
            "<p>The three worst places of each frame, enlarged: everyone at full detail, as built, "
            "and where they differ. For an agent red is what the build lost, blue what it added, "
            "light gray what both show. For colors it is the difference, amplified.</p>",
            *[
                _picture(f"frame_{row['frame']:04d}_places.png", f"Frame {row['frame']}")
                for row in rows
            ],
            "<h2>Whole pictures</h2>",
            f"<p>{escape(_columns(result))}</p>",
            _picture("contact_sheet.png", "The pictures of each frame and their differences"),
            *_frames(rows),
            "<h2>Agents</h2>",
            "<p>Those that are wrong first, then the largest errors beside their limit. Predicted "
            "is what the LOD's measured deviation shows at that distance. An agent that an "
            "override pins, or that is blurred or in a cross-fade, has no limit.</p>",
            table_of(AGENT_COLUMNS, [_agent_cells(agent) for agent in agents]),
            list_of("Left out", result["left_out"]),
            list_of("Not proved", result["not_proved"]),
            f"<footer>Pictures are {result['width']} pixels wide, with {result['samples']} samples "
            f"a pixel, by <code>{escape(' '.join(result['command']))}</code>. verify.csv has all "
            f"figures of each frame, verify.json those of agents and patches, too.</footer>",
        ],
    )


def _word(ok: bool) -> str:
    return "Passed" if ok else "Failed"


def _headline(result: dict, checks: Sequence[tuple]) -> str:
    """Return the verdict in a sentence without figures, which the checks tell."""
    frames = counted(len(result["frames"]), "rendered frame")
    if result["ok"]:
        return f"The build looks like full detail, within the limits, in {frames}."
    wrong = [check.lower() for check, _, _, ok in checks if not ok]
    return f"Wrong in {frames}: {', '.join(wrong)}."


def _checks(result: dict) -> list[tuple[str, str, str, bool]]:
    """Return what was checked, what was found, what is allowed, and whether it is kept."""
    rows = result["frames"]
    outlines, small, unjudged, apart = (
        sum(row[key] for row in rows)
        for key in ("by_outline", "by_presence", "not_judged", "apart")
    )
    wrong = render_proof.of_outlines(result)
    shades = [*render_proof.of_shades(result), *render_proof.of_colors(result["patches"])]
    culling_ok = all(row["culling_ok"] for row in rows)
    measured = [row for row in rows if row["error_px"] is not None]
    worst = max(measured, key=lambda row: row["error_px"] - row["allowed_px"], default=None)
    agents = [
        f"{outlines:,} by their outline",
        f"{small:,} smaller ones by their presence" if small else "",
        f"{unjudged:,} are too small to judge, or have no limit" if unjudged else "",
        f"{counted(apart, 'agent is', 'agents are')} pinned, blurred or fading" if apart else "",
    ]
    found = wrong or [f"largest error {worst['error_px']:.2f} px" if worst else "none judged"]
    checks = [
        (
            "Outlines and presence",
            f"{'; '.join(found)} ({', '.join(filter(None, agents))})",
            f"{worst['allowed_px']:.2f} px there" if worst and not wrong else "-",
            not wrong,
        ),
        (
            "Colors",
            "; ".join(shades)
            or f"largest difference {render_proof.largest_color(rows):.3f} (1 is black to white)",
            f"{LARGEST}, as the mean of 8 x 8 pixels",
            not shades,
        ),
        ("Culling", "; ".join(render_proof.of_culling(rows)), "no pixel changes", culling_ok),
    ]
    if of_build := render_proof.of_build(result["build"]):
        checks.append(("Build", "; ".join(of_build), "up to date, and rendered", False))
    return checks


def _check_cells(check: tuple[str, str, str, bool]) -> list[str]:
    *words, ok = check
    return [*map(escape, words), "OK" if ok else '<span class="wrong">Failed</span>']


def _about_limits(rows: Sequence[dict]) -> str:
    accuracy = max((row["give_or_take_px"] for row in rows), default=0.0)
    return (
        "An error up to its limit is good. The limit of an outline is the tolerance of the LODs, "
        "or of the shot plan, and grows away from the picture's center as a wide lens stretches "
        f"there; {accuracy:.2f} px are added, which is how exactly an outline is measured."
    )


def _frames(rows: Sequence[dict]) -> Iterable[str]:
    """Yield the part on the frames; of one frame the checks tell the rest."""
    if len(rows) == 1:
        (row,) = rows
        yield (
            f"<p>Frame {row['frame']} has {row['agents']:,} agents: {row['visible']:,} visible, "
            f"{row['shadow']:,} more for their shadows, {row['mirrored']:,} for mirrors.</p>"
        )
        return
    yield "<h2>Frames</h2>"
    yield table_of(COLUMNS, [_cells(row) for row in rows])


def _picture(name: str, words: str) -> str:
    return f'<section><a href="{name}"><img src="{name}" alt="{words}"></a></section>'


def _agent_cells(agent: dict) -> list[str]:
    ok = "-" if agent["ok"] is None else "OK" if agent["ok"] else "wrong"
    error = number(agent["error_px"])
    return [
        *(f"{agent[key]:,}" for key in ("frame", "agent", "lod")),
        agent["by"] or "-",
        "missing" if agent["missing"] else "too much" if agent["extra"] else error,
        *(number(agent[key]) for key in ("predicted_px", "allowed_px")),
        agent["apart"] or ok,
    ]


def _columns(result: dict) -> str:
    """Return what the contact sheet shows, in sentences."""
    return (
        f"Each row is a frame, from the left: {'; '.join(result['pictures'].values())}. Then how "
        f"the last two differ from the "
        f"first, {result['amplified']} times as bright; black is no difference."
    )


def _cells(row: dict) -> list[str]:
    wrong = [
        what for what, ok in (("culling", row["culling_ok"]), ("LODs", row["lod_ok"])) if not ok
    ]
    counts = "frame", "agents", "visible", "shadow", "mirrored"
    ways = "by_outline", "by_presence", "not_judged"
    return [
        *(f"{row[key]:,}" for key in (*counts, *ways)),
        f"{row['missing'] + row['extra']:,}",
        f"{row['off']:,}",
        *(number(row[key]) for key in ("error_px", "allowed_px", "color_off")),
        f"{row['culling_pixels']:,}",
        number(None if row["sky_share"] is None else 100 * row["sky_share"]),
        f"wrong: {', '.join(wrong)}" if wrong else "OK",
    ]
