"""Reads the states of a state machine's JSON into the arrays of its table."""

import math
from typing import Any

import numpy as np

from .json_reader import Color, FieldPath, Reader
from .paces import BETWEEN

SHORTEST = 0.001  # seconds that a timer runs at least


class MachineTable:
    """The arrays of a state machine, filled state by state."""

    def __init__(self, reader: Reader, states: tuple[str, ...], labels: tuple[str, ...]) -> None:
        self.reader, self.states, self.labels = reader, states, labels
        shape = len(states), len(labels)
        self.next_state, self.velocity = np.zeros(shape, np.uint8), np.zeros((*shape, 2))
        self.next_choice, self.then_choice = (
            np.full(shape, -1, np.int32),
            np.full(shape[0], -1, np.int32),
        )
        self.after, self.then = np.full((shape[0], 2), np.inf), np.arange(shape[0], dtype=np.uint8)
        self.colors: list[Color] = []
        self.start: list[float] = []
        self.actions: list[str] = []
        self.fade: list[float] = []
        self.odds: dict[tuple[float, ...], int] = {}  # cumulative weights -> their row

    def read_state(self, s: int, state: str, entry: object) -> None:
        reader, path = self.reader, ("states", state)
        given = reader.table(
            entry, path, {"color", "start", "action", "fade", "after", "then", "on"}
        )
        self.colors.append(reader.color(given.get("color", "#808080"), (*path, "color")))
        self.start.append(reader.number(given.get("start", 0), (*path, "start"), least=0))
        self.actions.append(reader.string(given.get("action", ""), (*path, "action")))
        if BETWEEN in self.actions[-1]:
            reader.fail(
                (*path, "action"),
                f"is {self.actions[-1]!r}; {BETWEEN!r} stands between two actions in names of "
                f"cross-fades, rename it",
            )
        self.fade.append(reader.number(given.get("fade", 0), (*path, "fade"), least=0))
        for one, other in (("after", "then"), ("then", "after")):
            if one in given and other not in given:
                reader.fail((*path, other), f"is missing beside {one}; a timer needs both")
        if "after" in given:
            self.after[s] = self._seconds(given["after"], (*path, "after"))
            self.then[s], self.then_choice[s] = self._target(given["then"], (*path, "then"))
        on = (*path, "on")
        rules = reader.table(given.get("on"), on, filled=True)
        read = {name: self._rule(rule, (*on, name), state) for name, rule in rules.items()}
        for label in rules:
            if label != "*" and label not in self.labels:
                reader.fail(
                    (*on, label), f"names no label; the labels are {', '.join(self.labels)}"
                )
        for i, label in enumerate(self.labels):
            rule = read.get(label, read.get("*"))
            if rule is None:
                reader.fail(
                    on, f"says nothing of the label {label!r}; add it, or '*' for every other label"
                )
            (self.next_state[s, i], self.next_choice[s, i]), self.velocity[s, i] = rule

    def _rule(
        self, rule: object, path: FieldPath, state: str
    ) -> tuple[tuple[int, int], tuple[float, float]]:
        given = self.reader.table(rule, path, {"next", "move", "speed", "heading"})
        return self._target(given.get("next", state), (*path, "next")), self._velocity(given, path)

    def _target(self, value: object, path: FieldPath) -> tuple[int, int]:
        """Return (state, -1), or for weights (the likeliest state, the row of the odds)."""
        reader, known = self.reader, f"the states are {', '.join(self.states)}"
        if isinstance(value, str):
            if value not in self.states:
                reader.fail(path, f"is {value!r}; {known}")
            return self.states.index(value), -1
        if not isinstance(value, dict):
            reader.fail(
                path,
                f"is {value!r}, it must be a state, or an object of states and weights; {known}",
            )
        weights = np.zeros(len(self.states))
        for name, weight in reader.table(value, path, filled=True).items():
            if name not in self.states:
                reader.fail((*path, name), f"names no state; {known}")
            weights[self.states.index(name)] = reader.number(weight, (*path, name), least=0)
        if not 0 < weights.sum() < math.inf:
            reader.fail(
                path, f"has weights that sum to {weights.sum():g}; give one state a weight above 0"
            )
        cumulative = np.cumsum(weights / weights.sum())
        # what rounding leaves must not fall to a state of weight 0
        cumulative[np.flatnonzero(weights)[-1] :] = 1
        return int(weights.argmax()), self.odds.setdefault(tuple(cumulative), len(self.odds))

    def _seconds(self, value: object, path: FieldPath) -> tuple[float, float]:
        if not isinstance(value, list):
            seconds = self.reader.number(value, path, least=SHORTEST)
            return seconds, seconds
        if len(value) != 2:
            self.reader.fail(
                path,
                f"is {value!r}, it must be seconds, or the least and the greatest of them, [5, 20]",
            )
        least, most = (
            self.reader.number(each, (*path, i), least=SHORTEST) for i, each in enumerate(value)
        )
        if least > most:
            self.reader.fail(path, f"is {value!r}, the first must be the lesser")
        return least, most

    def _velocity(self, rule: dict[str, Any], path: FieldPath) -> tuple[float, float]:
        reader = self.reader
        if "move" in rule and ("speed" in rule or "heading" in rule):
            reader.fail(path, "gives both move and speed or heading; give one")
        if "move" in rule:
            move = rule["move"]
            if not isinstance(move, list) or len(move) != 2:
                reader.fail(
                    (*path, "move"),
                    f"is {move!r}, it must be two numbers, meters per second along x and y",
                )
            x, y = (reader.number(value, (*path, "move", i)) for i, value in enumerate(move))
            return x, y
        speed = reader.number(rule.get("speed", 0), (*path, "speed"), least=0)
        if speed and "heading" not in rule:
            reader.fail(
                (*path, "heading"),
                "is missing beside speed; give degrees, 0 = +x, counter-clockwise",
            )
        heading = reader.number(rule.get("heading", 0), (*path, "heading"))
        if heading % 90 == 0:  # without rounding: who walks along a wall does not drift into it
            cos, sin = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(heading % 360 // 90)]
        else:
            cos, sin = math.cos(math.radians(heading)), math.sin(math.radians(heading))
        return speed * cos, speed * sin
