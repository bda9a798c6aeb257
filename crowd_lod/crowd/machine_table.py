"""Reads the states of a state machine's JSON into the arrays of its table."""

import math
from typing import Any

import numpy as np

from .json_reader import Color, FieldPath, Reader
from .paces import BETWEEN

SHORTEST = 0.001  # seconds that a timer runs at least


class MachineTable:
    """The arrays of a state machine of S states and L labels, filled state by state.

    They are those of StateMachine, but:
    colors, start, actions, fade: lists of S.
    odds: cumulative weights -> the row of StateMachine.odds that they become.
    """

    def __init__(self, reader: Reader, states: tuple[str, ...], labels: tuple[str, ...]) -> None:
        self.reader = reader
        self.states = states
        self.labels = labels
        rules = len(states), len(labels)
        self.next_state = np.zeros(rules, np.uint8)
        self.next_choice = np.full(rules, -1, np.int32)
        self.velocity = np.zeros((*rules, 2))
        self.after = np.full((len(states), 2), np.inf)
        self.then = np.arange(len(states), dtype=np.uint8)
        self.then_choice = np.full(len(states), -1, np.int32)
        self.colors: list[Color] = []
        self.start: list[float] = []
        self.actions: list[str] = []
        self.fade: list[float] = []
        self.odds: dict[tuple[float, ...], int] = {}

    def read_state(self, s: int, state: str, entry: object) -> None:
        """Read the `entry` of the state number `s`; CrowdError names what is wrong in it."""
        path = ("states", state)
        fields = {"color", "start", "action", "fade", "after", "then", "on"}
        values = self.reader.table(entry, path, fields)
        self._read_look(values, path)
        self._read_timer(s, values, path)
        self._read_rules(s, state, values, path)

    def _read_look(self, values: dict[str, Any], path: FieldPath) -> None:
        """Read color, start weight, action and fade."""
        reader = self.reader
        self.colors.append(reader.color(values.get("color", "#808080"), (*path, "color")))
        self.start.append(reader.number(values.get("start", 0), (*path, "start"), least=0))
        action = reader.string(values.get("action", ""), (*path, "action"))
        if BETWEEN in action:
            reader.fail(
                (*path, "action"),
                f"is {action!r}; {BETWEEN!r} stands between two actions in names of cross-fades, "
                f"rename it",
            )
        self.actions.append(action)
        self.fade.append(reader.number(values.get("fade", 0), (*path, "fade"), least=0))

    def _read_timer(self, s: int, values: dict[str, Any], path: FieldPath) -> None:
        for field, partner in (("after", "then"), ("then", "after")):
            if field in values and partner not in values:
                problem = f"is missing beside {field}; a timer needs both"
                self.reader.fail((*path, partner), problem)
        if "after" in values:
            self.after[s] = self._seconds(values["after"], (*path, "after"))
            self.then[s], self.then_choice[s] = self._target(values["then"], (*path, "then"))

    def _read_rules(self, s: int, state: str, values: dict[str, Any], path: FieldPath) -> None:
        """Read what the state does on each label."""
        reader = self.reader
        on = (*path, "on")
        entries = reader.table(values.get("on"), on, filled=True)
        rules = {label: self._rule(entry, (*on, label), state) for label, entry in entries.items()}
        for label in entries:
            if label != "*" and label not in self.labels:
                problem = f"names no label; the labels are {', '.join(self.labels)}"
                reader.fail((*on, label), problem)
        for i, label in enumerate(self.labels):
            rule = rules.get(label, rules.get("*"))
            if rule is None:
                reader.fail(
                    on, f"says nothing of the label {label!r}; add it, or '*' for every other label"
                )
            target, velocity = rule
            self.next_state[s, i], self.next_choice[s, i] = target
            self.velocity[s, i] = velocity

    def _rule(
        self, rule: object, path: FieldPath, state: str
    ) -> tuple[tuple[int, int], tuple[float, float]]:
        values = self.reader.table(rule, path, {"next", "move", "speed", "heading"})
        target = self._target(values.get("next", state), (*path, "next"))
        return target, self._velocity(values, path)

    def _target(self, value: object, path: FieldPath) -> tuple[int, int]:
        """Return (state, -1), or for weights (the likeliest state, the row of the odds)."""
        reader = self.reader
        states = f"the states are {', '.join(self.states)}"
        if isinstance(value, str):
            if value not in self.states:
                reader.fail(path, f"is {value!r}; {states}")
            return self.states.index(value), -1
        if not isinstance(value, dict):
            reader.fail(
                path,
                f"is {value!r}, it must be a state, or an object of states and weights; {states}",
            )
        weights = np.zeros(len(self.states))
        for name, weight in reader.table(value, path, filled=True).items():
            if name not in self.states:
                reader.fail((*path, name), f"names no state; {states}")
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
            self.reader.number(seconds, (*path, i), least=SHORTEST)
            for i, seconds in enumerate(value)
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
            cos = math.cos(math.radians(heading))
            sin = math.sin(math.radians(heading))
        return speed * cos, speed * sin
