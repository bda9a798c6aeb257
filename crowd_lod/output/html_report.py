"""The report of a preview as a web page: one file without scripts.

It stands beside its pictures.
"""

from collections.abc import Sequence
from html import escape
from pathlib import PurePath
from urllib.parse import quote

import numpy as np

from .. import srgb
from ..format import number

METHODS = {"POSE_AWARE": "Pose-Aware"}  # as pages name them
STYLE = """
:root { color-scheme: light dark; --ink: #1d2026; --dim: #646b78; --paper: #fafbfc; --card: #fff;
  --line: #dde1e7; --best: #2a6fdb }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e7e9ee; --dim: #9aa2b1; --paper: #15171b; --card: #1e2127; --line: #343943;
    --best: #7fb0ff } }
a { color: var(--best) }
body { margin: 0 auto; padding: 2rem 1.5rem 4rem; max-width: 76rem; background: var(--paper);
  color: var(--ink);
  font: 15px/1.55 system-ui, sans-serif }
h1, h3, li { overflow-wrap: anywhere } h1 { font-size: 1.9rem; margin: 0 }
h2 { margin: 2.8rem 0 .8rem; font-size: 1.3rem } h3 { margin: 0 0 .6rem }
p { margin: .4rem 0; color: var(--dim); max-width: 60rem } code { font-size: .9em }
p.verdict { color: var(--ink); font-size: 1.2rem }
.figures { display: flex; flex-wrap: wrap; gap: .8rem; margin: 1.4rem 0 }
.figures div { background: var(--card); border: 1px solid var(--line); border-radius: .6rem;
  padding: .6rem 1.1rem }
.figures b { display: block; font-size: 1.35rem }
.figures span { color: var(--dim); font-size: .85rem }
section { background: var(--card); border: 1px solid var(--line); border-radius: .8rem;
  padding: 1.2rem; margin: 1rem 0 }
img { max-width: 100%; height: auto; border-radius: .5rem; display: block; margin: 0 auto }
.scroll { overflow-x: auto }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums }
th, td { padding: .32rem .4rem; text-align: right; border-bottom: 1px solid var(--line) }
td { font-size: .92rem }
th { color: var(--dim); font-weight: 600; font-size: .78rem; vertical-align: bottom }
th:first-child, td:first-child { text-align: left }
.dot { display: inline-block; width: .7em; height: .7em; border-radius: 50%; margin-right: .45em }
ul { color: var(--dim) } footer { margin-top: 3rem; color: var(--dim); font-size: .85rem }
"""


def page(plan: dict) -> str:
    """Return the web page of a preview's plan, the content of plan.json; all text is escaped."""
    return document(f"{name_of(plan)}: levels of detail", STYLE, parts_of(plan))


def name_of(plan: dict) -> str:
    """Return the name of the scene of plan.json, as HTML."""
    return escape(PurePath(plan["scene"]["file"] or plan["scene"]["name"]).stem)


def parts_of(plan: dict) -> list[str]:
    """Return the parts of the page of a preview's plan, as HTML."""
    rows = plan["frames"]
    levels = plan["levels"]
    tints = [css_of(tint) for tint in levels["tints"]]
    verdict = plan["preview"]["verdict"]
    parts = [
        f"<h1>{name_of(plan)}</h1><p>Crowd LOD {escape(plan['made_with']['crowd_lod'])}, Blender "
        f"{escape(plan['made_with']['blender'])}. "
        f"{escape(_rule(levels))}</p>",
        f'<p class="verdict">{escape(verdict)}</p>' if verdict else "",
        cards(_figures(rows, len(tints))),
        f"<p>{escape(plan['trouble_says'])}</p>" if plan["trouble_says"] else "",
        '<section><a href="contact_sheet.png"><img src="contact_sheet.png" '
        'alt="All frames, from the camera and from above"></a></section>',
        "<h2>Levels of detail</h2>",
        f"<p>Deviation is the largest distance between the surfaces of LOD and character, both "
        f"ways, over the action: "
        f"at least what was found, at most its bound; the "
        f"distances are those of the camera {escape(plan['camera'])} at frame {rows[0]['frame']}, "
        f"and its pixels those of "
        f"renders {' x '.join(map(str, levels['pixels']))} large. Predicted is what the "
        "bound shows where the LOD begins; measured, how far its rendered outline lies from the "
        "character's there, "
        "the worst of all directions. Picture off is the mean difference there of the shaded "
        "pictures, with materials' colors and "
        "images, in percent of white; Similar is their structural similarity (SSIM), 1 for equal "
        "pictures.</p>",
    ]
    parts += [_character(entry, tints) for entry in levels["characters"]]
    if levels["dropped"]:
        items = "".join(f"<li>{escape(name)}</li>" for name in levels["dropped"])
        parts.append(f"<h3>Not made</h3><ul>{items}</ul>")
    keys = [key for key in rows[0] if not key.endswith(("_ms", "vertices"))]
    head = [
        f"LOD {key[3:]}" if key.startswith("lod") else key.replace("_", " ").capitalize()
        for key in keys
    ]
    parts += [
        "<h2>Frames</h2>",
        table_of(head, [[_count(row[key]) for key in keys] for row in rows]),
    ]
    command = escape(" ".join(plan["command"]))
    parts.append(
        f"<footer>Made in {plan['seconds']:.1f} s by <code>{command}</code>; plan.json holds all "
        f"that repeats it.</footer>"
    )
    return parts


def _count(value: int) -> str:
    """Return a count in at most seven letters, so that the table fits the page."""
    if value < 100_000:
        return f"{value:,}"
    return f"{value / 1e3:.0f}&nbsp;k" if value < 1_000_000 else f"{value / 1e6:,.1f}&nbsp;M"


def _figures(rows: Sequence[dict], lods: int) -> list[tuple[str, str]]:
    least, most = (pick(row["visible"] for row in rows) for pick in (min, max))
    triangles = sum(row["triangles"] for row in rows)
    full = sum(row["full_triangles"] for row in rows)
    return [
        (f"{rows[0]['agents']:,}", "agents"),
        (f"{least:,}" if least == most else f"{least:,} to {most:,}", "visible"),
        (str(lods), "levels of detail"),
        (f"{triangles / full:.1%}" if full else "-", "of the triangles without culling and LOD"),
        (f"{len(rows)}", "frames previewed"),
    ]


def document(title: str, style: str, parts: Sequence[str]) -> str:
    """Return a web page; `title` and `parts` are HTML."""
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        f'content="width=device-width">'
        f"<title>{title}</title><style>{style}</style></head><body>\n"
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def cards(figures: Sequence[tuple[str, str]]) -> str:
    """Return the HTML of (figure, what it counts), side by side."""
    return (
        '<div class="figures">'
        + "".join(
            f"<div><b>{escape(n)}</b><span>{escape(what)}</span></div>" for n, what in figures
        )
        + "</div>"
    )


def _rule(levels: dict) -> str:
    """Return how LODs were chosen, in words."""
    if levels["tolerance"] is not None:
        limits = levels["budget"]
        budget = f", or by what the budget asks for ({limits})" if limits else ""
        return (
            f"LODs are chosen so that no surface lies off its character's by more than "
            f"{levels['tolerance']:g} px{budget}."
        )
    return "LODs are set by distance: what each keeps, and where it begins."


def _character(entry: dict, tints: Sequence[str]) -> str:
    head = [
        "LOD",
        "Triangles",
        "Vertices",
        "Deviation, mm",
        "RMS, mm",
        "% of diagonal",
        "From, m",
        "Predicted, px",
        "Measured, px",
        "Picture off, %",
        "Similar",
        "Way",
        "ms",
    ]
    rows = []
    for row in entry["levels"]:
        dot = f'<span class="dot" style="background:{tints[row["lod"]]}"></span>'
        rows.append(
            [
                f"{dot}{row['lod']}"
                if row["to_lod"] == row["lod"]
                else f"{dot}{row['lod']} to {row['to_lod']}",
                f"{row['triangles']:,}",
                f"{row['vertices']:,}",
                f"{number(row['deviation_mm'])} to {number(row['deviation_bound_mm'])}",
                number(row["rms_mm"]),
                number(row["percent"]),
                number(row["from_m"]) if row["begins"] == "at" else row["begins"],
                number(row["predicted_px"]),
                " to ".join(map(number, row["measured_px_between"] or [None])),
                number(
                    None if row["picture_difference"] is None else 100 * row["picture_difference"]
                ),
                number(row["picture_similarity"]),
                f'<span title="{escape(row["why"] or "")}">{_method_of(row)}</span>',
                number(row["ms"]),
            ]
        )
    name = escape(entry["group"])
    picture = (
        f'<img src="{quote(entry["picture"])}" alt="The LODs of {name} side by side">'
        if entry["picture"]
        else ""
    )
    return f"<section><h3>{name}</h3>{picture}{table_of(head, rows)}</section>"


def _method_of(row: dict) -> str:
    """Return the name of the method that made a LOD, as HTML."""
    return escape(METHODS.get(row["method"], row["method"]) or "-")


def list_of(title: str, sentences: Sequence[str]) -> str:
    """Return the HTML of a heading and a list, or "" without sentences; `sentences` are text."""
    items = "".join(f"<li>{escape(each)}</li>" for each in sentences)
    return f"<h2>{title}</h2><ul>{items}</ul>" if items else ""


def table_of(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return an HTML table; `rows` are HTML, `head` is text."""
    top = "".join(f"<th>{escape(text)}</th>" for text in head)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>\n" for row in rows)
    return (
        f'<div class="scroll"><table><thead><tr>{top}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def css_of(linear: Sequence[float]) -> str:
    """Return the linear RGB color as CSS text."""
    return f"rgb({', '.join(str(round(255 * c)) for c in srgb.encoded(np.array(linear)).tolist())})"
