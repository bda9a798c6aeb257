"""Edits of a state machine's JSON text, for the editor in the sidebar.

An edit is a function from a text to a text. It changes what was asked and leaves the rest to the
letter. `edited` makes one and keeps it only if the result is a state machine. `Draft` reads a text
for the editor, also one with a mistake.
"""

import colorsys
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from ..errors import CrowdError
from . import json_splices
from .json_reader import FieldError, FieldPath, Reader
from .state_machine import parse

# the usual order of a state's and of a rule's fields
STATE_FIELDS = ("color", "start", "action", "animation", "fade", "after", "then", "on")
RULE_FIELDS = ("next", "move", "speed", "heading")
LABEL_FIELDS = ("color", "spawn")
ROOT_FIELDS = ("$schema", "version", "name", "edge", "labels", "states")
FALLBACK = "#808080"

Edit = Callable[[str], str]
Targets = Sequence[tuple[str, float]]  # states and their weights


@dataclass(frozen=True)
class Draft:
    """What a text says, as far as it can be read.

    root: the text's object; empty where it is not JSON.
    problem: a sentence on its first mistake, "" if it is a state machine.
    path: of the field with the mistake.
    """

    root: dict[str, Any]
    problem: str = ""
    path: FieldPath = ()

    def faulty(self, *path: str | int) -> bool:
        """Return whether the mistake is in the field at `path`."""
        return bool(self.problem and self.path and self.path[: len(path)] == path)

    @property
    def states(self) -> list[str]:
        return list(_table(self.root.get("states")))

    @property
    def labels(self) -> list[str]:
        return list(_table(self.root.get("labels")))

    def state(self, name: str) -> dict[str, Any]:
        return _table(_table(self.root.get("states")).get(name))

    def label(self, name: str) -> dict[str, Any]:
        return _table(_table(self.root.get("labels")).get(name))

    def rows(self, state: str) -> list[str]:
        """Return what a state may answer: "*", then each label, then names that are no labels."""
        rules, labels = _table(self.state(state).get("on")), self.labels
        return ["*", *labels, *(name for name in rules if name != "*" and name not in labels)]

    def has_rule(self, state: str, label: str) -> bool:
        return label in _table(self.state(state).get("on"))

    def rule(self, state: str, label: str) -> dict[str, Any]:
        """Return what the state does on the label: its own rule, or that of '*'."""
        rules = _table(self.state(state).get("on"))
        return _table(rules.get(label, rules.get("*")))

    def targets(self, state: str, label: str | None) -> list[tuple[str, float]]:
        """Return the states that follow, and their weights: on a label, or where None after the timer."""
        value = self.state(state).get("then", state) if label is None else self.rule(state, label).get("next", state)
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
        return Draft(_table(root), str(error), error.path)
    return Draft(root)


def edited(text: str, where: str, edit: Edit) -> str:
    """Return the text after the edit.

    CrowdError if it would then be no state machine; where it is none before, mistakes are
    mended one after the other.
    """
    before = draft(text, where)
    if not before.root:
        raise CrowdError(before.problem)
    try:
        new = edit(text)
    except (LookupError, ValueError):
        if before.problem:  # the edit needs what is not there
            raise CrowdError(before.problem) from None
        raise
    after = draft(new, where)
    if after.problem and not (before.problem and after.root):
        raise CrowdError(after.problem)
    return new


def set_field(path: FieldPath, value: object) -> Edit:
    """Set a field of the machine, of a label or of a state; None removes it."""
    order = {1: ROOT_FIELDS, 3: STATE_FIELDS if path[0] == "states" else LABEL_FIELDS}[len(path)]
    return lambda text: _put_or_drop(text, path, value, order)


def set_timer(state: str, least: float, most: float) -> Edit:
    """Set the seconds until the state ends; a timer that is new leads to the next state of the list."""
    seconds = plain(least) if least == most else [plain(least), plain(most)]
    path = "states", state

    def edit(text: str) -> str:
        machine, text = draft(text, ""), json_splices.put(text, (*path, "after"), seconds, STATE_FIELDS)
        if "then" in machine.state(state):
            return text
        names = machine.states
        following = names[(names.index(state) + 1) % len(names)]
        return json_splices.put(text, (*path, "then"), following, STATE_FIELDS)

    return edit


def drop_timer(state: str) -> Edit:
    def edit(text: str) -> str:
        for field in ("after", "then"):
            text = _put_or_drop(text, ("states", state, field), None, STATE_FIELDS)
        return text

    return edit


def set_targets(state: str, label: str | None, targets: Targets) -> Edit:
    """Set the states that follow on a label, or where None after the timer."""
    names = [name for name, _ in targets]
    if not names:
        raise CrowdError(f"One state must follow {state}: add another before you remove this one.")
    if len(set(names)) < len(names):
        raise CrowdError(f"{max(names, key=names.count)} follows {state} already: change its weight instead.")
    value = names[0] if len(names) == 1 else {name: plain(weight) for name, weight in targets}
    if label is None:
        return set_field(("states", state, "then"), value)
    return _with_rule(state, label, lambda rule: rule | {"next": value}, unless_same=state)


def set_speed(state: str, label: str, speed: float, heading: float) -> Edit:
    """Set meters per second and degrees of a rule, in place of its `move` as well."""
    new = {"speed": plain(speed), "heading": plain(heading)}
    return _with_rule(state, label, lambda rule: {k: v for k, v in rule.items() if k != "move"} | new)


def own_rule(state: str, label: str) -> Edit:
    """Give the state a rule of its own on the label, as that of '*' is."""
    return _with_rule(state, label, lambda rule: rule)


def drop_rule(state: str, label: str) -> Edit:
    """Let the rule of '*' hold on the label."""
    return lambda text: json_splices.without(text, ("states", state, "on", label))


def add_state(name: str) -> Edit:
    """Add a state after the others: it stands, and none starts in it."""

    def edit(text: str) -> str:
        machine = draft(text, "")
        _new_name(name, machine.states, "state")
        own, inner = json_splices.indent_of(text, ("states",)), _inner(text)
        color = json_splices.dumped(_unused_color([machine.state(each).get("color") for each in machine.states]))
        rows = '{"*": {}}' if not inner else f'{{{inner}  "*": {{}}{inner}}}'
        source = f'{{{inner}"color": {color}, "start": 0,{inner or " "}"on": {rows}{own if inner else ""}}}'
        return json_splices.put_source(text, ("states", name), source)

    return edit


def add_label(name: str) -> Edit:
    """Add a label after the others, in a color of its own; states that name every label stand on it."""

    def edit(text: str) -> str:
        machine = draft(text, "")
        _new_name(name, machine.labels, "label")
        taken = [machine.label(each).get("color") for each in machine.labels]
        text = json_splices.put(text, ("labels", name), {"color": _unused_color(taken)})
        for state in machine.states:
            if not machine.has_rule(state, "*"):
                text = json_splices.put(text, ("states", state, "on", name), {})
        return text

    return edit


def duplicate(kind: str, name: str, new: str) -> Edit:
    """Add a copy of the state or label after it. kind: "states" or "labels".

    A label's copy has a color of its own, and states do on it what they do on the first.
    """

    def edit(text: str) -> str:
        machine = draft(text, "")
        taken = machine.states if kind == "states" else machine.labels
        _new_name(new, taken, kind[:-1])
        text = json_splices.copied(text, (kind, name), new)
        if kind == "states":
            return text
        color = _unused_color([machine.label(each).get("color") for each in taken])
        text = json_splices.put(text, ("labels", new, "color"), color, LABEL_FIELDS)
        for state in machine.states:
            if machine.has_rule(state, name):
                text = json_splices.copied(text, ("states", state, "on", name), new)
        return text

    return edit


def rename(kind: str, name: str, new: str) -> Edit:
    """Rename a state or label wherever it is named. kind: "states" or "labels"."""

    def edit(text: str) -> str:
        if new == name:
            return text
        machine = draft(text, "")
        _new_name(new, machine.states if kind == "states" else machine.labels, kind[:-1])
        if kind == "labels":
            keys = [each for each in _fields_of(text) if each[2:] == ("on", name)]
            return json_splices.spliced(text, json_splices.keys_renamed(text, [("labels", name), *keys], new))
        named = _naming(text, name)
        keys = [path for path in named if path[-1] == name]
        values = [path for path in named if path[-1] != name]
        splices = json_splices.keys_renamed(text, [("states", name), *keys], new)
        return json_splices.spliced(text, splices + json_splices.values_replaced(text, values, new))

    return edit


def remove(kind: str, name: str) -> Edit:
    """Remove a state or label, and what names it. kind: "states" or "labels".

    Where the state alone followed, agents stay in their state; a timer that led to it is removed.
    """

    def edit(text: str) -> str:
        text = json_splices.without(text, (kind, name))
        if kind == "labels":
            for path in [each for each in _fields_of(text) if each[2:] == ("on", name)]:
                text = json_splices.without(text, path)
            return text
        for path in _naming(text, name):
            text = json_splices.without(text, path)
        for path in _fields_of(text):  # weights of which none is left
            weights = _value(text, path) if path[-1] in ("next", "then") and len(path) in (3, 5) else None
            if isinstance(weights, dict) and not any(weights.values()):
                text = json_splices.without(text, path)
        for path in _fields_of(text):  # timers whose state is gone
            if len(path) == 3 and path[2] == "after" and "then" not in draft(text, "").state(str(path[1])):
                text = json_splices.without(text, path)
        return text

    return edit


def move(kind: str, name: str, by: int) -> Edit:
    """Move a state or label so many places down the list."""
    return lambda text: json_splices.moved(text, (kind, name), by)


def unused(name: str, taken: Sequence[str]) -> str:
    """Return `name`, or with the first number that makes it a new one."""
    stem = name.rstrip("0123456789").rstrip() or name
    numbered = (f"{stem} {n}" for n in range(2, len(taken) + 3))
    return name if name not in taken else next(each for each in numbered if each not in taken)


def plain(value: float) -> float | int:
    """Return a number as one writes it, to seven digits: Blender's have no more."""
    rounded = float(f"{value:.7g}")
    return int(rounded) if rounded.is_integer() else rounded


def _with_rule(state: str, label: str, change: Callable[[dict[str, Any]], dict[str, Any]], unless_same: str = "") -> Edit:
    """Change the rule of a state on a label, which becomes its own.

    unless_same: a state that need not be named as the next.
    """

    def edit(text: str) -> str:
        rule = change(draft(text, "").rule(state, label))
        if unless_same and rule.get("next") == unless_same:
            del rule["next"]
        ordered = {key: rule[key] for key in (*RULE_FIELDS, *rule) if key in rule}
        return json_splices.put(text, ("states", state, "on", label), ordered, ("*",) if label == "*" else ())

    return edit


def _put_or_drop(text: str, path: FieldPath, value: object, order: Sequence[str]) -> str:
    if value is not None:
        return json_splices.put(text, path, value, order)
    return json_splices.without(text, path) if path in _fields_of(text) else text


def _naming(text: str, state: str) -> list[FieldPath]:
    """Return the fields, deepest last, that name a state to follow.

    These are keys of weights, and values of `next` and `then`.
    """

    def names(path: FieldPath, value: Any) -> bool:
        field = path[:5] if path[2:3] == ("on",) else path[:3]
        if path[:1] != ("states",) or field[-1:] not in (("next",), ("then",)) or len(field) not in (3, 5):
            return False
        return value == state if path == field else len(path) == len(field) + 1 and path[-1] == state

    return json_splices.found(text, names)


def _fields_of(text: str) -> list[FieldPath]:
    return json_splices.found(text, lambda path, _: path[:1] == ("states",))


def _value(text: str, path: FieldPath) -> Any:
    held: Any = draft(text, "").root
    for key in path:
        held = held[key]
    return held


def _new_name(name: str, taken: Sequence[str], kind: str) -> None:
    if not name.strip():
        raise CrowdError(f"A {kind} needs a name: type one.")
    if name == "*" and kind == "label":
        raise CrowdError("'*' stands for every label that is not named: choose another name for the label.")
    if name in taken:
        raise CrowdError(f"There is a {kind} {name} already: choose another name.")


def _inner(text: str) -> str:
    """Return the white space before the fields of the first state."""
    states = draft(text, "").states
    return json_splices.indent_of(text, ("states", states[0])) if states else ""


def _unused_color(taken: Sequence[object]) -> str:
    """Return a color "#rrggbb", far from those taken."""
    known = [bytes.fromhex(each[1:]) for each in taken if isinstance(each, str) and len(each) == 7 and _is_hex(each[1:])]
    tones = [colorsys.hsv_to_rgb(h / 24, s, v) for v in (0.9, 0.6) for s in (0.65, 0.9) for h in range(24)]
    colors = [[round(255 * c) for c in tone] for tone in tones]
    best = max(colors, key=lambda color: min((math.dist(color, other) for other in known), default=0))
    return f"#{bytes(best).hex()}"


def _is_hex(digits: str) -> bool:
    return all(each in "0123456789abcdefABCDEF" for each in digits)


def _table(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e300:
        return 0.0
    return float(value)
