"""The finite state machine as a table (chapter section 1.2), read from JSON.

    {"version": 1, "name": "...", "edge": "clamp",
     "labels": {"ground": {"color": "#808080"}, "wall": {"color": "#202020", "spawn": false}, ...},
     "states": {"walk": {"color": "#ff8000", "start": 1,
                         "on": {"*": {"move": [1.25, 0]},
                                "wall": {"next": "turn", "speed": 1.25, "heading": 180}}}, ...}}

`move` is a velocity in metres per second along x and y; `speed` (m/s) and `heading` (degrees, 0 = +x, counter-clockwise)
say the same. `next` is the state after the step, the same state if left out. `*` stands for every label not named.
`start` weighs a state in the first frame's draw; `spawn: false` keeps the first positions off a label.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .errors import CrowdError

EDGES = ("clamp", "wrap", "reflect", "stop")
PRESETS = Path(__file__).parent / "presets"


@dataclass(frozen=True)
class StateMachine:
    """A complete table: every state × label has a next state and a velocity.

    next_state: (S, L) uint8; velocity: (S, L, 2) float64, m/s along x and y; start: (S,) float64, sums to 1;
    spawn: (L,) bool; label_colours: (L, 3) uint8; state_colours: (S, 3) uint8; edge: one of EDGES; text: its JSON.
    """

    name: str
    states: tuple[str, ...]
    labels: tuple[str, ...]
    next_state: np.ndarray
    velocity: np.ndarray
    start: np.ndarray
    spawn: np.ndarray
    label_colours: np.ndarray
    state_colours: np.ndarray
    edge: str
    text: str

    @property
    def moves(self) -> bool:
        """Whether any agent can ever move."""
        return bool(self.velocity.any())


def load_preset(name: str) -> StateMachine:
    """The state machine that ships under this name."""
    return parse(preset_text(name), f"preset {name}")


def preset_text(name: str) -> str:
    """The JSON of a state machine that ships with Crowd LOD."""
    path = PRESETS / f"{name}.json"
    if not path.is_file():
        raise CrowdError(f"There is no state machine {name!r}; there are {', '.join(preset_names())}.")
    return path.read_text(encoding="utf-8")


def preset_names() -> list[str]:
    """Names of the state machines that ship with Crowd LOD."""
    return sorted(path.stem for path in PRESETS.glob("*.json"))


def parse(text: str, where: str) -> StateMachine:
    """The machine that the JSON `text` from `where` describes; CrowdError names the line or the field that is wrong."""
    try:
        root = json.loads(text)
    except json.JSONDecodeError as error:
        raise CrowdError(
            f"The state machine {where} is not JSON: line {error.lineno}, column {error.colno}: {error.msg}."
        ) from None
    reader = _Reader(where)
    root = reader.table(root, "", {"version", "name", "edge", "labels", "states"})
    if root.get("version") != 1:
        reader.fail("version", f"is {root.get('version')!r}, this Crowd LOD reads version 1")
    edge = root.get("edge", "clamp")
    if edge not in EDGES:
        reader.fail("edge", f"is {edge!r}, it must be one of {', '.join(EDGES)}")

    label_tables = reader.table(root.get("labels"), "labels", filled=True)
    labels = tuple(label_tables)
    label_colours, spawn = [], []
    for label, entry in label_tables.items():
        field = f"labels.{label}"
        entry = reader.table(entry, field, {"color", "spawn"})
        label_colours.append(reader.colour(entry.get("color"), f"{field}.color"))
        spawn.append(reader.boolean(entry.get("spawn", True), f"{field}.spawn"))
    if len(set(label_colours)) < len(labels):
        reader.fail("labels", "gives two labels the same color, a map could not tell them apart")

    state_tables = reader.table(root.get("states"), "states", filled=True)
    states = tuple(state_tables)
    next_state = np.zeros((len(states), len(labels)), np.uint8)
    velocity = np.zeros((len(states), len(labels), 2))
    state_colours, start = [], []
    for s, (state, entry) in enumerate(state_tables.items()):
        field = f"states.{state}"
        entry = reader.table(entry, field, {"color", "start", "on"})
        state_colours.append(reader.colour(entry.get("color", "#808080"), f"{field}.color"))
        start.append(reader.number(entry.get("start", 0), f"{field}.start", least=0))
        rules = reader.table(entry.get("on"), f"{field}.on", filled=True)
        for label in rules:
            if label != "*" and label not in labels:
                reader.fail(f"{field}.on.{label}", f"names no label; the labels are {', '.join(labels)}")
        for i, label in enumerate(labels):
            named = label if label in rules else "*"
            if named not in rules:
                reader.fail(f"{field}.on", f"says nothing of the label {label!r}; add it, or '*' for every other label")
            rule = reader.table(rules[named], f"{field}.on.{named}", {"next", "move", "speed", "heading"})
            following = rule.get("next", state)
            if following not in states:
                reader.fail(f"{field}.on.{named}.next", f"is {following!r}; the states are {', '.join(states)}")
            next_state[s, i] = states.index(following)
            velocity[s, i] = reader.velocity(rule, f"{field}.on.{named}")
    if not sum(start):
        start = [1.0] * len(states)
    if not any(spawn):
        reader.fail("labels", "leaves no label where agents may start: set spawn to true on one")
    return StateMachine(
        name=str(root.get("name", where)),
        states=states,
        labels=labels,
        next_state=next_state,
        velocity=velocity,
        start=np.array(start) / sum(start),
        spawn=np.array(spawn),
        label_colours=np.array(label_colours, np.uint8),
        state_colours=np.array(state_colours, np.uint8),
        edge=edge,
        text=text,
    )


class _Reader:
    """Checks one field at a time and names it when it is wrong."""

    def __init__(self, where: str):
        self.where = where

    def fail(self, field: str, problem: str):
        raise CrowdError(f"The state machine {self.where}: {field or 'the file'} {problem}.")

    def table(self, value, field: str, allowed: set[str] | None = None, filled: bool = False) -> dict:
        if not isinstance(value, dict):
            self.fail(field, "must be an object, { ... }" + ("" if value is not None else "; it is missing"))
        if filled and not 0 < len(value) <= 255:
            self.fail(field, f"must hold 1 to 255 entries, it holds {len(value)}")
        unknown = sorted(set(value) - allowed) if allowed is not None else []
        if unknown:
            self.fail(f"{field}.{unknown[0]}".lstrip("."), f"is not known here; known are {', '.join(sorted(allowed))}")
        return value

    def number(self, value, field: str, least: float = -math.inf) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value < math.inf:
            bound = f" of at least {least:g}" if least > -math.inf else ""
            self.fail(field, f"is {value!r}, it must be a finite number{bound}")
        return float(value)

    def boolean(self, value, field: str) -> bool:
        if not isinstance(value, bool):
            self.fail(field, f"is {value!r}, it must be true or false")
        return value

    def colour(self, value, field: str) -> tuple[int, int, int]:
        try:
            if not (isinstance(value, str) and len(value) == 7 and value[0] == "#"):
                raise ValueError
            return tuple(bytes.fromhex(value[1:]))
        except ValueError:
            self.fail(field, f"is {value!r}, it must be a color such as \"#ff8000\"")

    def velocity(self, rule: dict, field: str) -> tuple[float, float]:
        if "move" in rule and ("speed" in rule or "heading" in rule):
            self.fail(field, "gives both move and speed or heading; give one")
        if "move" in rule:
            move = rule["move"]
            if not isinstance(move, list) or len(move) != 2:
                self.fail(f"{field}.move", f"is {move!r}, it must be two numbers, metres per second along x and y")
            return tuple(self.number(value, f"{field}.move") for value in move)
        speed = self.number(rule.get("speed", 0), f"{field}.speed", least=0)
        if speed and "heading" not in rule:
            self.fail(f"{field}.heading", "is missing beside speed; give degrees, 0 = +x, counter-clockwise")
        heading = math.radians(self.number(rule.get("heading", 0), f"{field}.heading"))
        return speed * math.cos(heading), speed * math.sin(heading)
