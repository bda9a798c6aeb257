"""The finite state machine as a table (chapter section 1.2), read from JSON.

    {"version": 1, "name": "...", "edge": "clamp",
     "labels": {"ground": {"color": "#808080"}, "wall": {"color": "#202020", "spawn": false}, ...},
     "states": {"walk": {"color": "#ff8000", "start": 1, "action": "walk",
                         "after": [5, 20], "then": {"rest": 1, "walk": 3},
                         "on": {"*": {"move": [1.25, 0]},
                                "wall": {"next": "turn", "speed": 1.25, "heading": 180}}}, ...}}

`move`: velocity along x and y, meters per second. `speed` (m/s) and `heading` (degrees, 0 = +x,
    counter-clockwise) say the same.
`next`: the state after the step; the same state if left out. An object of states and weights draws
    one, once each time the agent enters the label or the state.
`*`: every label that is not named.
`after`: seconds until the state ends, or two numbers to draw the time between.
`then`: the state that follows when it ends, or an object of states and weights.
`action`: the name of the action that agents in the state play; their group's own if left out.
`fade`: seconds in which agents who come into the state pass over to its action; 0 if left out.
`start`: the weight of the state in the draw for the first frame.
`spawn`: false keeps the first positions off a label.

presets/schema.json describes the same as a JSON Schema, for editors.
"""

import json
import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ..errors import CrowdError
from . import random_streams
from .json_reader import Color, Reader
from .machine_table import MachineTable
from .paces import Paces, paces_of

EDGES = ("clamp", "wrap", "reflect", "stop")
PRESETS = Path(__file__).parent / "presets"
SCHEMA = PRESETS / "schema.json"


@dataclass(frozen=True)
class StateMachine:
    """A complete table: every state × label has a next state and a velocity.

    next_state: (S, L) uint8.
    velocity: (S, L, 2) float64, along x and y: m/s as parsed, see in_units.
    start: (S,) float64, sums to 1.
    spawn: (L,) bool.
    label_colors: (L, 3) uint8.
    state_colors: (S, 3) uint8.
    edge: one of EDGES.
    text: its JSON.
    actions: S names, "" where the groups' own action is played.
    fade: (S,) float64, seconds of the cross-fade into each state's action; 0 without.
    after: (S, 2) float64, least and greatest seconds in the state; inf without a timer.
    then: (S,) uint8, the state that follows the timer.
    odds: (R, S) float64, the cumulative weights of R random choices; each row ends in 1.
    next_choice: (S, L) int32, the row of `odds` that replaces next_state; -1 for none.
    then_choice: (S,) int32, the row of `odds` that replaces then; -1 for none.
    """

    name: str
    states: tuple[str, ...]
    labels: tuple[str, ...]
    next_state: np.ndarray
    velocity: np.ndarray
    start: np.ndarray
    spawn: np.ndarray
    label_colors: np.ndarray
    state_colors: np.ndarray
    edge: str
    text: str
    actions: tuple[str, ...]
    fade: np.ndarray
    after: np.ndarray
    then: np.ndarray
    odds: np.ndarray
    next_choice: np.ndarray
    then_choice: np.ndarray

    def in_units(self, meters: float) -> "StateMachine":
        """Return the same table with velocities in units of `meters` a second."""
        return self if meters == 1 else replace(self, velocity=self.velocity / meters)

    @property
    def content(self) -> str:
        """Its JSON, the same for every layout of the text."""
        return json.dumps(json.loads(self.text))

    @property
    def moves(self) -> bool:
        """Whether any agent can ever move."""
        return bool(self.velocity.any())

    @cached_property
    def paces(self) -> Paces:
        """The actions of the table at its speeds, and the steps of cross-fades: see paces_of."""
        pairs = {
            (self.actions[s], self.actions[t]) for s, t in zip(*np.nonzero(self.fades), strict=True)
        }
        speed = np.hypot(self.velocity[..., 0], self.velocity[..., 1])
        return paces_of(self.actions, speed, self.edge == "stop", pairs)

    @cached_property
    def follows(self) -> np.ndarray:
        """(S, S) bool: which states may follow each one at once, by a label or by its timer."""
        follows = np.zeros((len(self.states),) * 2, bool)
        likely = np.diff(self.odds, axis=1, prepend=0) > 0
        timed = np.isfinite(self.after).any(axis=1)[:, None]
        by_label = self.next_state, self.next_choice, True
        by_timer = self.then[:, None], self.then_choice[:, None], timed
        for next_state, choice, holds in (by_label, by_timer):
            state, rule = np.nonzero((choice < 0) & holds)
            follows[state, next_state[state, rule]] = True
            state, rule = np.nonzero((choice >= 0) & holds)
            np.logical_or.at(follows, state, likely[choice[state, rule]])
        return follows

    @cached_property
    def fades(self) -> np.ndarray:
        """(S, S) bool: from which states to which agents cross-fade.

        They do so to another action, in a state with a fade.
        """
        return self.follows & (self.fade > 0) & ~self._alike

    @cached_property
    def fading(self) -> np.ndarray:
        """(S,) float64: seconds of a cross-fade that goes on in a state.

        A state without a fade of its own has the longest of the states with its action.
        """
        return np.where(self.fade > 0, self.fade, (self._alike * self.fade).max(axis=1))

    @cached_property
    def _alike(self) -> np.ndarray:
        """(S, S) bool: which states play the same action."""
        return np.array([[action == other for other in self.actions] for action in self.actions])

    @cached_property
    def timed(self) -> bool:
        """Whether any state has a timer."""
        return bool(np.isfinite(self.after).any())

    @cached_property
    def chancy(self) -> bool:
        """Whether anything that agents do after the first frame is drawn at random."""
        return bool(len(self.odds) or (self.after[:, 0] < self.after[:, 1]).any())

    def following(self, state: np.ndarray, label: np.ndarray, key: np.ndarray) -> np.ndarray:
        """Return the next states (n,) uint8 of agents in `state` on `label`.

        state, label, key: (n,) each.
        """
        return self._drawn(
            self.next_state[state, label],
            self.next_choice,
            (state, label),
            key,
            random_streams.STATE,
        )

    def timed_out(self, state: np.ndarray, key: np.ndarray) -> np.ndarray:
        """Return the states (n,) uint8 that follow when the timers of `state` end.

        state, key: (n,) each.
        """
        return self._drawn(self.then[state], self.then_choice, (state,), key, random_streams.THEN)

    def waits(self, state: np.ndarray, key: np.ndarray) -> np.ndarray:
        """Return the seconds (n,) float64 that agents have in `state`.

        Infinite without a timer.
        state, key: (n,) each.
        """
        least, most = self.after[state].T
        if not self.timed:
            return least.copy()
        spread = np.subtract(most, least, where=least < most, out=np.zeros(len(least)))
        return least + spread * random_streams.uniform(key, random_streams.TIME)

    def _drawn(
        self,
        certain: np.ndarray,
        choices: np.ndarray,
        place: tuple[np.ndarray, ...],
        key: np.ndarray,
        stream: np.uint64,
    ) -> np.ndarray:
        if len(self.odds):
            choice = choices[place]
            random = np.flatnonzero(choice >= 0)
            draws = random_streams.uniform(key[random], stream)
            certain[random] = (draws[:, None] >= self.odds[choice[random]]).sum(axis=1)
        return certain


def load_preset(name: str) -> StateMachine:
    """Return the state machine that ships under this name."""
    return parse(preset_text(name), f"preset {name}")


def preset_text(name: str) -> str:
    """Return the JSON of a state machine that ships with Crowd LOD.

    CrowdError if none has this name.
    """
    if name not in preset_names():
        raise CrowdError(
            f"There is no state machine {name!r}; there are {', '.join(preset_names())}."
        )
    return (PRESETS / f"{name}.json").read_text(encoding="utf-8")


def preset_names() -> list[str]:
    """Return the names of the state machines that ship with Crowd LOD."""
    return sorted(path.stem for path in PRESETS.glob("*.json") if path != SCHEMA)


def parse(text: str, where: str) -> StateMachine:
    """Return the state machine that the JSON `text` describes.

    where: the name of the text in messages.
    CrowdError names the line and the field that is wrong.
    """
    reader = Reader(text, f"The state machine {where}")
    root = reader.table(reader.root, (), {"$schema", "version", "name", "edge", "labels", "states"})
    if isinstance(root.get("version"), bool) or root.get("version") != 1:
        reader.fail(
            ("version",), f"is {json.dumps(root.get('version'))}, this Crowd LOD reads version 1"
        )
    edge = root.get("edge", "clamp")
    if edge not in EDGES:
        reader.fail(("edge",), f"is {edge!r}, it must be one of {', '.join(EDGES)}")
    labels, label_colors, spawn = _read_labels(reader, root.get("labels"))
    entries = reader.table(root.get("states"), ("states",), filled=True)
    states = tuple(entries)
    table = MachineTable(reader, states, labels)
    for s, (state, entry) in enumerate(entries.items()):
        table.read_state(s, state, entry)
    start = table.start if any(table.start) else [1.0] * len(states)
    if sum(start) == math.inf:
        reader.fail(
            ("states",),
            "have start weights that sum to more than a number can hold; make them smaller",
        )
    return StateMachine(
        name=reader.string(root.get("name", where), ("name",)),
        states=states,
        labels=labels,
        next_state=table.next_state,
        velocity=table.velocity,
        start=np.array(start) / sum(start),
        spawn=np.array(spawn),
        label_colors=np.array(label_colors, np.uint8),
        state_colors=np.array(table.colors, np.uint8),
        edge=edge,
        text=text,
        actions=tuple(table.actions),
        fade=np.array(table.fade, float),
        after=table.after,
        then=table.then,
        odds=np.array(list(table.odds), float).reshape(-1, len(states)),
        next_choice=table.next_choice,
        then_choice=table.then_choice,
    )


def _read_labels(reader: Reader, value: object) -> tuple[tuple[str, ...], list[Color], list[bool]]:
    """Return the names of the labels, their colors, and whether agents may spawn on each."""
    entries = reader.table(value, ("labels",), filled=True)
    labels = tuple(entries)
    colors: list[Color] = []
    spawn: list[bool] = []
    for label, entry in entries.items():
        path = ("labels", label)
        fields = reader.table(entry, path, {"color", "spawn"})
        color = reader.color(fields.get("color"), (*path, "color"))
        if color in colors:
            twin = labels[colors.index(color)]
            reader.fail(
                (*path, "color"),
                f"is the same color as that of {twin!r}, a map could not tell them apart",
            )
        colors.append(color)
        spawn.append(reader.boolean(fields.get("spawn", True), (*path, "spawn")))
    if not any(spawn):
        reader.fail(("labels",), "leaves no label where agents may spawn: set spawn to true on one")
    return labels, colors, spawn
