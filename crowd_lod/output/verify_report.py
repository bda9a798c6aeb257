"""The report of a proof by renders as a web page: one file without scripts, beside its pictures."""

from collections.abc import Sequence
from html import escape

from ..format import number
from ..validation.render_proof import describe_difference, verdict, worst_agents
from .html_report import STYLE, cards, document, list_of, table_of

COLUMNS = (
    "Frame",
    "Agents",
    "Visible",
    "For shadows",
    "For mirrors",
    "Pixels that culling changes",
    "Pixels without those kept",
    "Agents judged",
    "Shift measured, px",
    "Shift predicted, px",
    "Shift allowed, px",
    "Visibly other by LODs, %",
    "OK",
)
AGENT_COLUMNS = (
    "Frame",
    "Agent",
    "LOD",
    "Shift, px",
    "Give or take, px",
    "Predicted, px",
    "Allowed, px",
    "Color off, %",
    "OK",
)


def verify_page(title: str, result: dict) -> str:
    """Return the web page on a proof; all text is escaped.

    title: of the scene.
    result: the content of verify.json.
    """
    rows = result["frames"]
    frames = f"{len(rows)} {'frame' if len(rows) == 1 else 'frames'}"
    return document(
        f"{escape(title)}: proof by renders",
        STYLE,
        [
            f"<h1>{escape(title)}: proof by renders</h1>",
            f"<p>{escape(verdict(result))}</p>",
            cards(_figures(rows)),
            "<h2>Pictures</h2>",
            f"<p>{escape(_columns(result))}</p>",
            '<section><a href="contact_sheet.png"><img src="contact_sheet.png" alt="The pictures '
            'of each frame and their differences"></a></section>',
            "<h2>Frames</h2>",
            "<p>Agents outside the picture are kept for their shadows and reflections in it; "
            "without those kept, other pixels change. "
            "A pixel is visibly other from 2 of 255 on, shading included, which nothing "
            "predicts.</p>",
            table_of(COLUMNS, [_cells(row) for row in rows]),
            *_agents(result),
            list_of("What was left out", result["left_out"]),
            list_of("What is not proved", result["not_proved"]),
            f"<footer>{frames}, {result['width']} pixels wide, {result['samples']} samples a "
            f"pixel, by "
            f"<code>{escape(' '.join(result['command']))}</code>. verify.csv has all figures of "
            f"each frame, verify.json too.</footer>",
        ],
    )


def _agents(result: dict) -> list[str]:
    """Return the part on the agents that were rendered alone."""
    agents = result["agents"]
    if not agents:
        return []
    pictures = [
        _worst_of(frame, [agent for agent in agents if agent["frame"] == frame])
        for frame in dict.fromkeys(agent["frame"] for agent in agents)
    ]
    return [
        "<h2>Agents</h2>",
        "<p>Of each frame the agents that are predicted worst, and others drawn by chance, were "
        "rendered alone, at full detail and as built, at the size of the final picture or finer. "
        "A silhouette's shift is "
        "the largest distance from "
        "one to the other, in pixels of the final picture. Agents that overrides pin, that blur "
        "lets be coarser, or that are in a cross-fade, stand apart.</p>",
        *pictures,
        table_of(AGENT_COLUMNS, [_agent_cells(agent) for agent in agents]),
    ]


def _worst_of(frame: int, agents: Sequence[dict]) -> str:
    """Return the picture of a frame's worst agents, with what its rows and columns are."""
    name = f"frame_{frame:04d}_agents.png"
    worst = [agents[k] for k in worst_agents(agents)]
    rows = "; ".join(
        f"agent {agent['agent']:,} at LOD {agent['lod']}, {describe_difference(agent)}"
        for agent in worst
    )
    return (
        f"<section><h3>Frame {frame}</h3><p>From the left: everyone at full detail, as built, and "
        f"where they differ, amplified. From the top: {rows}.</p>"
        f'<a href="{name}"><img src="{name}" alt="The worst agents of frame {frame}"></a></section>'
    )


def _agent_cells(agent: dict) -> list[str]:
    ok = "-" if agent["ok"] is None else "yes" if agent["ok"] else "no"
    return [
        *(f"{agent[key]:,}" for key in ("frame", "agent", "lod")),
        *(number(agent[key]) for key in ("shift_px", "error_px", "predicted_px", "allowed_px")),
        number(100 * agent["color_off"]),
        agent["apart"] or ok,
    ]


def _figures(rows: Sequence[dict]) -> list[tuple[str, str]]:
    shifts, allowed = ([row[key] for row in rows] for key in ("silhouette_shift", "allowed_shift"))
    return [
        (f"{len(rows)}", "frames rendered"),
        (f"{max(row['agents'] for row in rows):,}", "agents"),
        (f"{max(row['visible'] for row in rows):,}", "visible at most"),
        (f"{sum(row['b_pixels'] for row in rows):,}", "pixels that culling changes"),
        (
            number(max((each for each in shifts if each is not None), default=None)),
            "pixels that LODs shift silhouettes at most",
        ),
        (number(None if None in allowed else max(allowed)), "pixels allowed"),
    ]


def _columns(result: dict) -> str:
    """Return what the contact sheet shows, in sentences."""
    more = (
        " Its second row has the light of the sky and of bounces, too." if result["bounces"] else ""
    )
    return (
        f"Each row is a frame, from the left: {'; '.join(result['pictures'].values())}. Then how "
        f"the last three differ from the "
        f"first, {result['amplified']} times as bright; black is no difference.{more}"
    )


def _cells(row: dict) -> list[str]:
    wrong = [
        what for what, ok in (("culling", row["culling_ok"]), ("LODs", row["lod_ok"])) if not ok
    ]
    return [
        *(
            f"{row[key]:,}"
            for key in (
                "frame",
                "agents",
                "visible",
                "shadow",
                "mirrored",
                "b_pixels",
                "bare_pixels",
            )
        ),
        f"{row['judged']:,}",
        *(number(row[key]) for key in ("silhouette_shift", "predicted_shift", "allowed_shift")),
        number(100 * row["c_share"]),
        f"no: {', '.join(wrong)}" if wrong else "yes",
    ]
