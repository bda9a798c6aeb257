"""Edits of a state machine's JSON text, for the editor in the sidebar.

An edit changes the object that the text says; the object is then written again, in one layout for
all. `edit_text` makes an edit and keeps it only if the result is a state machine.
"""

import colorsys
import copy
import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from ..errors import CrowdError
from .json_reader import FieldPath
from .machine_draft import Draft, Table, draft, table_of

# the usual order of a state's and of a rule's fields
STATE_FIELDS = ("color", "start", "action", "fade", "after", "then", "on")
RULE_FIELDS = ("next", "move", "speed", "heading")
LABEL_FIELDS = ("color", "spawn")
ROOT_FIELDS = ("$schema", "version", "name", "edge", "labels", "states")
FALLBACK = "#808080"
COLUMNS = 120  # an object that fits into so many is written in one line

Edit = Callable[[Table], None]  # changes the object of a machine in place
Targets = Sequence[tuple[str, float]]  # states and their weights


def edit_text(text: str, where: str, edit: Edit) -> str:
    """Return the text after the edit, in the layout of `layout`; as it is if nothing changes.

    CrowdError if it would then be no state machine; where it is none before, mistakes are
    mended one after the other.
    """
    before = draft(text, where)
    if not before.root:
        raise CrowdError(before.problem)
    root = copy.deepcopy(before.root)
    try:
        edit(root)
    except (LookupError, ValueError, TypeError, AttributeError):
        if before.problem:  # the edit needs what is not there
            raise CrowdError(before.problem) from None
        raise
    new = layout(root)
    if new == layout(before.root):
        return text
    after = draft(new, where)
    if after.problem and not (before.problem and after.root):
        raise CrowdError(after.problem)
    return new


def layout(root: Table) -> str:
    """Return the object as JSON: a line a field, but what fits into COLUMNS in one line."""
    return _lines(root, "", 0) + "\n"


def set_field(path: FieldPath, value: object) -> Edit:
    """Set a field of the machine, of a label or of a state; None removes it."""
    order = {1: ROOT_FIELDS, 3: STATE_FIELDS if path[0] == "states" else LABEL_FIELDS}[len(path)]
    *parents, key = map(str, path)

    def edit(root: Table) -> None:
        table = root
        for parent in parents:
            table = table[parent]
        if value is None:
            table.pop(key, None)
        else:
            _put(table, key, value, order)

    return edit


def set_timer(state: str, least: float, most: float) -> Edit:
    """Set the seconds until the state ends.

    A timer that is new leads to the next state of the list.
    """

    def edit(root: Table) -> None:
        table = root["states"][state]
        seconds = plain(least) if least == most else [plain(least), plain(most)]
        _put(table, "after", seconds, STATE_FIELDS)
        if "then" not in table:
            names = list(root["states"])
            following = names[(names.index(state) + 1) % len(names)]
            _put(table, "then", following, STATE_FIELDS)

    return edit


def drop_timer(state: str) -> Edit:
    return lambda root: _drop_timer(root["states"][state])


def set_targets(state: str, label: str | None, targets: Targets) -> Edit:
    """Set the states that follow on a label, or where None after the timer."""
    names = [name for name, _ in targets]
    if not names:
        raise CrowdError(f"One state must follow {state}: add another before you remove this one.")
    if len(set(names)) < len(names):
        raise CrowdError(
            f"{max(names, key=names.count)} follows {state} already: change its weight instead."
        )
    value = names[0] if len(names) == 1 else {name: plain(weight) for name, weight in targets}
    if label is None:
        return set_field(("states", state, "then"), value)
    if value == state:  # it need not be named as the next
        return _with_rule(state, label, lambda rule: {k: v for k, v in rule.items() if k != "next"})
    return _with_rule(state, label, lambda rule: rule | {"next": value})


def set_speed(state: str, label: str, speed: float, heading: float) -> Edit:
    """Set meters per second and degrees of a rule, in place of its `move` as well."""
    new = {"speed": plain(speed), "heading": plain(heading)}
    return _with_rule(
        state, label, lambda rule: {k: v for k, v in rule.items() if k != "move"} | new
    )


def own_rule(state: str, label: str) -> Edit:
    """Give the state a rule of its own on the label, as that of '*' is."""
    return _with_rule(state, label, lambda rule: rule)


def drop_rule(state: str, label: str) -> Edit:
    """Let the rule of '*' hold on the label."""

    def edit(root: Table) -> None:
        del root["states"][state]["on"][label]

    return edit


def add_state(name: str) -> Edit:
    """Add a state after the others: it stands, and none starts in it."""

    def edit(root: Table) -> None:
        states = root["states"]
        _check_new_name(name, states, "state")
        states[name] = {"color": _unused_color(states), "start": 0, "on": {"*": {}}}

    return edit


def add_label(name: str) -> Edit:
    """Add a label after the others, in a color of its own.

    States that name every label stand on it.
    """

    def edit(root: Table) -> None:
        labels = root["labels"]
        _check_new_name(name, labels, "label")
        labels[name] = {"color": _unused_color(labels)}
        for state in root["states"].values():
            if "*" not in state["on"]:
                state["on"][name] = {}

    return edit


def duplicate(kind: str, name: str, new: str) -> Edit:
    """Add a copy of the state or label after it. kind: "states" or "labels".

    A label's copy has a color of its own, and states do on it what they do on the first.
    """

    def edit(root: Table) -> None:
        _check_new_name(new, root[kind], kind[:-1])
        color = _unused_color(root[kind])
        _insert_copy(root[kind], name, new)
        if kind == "labels":
            root["labels"][new]["color"] = color
            for rules in _rules(root):
                _insert_copy(rules, name, new)

    return edit


def rename(kind: str, name: str, new: str) -> Edit:
    """Rename a state or label wherever it is named. kind: "states" or "labels"."""

    def edit(root: Table) -> None:
        if new == name:
            return
        _check_new_name(new, root[kind], kind[:-1])
        _rename_key(root[kind], name, new)
        if kind == "labels":
            for rules in _rules(root):
                _rename_key(rules, name, new)
            return
        for table, field in _followers(root):
            if table[field] == name:
                table[field] = new
            else:
                _rename_key(table_of(table[field]), name, new)

    return edit


def remove(kind: str, name: str) -> Edit:
    """Remove a state or label, and what names it. kind: "states" or "labels".

    Where the state alone followed, agents stay in their state; a timer that led to it is removed.
    """

    def edit(root: Table) -> None:
        del root[kind][name]
        if kind == "labels":
            for rules in _rules(root):
                rules.pop(name, None)
            return
        for table, field in list(_followers(root)):
            value = table[field]
            if isinstance(value, dict):
                value.pop(name, None)
                is_left = any(value.values())
            else:
                is_left = value != name
            if not is_left:
                del table[field]
                table.pop("after", None)  # a timer needs a state that follows

    return edit


def move(kind: str, name: str, by: int) -> Edit:
    """Move a state or label so many places down the list."""

    def edit(root: Table) -> None:
        fields = list(root[kind].items())
        place = list(root[kind]).index(name)
        field = fields.pop(place)
        fields.insert(max(place + by, 0), field)
        _refill(root[kind], fields)

    return edit


def unused_name(name: str, names: Sequence[str]) -> str:
    """Return `name`, or where it is one of `names` with the first number that makes it new."""
    if name not in names:
        return name
    stem = name.rstrip("0123456789").rstrip() or name
    numbered = (f"{stem} {n}" for n in range(2, len(names) + 3))
    return next(candidate for candidate in numbered if candidate not in names)


def plain(value: float) -> float | int:
    """Return a number as one writes it, to seven digits: Blender's have no more."""
    rounded = float(f"{value:.7g}")
    return int(rounded) if rounded.is_integer() else rounded


def _with_rule(state: str, label: str, change: Callable[[Table], Table]) -> Edit:
    """Change the rule of a state on a label, which becomes its own."""

    def edit(root: Table) -> None:
        rule = change(Draft(root).rule(state, label))
        ordered = {key: rule[key] for key in (*RULE_FIELDS, *rule) if key in rule}
        rules = root["states"][state]["on"]
        _put(rules, label, ordered, ("*", *rules) if label == "*" else ())

    return edit


def _lines(value: object, indent: str, column: int) -> str:
    """Return the value as JSON that begins at a column of a line indented so."""
    line = json.dumps(value, ensure_ascii=False)
    if not isinstance(value, dict) or column + len(line) < COLUMNS:
        return line
    inner = indent + "  "
    keys = {key: f"{inner}{json.dumps(key, ensure_ascii=False)}: " for key in value}
    fields = [head + _lines(value[key], inner, len(head)) for key, head in keys.items()]
    return "{\n" + ",\n".join(fields) + f"\n{indent}}}"


def _put(table: Table, key: str, value: object, order: Sequence[str]) -> None:
    """Set a field; a new one stands before those that follow it in the usual order of the table."""
    following = order[order.index(key) + 1 :] if key in order and key not in table else ()
    tail = {other: table.pop(other) for other in list(table) if other in following}
    table[key] = value
    table.update(tail)


def _refill(table: Table, fields: Iterable[tuple[str, Any]]) -> None:
    """Give the table these fields, in this order."""
    content = dict(fields)
    table.clear()
    table.update(content)


def _rename_key(table: Table, name: str, new: str) -> None:
    _refill(table, ((new if key == name else key, value) for key, value in table.items()))


def _insert_copy(table: Table, name: str, new: str) -> None:
    """Put a copy of the field `name`, if there is one, after it."""
    fields = []
    for key, value in table.items():
        fields.append((key, value))
        if key == name:
            fields.append((new, copy.deepcopy(value)))
    _refill(table, fields)


def _drop_timer(state: Table) -> None:
    state.pop("after", None)
    state.pop("then", None)


def _rules(root: Table) -> Iterator[Table]:
    """Yield each state's rules, by label."""
    for state in table_of(root.get("states")).values():
        yield table_of(table_of(state).get("on"))


def _followers(root: Table) -> Iterator[tuple[Table, str]]:
    """Yield each state with "then" and each rule with "next", if it has that field."""
    for state in table_of(root.get("states")).values():
        if "then" in table_of(state):
            yield state, "then"
    for rules in _rules(root):
        for rule in rules.values():
            if "next" in table_of(rule):
                yield rule, "next"


def _check_new_name(name: str, names: Iterable[str], kind: str) -> None:
    if not name.strip():
        raise CrowdError(f"A {kind} needs a name: type one.")
    if name == "*" and kind == "label":
        raise CrowdError(
            "'*' stands for every label that is not named: choose another name for the label."
        )
    if name in names:
        raise CrowdError(f"There is a {kind} {name} already: choose another name.")


def _unused_color(entries: Table) -> str:
    """Return a color "#rrggbb", far from those of these states or labels."""
    texts = [table_of(entry).get("color") for entry in entries.values()]
    colors = [
        bytes.fromhex(text[1:])
        for text in texts
        if isinstance(text, str) and len(text) == 7 and _is_hex(text[1:])
    ]

    def distance(candidate: list[int]) -> float:
        return min((math.dist(candidate, color) for color in colors), default=0)

    tones = [
        colorsys.hsv_to_rgb(hue / 24, saturation, value)
        for value in (0.9, 0.6)
        for saturation in (0.65, 0.9)
        for hue in range(24)
    ]
    candidates = [[round(255 * channel) for channel in tone] for tone in tones]
    return f"#{bytes(max(candidates, key=distance)).hex()}"


def _is_hex(digits: str) -> bool:
    return all(digit in "0123456789abcdefABCDEF" for digit in digits)


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
