"""What a state machine's JSON text says, as far as it can be read, for the sidebar's editor."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from ..errors import CrowdError
from .json_reader import FieldError, FieldPath, Reader
from .state_machine import parse

Table = dict[str, Any]


@dataclass(frozen=True)
class Draft:
    """What a text says, as far as it can be read.

    root: the text's object; empty where it is not JSON.
    problem: a sentence on its first mistake, "" if it is a state machine.
    path: of the field with the mistake.
    """

    root: Table
    problem: str = ""
    path: FieldPath = ()

    def faulty(self, *path: str | int) -> bool:
        """Return whether the mistake is in the field at `path`."""
        return bool(self.problem and self.path and self.path[: len(path)] == path)

    @property
    def states(self) -> list[str]:
        return list(table_of(self.root.get("states")))

    @property
    def labels(self) -> list[str]:
        return list(table_of(self.root.get("labels")))

    def state(self, name: str) -> Table:
        return table_of(table_of(self.root.get("states")).get(name))

    def label(self, name: str) -> Table:
        return table_of(table_of(self.root.get("labels")).get(name))

    def rows(self, state: str) -> list[str]:
        """Return what a state may answer: "*", then each label, then names that are no labels."""
        rules = table_of(self.state(state).get("on"))
        labels = self.labels
        return ["*", *labels, *(name for name in rules if name != "*" and name not in labels)]

    def has_rule(self, state: str, label: str) -> bool:
        return label in table_of(self.state(state).get("on"))

    def rule(self, state: str, label: str) -> Table:
        """Return what the state does on the label: its own rule, or that of '*'."""
        rules = table_of(self.state(state).get("on"))
        return table_of(rules.get(label, rules.get("*")))

    def targets(self, state: str, label: str | None) -> list[tuple[str, float]]:
        """Return the states that follow and their weights.

        label: on which they follow; None for those after the timer.
        """
        if label is None:
            value = self.state(state).get("then", state)
        else:
            value = self.rule(state, label).get("next", state)
        if isinstance(value, dict):
            return [(name, _number(weight)) for name, weight in value.items()]
        return [(value if isinstance(value, str) else state, 1.0)]

    def speed(self, state: str, label: str) -> tuple[float, float]:
        """Return (meters per second, degrees counter-clockwise from +x) of a rule."""
        rule = self.rule(state, label)
        move = rule.get("move")
        if isinstance(move, list) and len(move) == 2:
            x, y = map(_number, move)
            return math.hypot(x, y), math.degrees(math.atan2(y, x)) % 360
        return _number(rule.get("speed")), _number(rule.get("heading"))

    def timer(self, state: str) -> tuple[float, float] | None:
        """Return the least and the greatest seconds in the state, None without a timer."""
        after = self.state(state).get("after")
        if isinstance(after, list) and len(after) == 2:
            return _number(after[0]), _number(after[1])
        return None if after is None else (_number(after), _number(after))


@lru_cache(maxsize=8)
def draft(text: str, where: str) -> Draft:
    """Return what the text called `where` says, with its first mistake."""
    try:
        root = Reader(text, f"The state machine {where}").root
    except CrowdError as error:
        return Draft({}, str(error), getattr(error, "path", ()))
    try:
        parse(text, where)
    except FieldError as error:
        return Draft(table_of(root), str(error), error.path)
    return Draft(root)


def table_of(value: object) -> Table:
    """Return the value if it is an object, else an empty one."""
    return value if isinstance(value, dict) else {}


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e300:
        return 0.0
    return float(value)
