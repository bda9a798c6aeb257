"""The report of a proof by renders as a web page: one file without scripts, beside its pictures."""

from collections.abc import Sequence
from html import escape

from ..format import number
from ..validation.render_proof import verdict
from .html_report import STYLE, cards, document, list_of, table_of

COLUMNS = (
    "Frame",
    "Agents",
    "Visible",
    "For shadows",
    "For mirrors",
    "Pixels that culling changes",
    "Under a sky, %",
    "By outline",
    "By presence",
    "Not judged",
    "Missing or too much",
    "Off by too much",
    "Largest error, px",
    "Allowed, px",
    "Colors differ by",
    "OK",
)
AGENT_COLUMNS = (
    "Frame",
    "Agent",
    "LOD",
    "Judged by",
    "Error, px",
    "Predicted, px",
    "Allowed, px",
    "OK",
)
MOST_AGENTS = 30  # rows of the table of agents: those that are wrong, and the worst


def verify_page(title: str, result: dict) -> str:
    """Return the web page on a proof; all text is escaped.

    title: of the scene.
    result: the content of verify.json.
    """
    rows = result["frames"]
    frames = f"{len(rows)} {'frame' if len(rows) == 1 else 'frames'}"
    agents = sorted(result["agents"], key=lambda agent: agent["ok"] is not False)[:MOST_AGENTS]
    return document(
        f"{escape(title)}: proof by renders",
        STYLE,
        [
            f"<h1>{escape(title)}: proof by renders</h1>",
            f"<p>{escape(verdict(result))}</p>",
            cards(_figures(rows)),
            "<h2>Worst places</h2>",
            "<p>Of each frame the three worst places, large: everyone at full detail, as built, "
            "and where they differ. Of an agent red is what the build lost of it, blue what is too "
            "much, light gray what both show; of colors the difference, amplified.</p>",
            *[
                _picture(f"frame_{row['frame']:04d}_places.png", f"Frame {row['frame']}")
                for row in rows
            ],
            "<h2>Whole pictures</h2>",
            f"<p>{escape(_columns(result))}</p>",
            _picture("contact_sheet.png", "The pictures of each frame and their differences"),
            "<h2>Frames</h2>",
            "<p>Who is wide enough is judged by the outline: how far it is off, in pixels of the "
            "final picture. Others are judged by whether they are there. Colors differ by the mean "
            "over a patch of 8 x 8 pixels, of 1; from 0.1 on that is wrong.</p>",
            table_of(COLUMNS, [_cells(row) for row in rows]),
            "<h2>Agents</h2>",
            "<p>Those that are wrong, then those whose outline is off most. Whom an override pins, "
            "who is blurred or fades, is bound by no tolerance.</p>",
            table_of(AGENT_COLUMNS, [_agent_cells(agent) for agent in agents]),
            list_of("What was left out", result["left_out"]),
            list_of("What is not proved", result["not_proved"]),
            f"<footer>{frames}, {result['width']} pixels wide, {result['samples']} samples a "
            f"pixel, by "
            f"<code>{escape(' '.join(result['command']))}</code>. verify.csv has all figures of "
            f"each frame, verify.json those of agents and patches, too.</footer>",
        ],
    )


def _picture(name: str, words: str) -> str:
    return f'<section><a href="{name}"><img src="{name}" alt="{words}"></a></section>'


def _agent_cells(agent: dict) -> list[str]:
    ok = "-" if agent["ok"] is None else "yes" if agent["ok"] else "no"
    error = number(agent["error_px"])
    return [
        *(f"{agent[key]:,}" for key in ("frame", "agent", "lod")),
        agent["by"] or "-",
        "missing" if agent["missing"] else "too much" if agent["extra"] else error,
        *(number(agent[key]) for key in ("predicted_px", "allowed_px")),
        agent["apart"] or ok,
    ]


def _figures(rows: Sequence[dict]) -> list[tuple[str, str]]:
    judged = sum(row["by_outline"] + row["by_presence"] for row in rows)
    errors = [row["error_px"] for row in rows if row["error_px"] is not None]
    return [
        (f"{len(rows)}", "frames rendered"),
        (f"{judged:,}", "agents judged"),
        (f"{sum(row['missing'] + row['extra'] + row['off'] for row in rows):,}", "of them wrong"),
        (number(max(errors, default=None)), "pixels that outlines are off at most"),
        (number(max(row["color_off"] for row in rows)), "of 1, that colors differ at most"),
        (f"{sum(row['culling_pixels'] for row in rows):,}", "pixels that culling changes"),
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
    counts = "frame", "agents", "visible", "shadow", "mirrored", "culling_pixels"
    ways = "by_outline", "by_presence", "not_judged"
    return [
        *(f"{row[key]:,}" for key in counts),
        number(None if row["sky_share"] is None else 100 * row["sky_share"]),
        *(f"{row[key]:,}" for key in ways),
        f"{row['missing'] + row['extra']:,}",
        f"{row['off']:,}",
        *(number(row[key]) for key in ("error_px", "allowed_px", "color_off")),
        f"no: {', '.join(wrong)}" if wrong else "yes",
    ]
