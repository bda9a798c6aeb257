"""Two plans side by side: what they were made for, and their costs in total and by frame."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import CrowdError
from ..format import aligned, number, printable
from ..frame.planned import same_cameras
from ..shot import plan_file

# The figures of a frame that are compared, and those of a whole shot, in this order.
IN_FRAMES = ("triangles", "visible", "switches", "switch_pixels")
IN_TOTAL = (
    *IN_FRAMES,
    *(
        "memory_mb",
        "time_share",
        "largest_switch_pixels",
        "largest_deviation_pixels",
        "most_above_optimum",
    ),
)
# For plans without the field made_for: the parts of plan.json that are compared instead.
PARTS = {
    "crowd": "the crowd",
    "machine": "the state machine",
    "camera": "the camera",
    "levels": "the choice of LODs",
}
Numbers = dict[str, float]
MOST_FIGURE = 1e15  # no plan has a greater one; integers of JSON may be greater than any float


@dataclass(frozen=True)
class Plan:
    """A plan as read from plan.json; fields that the file lacks are absent.

    path: of the plan.json.
    numbers: the frames that were planned.
    frames: by frame number, the figures of IN_FRAMES.
    total: the figures of IN_TOTAL.
    content: all of the file.
    """

    path: Path
    numbers: frozenset[int]
    frames: Mapping[int, Numbers]
    total: Numbers
    content: Mapping[str, Any]


@dataclass(frozen=True)
class Comparison:
    """Two plans. differs: what they were made for that is not the same."""

    a: Plan
    b: Plan
    differs: tuple[str, ...]

    @property
    def as_json(self) -> dict[str, Any]:
        """Return plain data: pairs [A's, B's] of all figures that both plans have."""
        common_frames = sorted(self.a.frames.keys() & self.b.frames.keys())
        return {
            "a": printable(self.a.path),
            "b": printable(self.b.path),
            "made_for_differs": list(self.differs),
            "total": _pairs(self.a.total, self.b.total, IN_TOTAL),
            "frames": [
                {"frame": f, **_pairs(self.a.frames[f], self.b.frames[f], IN_FRAMES)}
                for f in common_frames
            ],
            "only_in_a": sorted(self.a.numbers - self.b.numbers),
            "only_in_b": sorted(self.b.numbers - self.a.numbers),
        }

    @property
    def text(self) -> str:
        """Return the comparison as lines of text, with the frames that differ."""
        content = self.as_json
        lines = [f"A: {content['a']}", f"B: {content['b']}"]
        lines += (
            [f"They were made for other input: {', '.join(self.differs)}."] if self.differs else []
        )
        for name in ("only_in_a", "only_in_b"):
            if content[name]:
                frames = _listed(content[name])
                lines.append(f"Only in {name[-1].upper()}: {frames}. They count in its total.")
        rows = [
            (name.replace("_", " "), number(a), number(b), _change(a, b))
            for name, (a, b) in content["total"].items()
        ]
        lines += ["", *aligned(("Total", "A", "B", "B to A"), rows)] if rows else []
        differing_rows = [
            row
            for row in content["frames"]
            if any(row[name][0] != row[name][1] for name in IN_FRAMES if name in row)
        ]
        if differing_rows:
            names = [name for name in IN_FRAMES if any(name in row for row in differing_rows)]
            head = [
                "Frame",
                *(f"{name.replace('_', ' ')} {which}" for name in names for which in "AB"),
            ]
            cells = [
                [
                    str(row["frame"]),
                    *(number(value) for name in names for value in row.get(name, (None, None))),
                ]
                for row in differing_rows
            ]
            lines += ["", *aligned(head, cells)]
        elif content["frames"]:
            count = len(content["frames"])
            lines += [
                "",
                f"All {count} common frames are the same."
                if count > 1
                else "The one common frame is the same.",
            ]
        return "\n".join(lines)


def compare(a: Path, b: Path) -> Comparison:
    """Return two plans side by side; each path is a folder with a plan.json, or that file.

    CrowdError if one of them is none.
    """
    first = read_plan(a)
    second = read_plan(b)
    return Comparison(first, second, tuple(_differs(first, second)))


def read_plan(path: Path) -> Plan:
    """Return the plan in a folder, or in a plan.json; CrowdError if it is none."""
    path = path / "plan.json" if path.is_dir() else path
    where = printable(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CrowdError(
            f"There is no plan {where}: give a folder that crowd-lod plan or preview wrote."
        ) from None
    except (ValueError, RecursionError):
        raise CrowdError(
            f"The plan {where} is not JSON: give a folder that crowd-lod plan or preview wrote."
        ) from None
    if not isinstance(content, dict):
        content = {}
    rows = content.get("frames")
    shot = content.get("shot")
    frames = {}
    for row in rows if isinstance(rows, list) else ():
        if isinstance(row, dict) and type(row.get("frame")) is int:
            frames[row["frame"]] = _numbers(row, IN_FRAMES)
    total = {
        name: math.fsum(row.get(name, 0.0) for row in frames.values()) for name in _common(frames)
    }
    planned: list[Any] = []
    if isinstance(shot, dict):
        planned = shot["frames"] if isinstance(shot.get("frames"), list) else []
        total |= _numbers(shot, IN_TOTAL)
        if isinstance(shot.get("plan"), dict):
            total |= _numbers(shot["plan"], IN_TOTAL)
    if not total:
        raise CrowdError(
            f"The plan {where} has neither frames nor a shot: give a folder that crowd-lod plan "
            f"or preview wrote."
        )
    numbers = frozenset(frames) or frozenset(each for each in planned if type(each) is int)
    return Plan(path, numbers, frames, total, content)


def _common(frames: Mapping[int, Numbers]) -> list[str]:
    """Return the figures that every frame has."""
    return [name for name in IN_FRAMES if frames and all(name in row for row in frames.values())]


def _numbers(table: Mapping[str, Any], names: tuple[str, ...]) -> Numbers:
    """Return those of `names` that are numbers in the table, up to MOST_FIGURE."""
    found = {name: table[name] for name in names if type(table.get(name)) in (int, float)}
    return {name: value for name, value in found.items() if abs(value) <= MOST_FIGURE}


def _differs(a: Plan, b: Plan) -> list[str]:
    """Return what the two plans were made for that is not the same."""
    inputs = [plan.content.get("made_for") for plan in (a, b)]
    a_input, b_input = inputs
    if isinstance(a_input, dict) and isinstance(b_input, dict):
        differences = [
            name for name in {**a_input, **b_input} if a_input.get(name) != b_input.get(name)
        ]
    else:
        differences = [
            words for name, words in PARTS.items() if a.content.get(name) != b.content.get(name)
        ]
    shots = [shot if isinstance(shot := plan.content.get("shot"), dict) else {} for plan in (a, b)]
    differences += [
        f"the {name}"
        for name in ("engine", "tolerance", "budget")
        if shots[0].get(name) != shots[1].get(name)
    ]
    stored = [plan.path.with_name(plan_file.NAME) for plan in (a, b)]
    if all(path.is_file() for path in stored) and not _same_views(*map(plan_file.read, stored)):
        differences.append("the camera")
    return list(dict.fromkeys(map(printable, differences)))


def _same_views(a: plan_file.StoredPlan, b: plan_file.StoredPlan) -> bool:
    """Return whether all frames that both plans have are seen by the same cameras, as wide in
    pixels.
    """
    place = {number: f for f, number in enumerate(b.numbers.tolist())}
    pairs = [
        (a.cameras[f], b.cameras[place[number]])
        for f, number in enumerate(a.numbers.tolist())
        if number in place
    ]
    return all(same_cameras(one, other) and same_cameras(other, one) for one, other in pairs)


def _pairs(a: Numbers, b: Numbers, names: tuple[str, ...]) -> dict[str, list[float]]:
    return {name: [a[name], b[name]] for name in names if name in a and name in b}


def _listed(frames: list[int]) -> str:
    return (
        f"frame {frames[0]}"
        if len(frames) == 1
        else f"{len(frames)} frames from {frames[0]} to {frames[-1]}"
    )


def _change(a: float, b: float) -> str:
    return f"{b / a - 1:+.1%}" if a else "" if a == b else "new"
