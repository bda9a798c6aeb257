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
    "Pixels without those kept",
    "Shift measured, px",
    "Shift predicted, px",
    "Visibly other by LODs, %",
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
            '<section><a href="contact_sheet.png"><img src="contact_sheet.png" alt="The pictures of each frame and their differences"></a></section>',
            "<h2>Frames</h2>",
            "<p>Agents outside the picture are kept for their shadows and reflections in it; without those kept, other pixels change. "
            "A silhouette's shift is measured to a pixel, and predicted from the deviations of the LODs. A pixel is visibly other "
            "from 2 of 255 on, shading included, which nothing predicts.</p>",
            table_of(COLUMNS, [_cells(row) for row in rows]),
            list_of("What was left out", result["left_out"]),
            list_of("What is not proved", result["not_proved"]),
            f"<footer>{frames}, {result['width']} pixels wide, {result['samples']} samples a pixel, by "
            f"<code>{escape(' '.join(result['command']))}</code>. verify.csv has all figures of each frame, verify.json too.</footer>",
        ],
    )


def _figures(rows: Sequence[dict]) -> list[tuple[str, str]]:
    predicted = [row["predicted_shift"] for row in rows]
    return [
        (f"{len(rows)}", "frames rendered"),
        (f"{max(row['agents'] for row in rows):,}", "agents"),
        (f"{max(row['visible'] for row in rows):,}", "visible at most"),
        (f"{sum(row['b_pixels'] for row in rows):,}", "pixels that culling changes"),
        (number(max(row["silhouette_shift"] for row in rows)), "pixels that LODs shift silhouettes at most"),
        (number(None if None in predicted else max(predicted)), "pixels predicted"),
    ]


def _columns(result: dict) -> str:
    """Return what the contact sheet shows, in sentences."""
    more = " Its second row has the light of the sky and of bounces, too." if result["bounces"] else ""
    return (
        f"Each row is a frame, from the left: {'; '.join(result['pictures'].values())}. Then how the last three differ from the "
        f"first, {result['amplified']} times as bright; black is no difference.{more}"
    )


def _cells(row: dict) -> list[str]:
    wrong = [what for what, ok in (("culling", row["culling_ok"]), ("LODs", row["lod_ok"])) if not ok]
    return [
        *(f"{row[key]:,}" for key in ("frame", "agents", "visible", "shadow", "mirrored", "b_pixels", "bare_pixels")),
        *(number(row[key]) for key in ("silhouette_shift", "predicted_shift")),
        number(100 * row["c_share"]),
        f"no: {', '.join(wrong)}" if wrong else "yes",
    ]
