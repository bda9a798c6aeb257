"""Tables, plans and contact sheets that a run writes."""

import csv
import io
import json
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ..errors import CrowdError
from ..format import printable
from ..frame.frame import Frame
from ..frame.hidden import hidden_wholly
from ..shot.switches import NOTHING

PLAN_VERSION = 3  # of plan.json
MOST_SWITCHES = 100  # that are looked at one after another
SHEET = (24, 24, 24, 255)  # sRGB, between the pictures of a contact sheet


def nobody_seen(counts: Iterable[int]) -> str:
    """Return a sentence if no frame has an agent in sight, else "".

    counts: of the agents that are in sight, or in the file, in each frame.
    """
    return (
        "" if any(counts) else "The camera sees no agent: turn it, or move the crowd by its Center."
    )


def row(number: int, frame: Frame, more: dict[str, float]) -> dict[str, int | float]:
    """Return a row of frames.csv.

    number: of the frame.
    more: milliseconds of stages outside the core, by name.
    """
    people = frame.without_worn(frame.buckets)
    visible = len(people.order)
    counts = {f"lod{k}": int(n) for k, n in enumerate(people.counts)}
    unseen = {
        name: len(frame.without_worn(b).order)
        for name, b in (("shadow", frame.shadow), ("mirrored", frame.mirrored))
        if b is not None
    }
    if frame.hidden is not None:
        unseen["hidden"] = hidden_wholly(frame)
    stages = {f"{name}_ms": round(ms, 3) for name, ms in (frame.milliseconds | more).items()}
    return {
        "frame": number,
        "agents": frame.people,
        "visible": visible,
        "culled": frame.people - visible,
        **counts,
        **unseen,
        "vertices": frame.vertices,
        "triangles": frame.triangles,
        "full_vertices": frame.full_vertices,
        "full_triangles": frame.full_triangles,
        **stages,
    }


def to_csv(rows: list[dict]) -> str:
    """Return the rows, which share their keys, as CSV with a header."""
    text = io.StringIO()
    writer = csv.DictWriter(text, rows[0].keys(), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def largest_switches(path: Path) -> list[dict[str, str]]:
    """Return the MOST_SWITCHES rows of a switches.csv with the largest changes.

    First come the two that the verdict names: the largest switch, and of the frame in which most
    agents appear or vanish the largest of these. The others follow by their change.
    CrowdError if the file cannot be read.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = sorted(csv.DictReader(file), key=_change_of, reverse=True)
        switches = [row for row in rows if row["from"] and row["to"]]
        clipped = [row for row in rows if not (row["from"] and row["to"])]
        counts = Counter(map(_event_of, clipped))
        first = switches[:1]
        if counts:
            most_agents = max(counts.values())
            events = [event for event, count in counts.items() if count == most_agents]
            event = min(events, key=lambda event: (int(event[0]), event[1]))
            first.append(next(row for row in clipped if _event_of(row) == event))
        return [*first, *(row for row in rows if row not in first)][:MOST_SWITCHES]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CrowdError(
            f"The switches {printable(path)} of the shot plan cannot be read ({error}): press "
            f"Plan Shot again."
        ) from None


def _change_of(row: dict[str, str]) -> float:
    return float(row["change_px"])


def _event_of(row: dict[str, str]) -> tuple[str, bool]:
    """Return (the frame, whether the row's agent appears), which many agents may share."""
    return row["frame"], not row["from"]


def switches_csv(switches: np.ndarray) -> str:
    """Return switches.csv: the switches, entries and exits that a viewer may notice.

    switches: (s,) of shot.switches.ROW. The column `from` is empty for an entry, `to` for an exit.
    """
    lines = [
        f"{frame},{agent},{_lod(before)},{_lod(after)},{size:.3f},{change:.3f}\n"
        for frame, agent, before, after, size, change in switches.tolist()
    ]
    return "frame,agent,from,to,size_px,change_px\n" + "".join(lines)


def _lod(level: int) -> str:
    return "" if level == NOTHING else str(level)


def to_json(plan: dict) -> str:
    """Return the plan as JSON with floats unrounded; ValueError at NaN or infinity."""
    return json.dumps(plan, indent=2, allow_nan=False) + "\n"


def shrink(picture: np.ndarray, width: int) -> np.ndarray:
    """Return the picture made smaller by a whole factor, by averaging.

    The factor is the largest that leaves `width` columns or more, at least 1. Rows and columns that
    do not fill a last block are cut off.
    picture: (rows, columns, 4) uint8.
    """
    factor = max(1, picture.shape[1] // width)
    rows, columns = (n // factor for n in picture.shape[:2])
    blocks = picture[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor, 4)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)


def contact_sheet(pictures: list[np.ndarray], columns: int, gap: int = 6) -> np.ndarray:
    """Return one dark sheet with the pictures, read from the top left.

    pictures: each (rows, columns, 4) uint8, bottom row first, as is the sheet.
    columns: pictures side by side.
    gap: pixels between them.
    """
    height, width = (max(p.shape[axis] for p in pictures) for axis in (0, 1))
    rows = -(-len(pictures) // columns)
    sheet = np.zeros((rows * (height + gap) + gap, columns * (width + gap) + gap, 4), np.uint8)
    sheet[:] = SHEET
    for number, picture in enumerate(pictures):
        row, column = divmod(number, columns)
        bottom = (rows - 1 - row) * (height + gap) + gap
        left = column * (width + gap) + gap
        sheet[bottom : bottom + picture.shape[0], left : left + picture.shape[1]] = picture
    return sheet
