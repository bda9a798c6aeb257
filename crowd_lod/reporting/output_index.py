"""The page index.html of an output folder: what is in it, from when, and for which .blend file."""

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path
from urllib.parse import quote

from . import files
from .html_report import STYLE, document, table_of

NAME = "index.html"
ENTRIES = "index.json"  # the entries of the page, read when the page is written anew


@dataclass(frozen=True)
class Entry:
    """What one step has written into its folder.

    part: the folder's name.
    title: of the step.
    date: when it was made, as text.
    file, scene: for which .blend file ("" if it was not saved) and scene.
    verdict: what the step found, in a line.
    """

    part: str
    title: str
    date: str
    file: str
    scene: str
    verdict: str = ""


CROWD = "crowd.png"  # the picture of a crowd as marks
PICTURES = "contact_sheet.png", "worst.png", CROWD  # of a step's folder, for the page


def add_to_index(folder: Path, entry: Entry) -> None:
    """Note in the output folder what a step has made there; replaces the step's earlier entry.

    CrowdError if the folder cannot be written.
    """
    entries = {noted.part: noted for noted in read_index(folder)} | {entry.part: entry}
    ordered = sorted(entries.values(), key=lambda noted: noted.date, reverse=True)
    with files.staged(folder, NAME, ENTRIES) as hidden:
        (hidden / ENTRIES).write_text(
            json.dumps([asdict(noted) for noted in ordered], indent=1), encoding="utf-8"
        )
        (hidden / NAME).write_text(index_page(folder, ordered), encoding="utf-8")


def read_index(folder: Path) -> list[Entry]:
    """Return the entries of the output folder; none if it has none that can be read."""
    with suppress(OSError, ValueError, TypeError):
        entries = [
            Entry(**known) for known in json.loads((folder / ENTRIES).read_text(encoding="utf-8"))
        ]
        if all(isinstance(value, str) for entry in entries for value in asdict(entry).values()):
            return entries
    return []


def index_page(folder: Path, entries: Sequence[Entry]) -> str:
    """Return the page as HTML; all text is escaped."""
    head = "Step", "Made", "For file", "Scene", "Files"
    rows = [
        [
            escape(entry.title),
            escape(entry.date),
            escape(entry.file or "not saved"),
            escape(entry.scene),
            _links(folder, entry.part),
        ]
        for entry in entries
    ]
    title = escape(folder.name)
    style = STYLE + "th, td { text-align: left } td:last-child { white-space: normal }\n"
    return document(
        title,
        style,
        [
            f"<h1>{title}</h1><p>What Crowd LOD has made, the newest first.</p>",
            *(_section(folder, entry) for entry in entries),
            "<h2>Files</h2>",
            table_of(head, rows),
        ],
    )


def _section(folder: Path, entry: Entry) -> str:
    """Return what a step found, its picture, and a link to its report."""
    report = f"{quote(entry.part)}/report.html"
    title = escape(entry.title)
    if (folder / entry.part / "report.html").is_file():
        title = f'<a href="{report}">{title}</a>'
    images = [
        f'<a href="{quote(entry.part)}/{name}"><img src="{quote(entry.part)}/{name}" '
        f'alt="{escape(entry.title)}"></a>'
        for name in PICTURES
        if (folder / entry.part / name).is_file()
    ]
    return (
        f'<section><h3>{title}</h3><p class="verdict">{escape(entry.verdict)}</p>'
        f"<p>{escape(entry.date)}</p>{''.join(images)}</section>"
    )


def _links(folder: Path, part: str) -> str:
    """Return links to a step's report, and to the other files that are no pictures of frames."""
    if part == "bake":
        return "in the .blend file"
    if not (folder / part).is_dir():
        return "removed"
    names = sorted(
        path.name
        for path in (folder / part).iterdir()
        if path.is_file() and not path.name.startswith(".")
    )
    first = [name for name in names if name == "report.html"]
    other_names = [
        name
        for name in names
        if name not in first and (not name.endswith(".png") or name in PICTURES)
    ]
    links = [
        f'<a href="{quote(part)}/{quote(name)}">{escape(name)}</a>' for name in first + other_names
    ]
    pictures = len(names) - len(links)
    return ", ".join([*links, *[f"{pictures} pictures"] * bool(pictures)])
