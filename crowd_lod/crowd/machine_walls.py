"""A wall for a state machine that has none: a label at which agents turn back."""

import math
from typing import Any

from .machine_draft import Draft, Table
from .machine_edits import Edit, add_label, plain, unused_name

WALL = "wall"
BACK = 120.0  # degrees: a state that walks at least so far from another's heading walks back


def add_wall() -> Edit:
    """Add the label WALL, on which nobody starts and states that walk turn back.

    A state turns to the one that walks most nearly the other way, and to a new one where none does.
    """

    def edit(root: Table) -> None:
        add_label(WALL)(root)
        root["labels"][WALL]["spawn"] = False
        for state in list(root["states"]):
            _turn_at_wall(root, state)

    return edit


def _turn_at_wall(root: Table, state: str) -> None:
    draft = Draft(root)
    speed, heading = draft.speed(state, "*")
    if not speed:
        return
    turns = {
        other: _turn(heading, draft.speed(other, "*")[1])
        for other in draft.states
        if draft.speed(other, "*")[0]
    }
    back = max(turns, key=lambda other: turns[other])
    if turns[back] < BACK:
        back = unused_name(f"{state} back", draft.states)
        walk = _walk(speed, heading + 180)
        rules = {"*": walk, WALL: {"next": state, **_walk(speed, heading)}}
        copied = {
            key: root["states"][state][key]
            for key in ("color", "action", "fade")
            if key in root["states"][state]
        }
        root["states"][back] = {**copied, "start": 0, "on": rules}
    root["states"][state]["on"][WALL] = {"next": back, **_walk(*Draft(root).speed(back, "*"))}


def _walk(speed: float, heading: float) -> dict[str, Any]:
    return {"speed": plain(speed), "heading": plain(heading % 360)}


def _turn(heading: float, other: float) -> float:
    """Return the angle between two headings, 0 to 180 degrees."""
    return abs(math.remainder(heading - other, 360))
