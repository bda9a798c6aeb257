"""A wall for a state machine that has none: a label at which agents turn back."""

import math
from collections.abc import Sequence
from typing import Any

from .machine_draft import Draft, Table
from .machine_edits import Edit, add_label, plain, unused_name

WALL = "wall"
LOOKS = "color", "action", "fade"  # of a state, what it shows
BACK = 120.0  # degrees: a state that walks at least so far from another's heading walks back


def add_wall() -> Edit:
    """Add the label WALL, on which nobody starts and states that walk turn back.

    A state turns to the one that walks most nearly the other way, and to a new one where none does.
    In between is a state that walks out of the wall whatever it comes to: at the wall's border two
    states that turn to each other would do so without end.
    """

    def edit(root: Table) -> None:
        add_label(WALL)(root)
        root["labels"][WALL]["spawn"] = False
        draft = Draft(root)
        walking = [state for state in draft.states if draft.speed(state, "*")[0]]
        pairs = {state: _opposite(root, state, walking) for state in walking}
        pairs |= {back: state for state, back in pairs.items() if back not in walking}
        for state, back in pairs.items():
            rule = {"next": _leaving(root, back), **_walk(*Draft(root).speed(back, "*"))}
            root["states"][state]["on"][WALL] = rule

    return edit


def _opposite(root: Table, state: str, walking: Sequence[str]) -> str:
    """Return the state of those `walking` that walks the other way; a new one if none does."""
    draft = Draft(root)
    speed, heading = draft.speed(state, "*")
    back = max(walking, key=lambda other: _turn(heading, draft.speed(other, "*")[1]))
    if _turn(heading, draft.speed(back, "*")[1]) >= BACK:
        return back
    return _add_state(root, f"{state} back", state, {"*": _walk(speed, heading + 180)})


def _leaving(root: Table, state: str) -> str:
    """Return the state that walks out of a wall as `state` does, and is that one then."""
    name = f"{state} off {WALL}"
    walk = _walk(*Draft(root).speed(state, "*"))
    if name not in root["states"]:
        _add_state(root, name, state, {"*": {"next": state, **walk}, WALL: walk})
    return name


def _add_state(root: Table, name: str, like: str, rules: Table) -> str:
    """Add a state in which nobody starts, with color and action of another; return its name."""
    appearance = {key: root["states"][like][key] for key in LOOKS if key in root["states"][like]}
    name = unused_name(name, list(root["states"]))
    root["states"][name] = {**appearance, "start": 0, "on": rules}
    return name


def _walk(speed: float, heading: float) -> dict[str, Any]:
    return {"speed": plain(speed), "heading": plain(heading % 360)}


def _turn(heading: float, other: float) -> float:
    """Return the angle between two headings, 0 to 180 degrees."""
    return abs(math.remainder(heading - other, 360))
