"""The fields of the state machine editor: each reads and writes the active crowd's text."""

import math
from collections.abc import Callable
from typing import Any

import bpy
import numpy as np

from ....crowd_lod.crowd import machine_edits as edits
from ....crowd_lod.crowd.machine_table import SHORTEST
from ....crowd_lod.crowd.state_machine import EDGES
from ....crowd_lod.errors import CrowdError
from ...blender.labeled_properties import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    StringProperty,
)
from ...settings.crowds import crowds_of
from . import map_painting
from .machine_editor import cell_of, change_or_tell, draft_of, selected_name, tell, text_of

Accessors = dict[str, Callable]  # get and set of a property
MOST_TARGETS = 32  # weights that a property of Blender's holds
EDGE_TELLS = {
    "clamp": "Agents slide along it",
    "wrap": "Agents go on at the other side",
    "reflect": "Agents go on mirrored until their state changes",
    "stop": "Agents stand",
}


def shortest(value: float) -> float:
    """Return the number of fewest digits that rounds to the same float32."""
    return float(str(np.float32(value)))


def color_of(text: object) -> tuple[float, ...]:
    try:
        return tuple(part / 255 for part in bytes.fromhex(str(text)[1:7].ljust(6, "0")))
    except ValueError:
        return (0.5, 0.5, 0.5)


def _hex(color) -> str:
    return "#" + bytes(round(255 * min(max(part, 0), 1)) for part in color).hex()


def _field(kind: str, name: str, empty=None) -> tuple[Callable, Callable]:
    """Return (get, set) of a field of the selected state or label.

    empty: the value that removes the field.
    """

    def get(self) -> Any:
        scene = self.id_data
        draft = draft_of(scene)
        table = draft.state if kind == "states" else draft.label
        return table(selected_name(scene, kind)).get(name, empty)

    def store(self, value) -> None:
        path = kind, selected_name(self.id_data, kind), name
        change_or_tell(self.id_data, edits.set_field(path, None if value == empty else value))

    return get, store


def _color_field(kind: str) -> Accessors:
    get, set_field = _field(kind, "color")
    return {
        "get": lambda self: color_of(get(self) or edits.FALLBACK),
        "set": lambda self, value: set_field(self, _hex(value)),
    }


def _text_field(kind: str, name: str) -> Accessors:
    get, set_field = _field(kind, name, "")
    return {"get": lambda self: str(get(self)), "set": set_field}


def _number_field(kind: str, name: str) -> Accessors:
    get, set_field = _field(kind, name, 0.0)

    def number(self) -> float:
        value = get(self)
        return float(value) if isinstance(value, int | float) and abs(value) < 1e30 else 0.0

    return {"get": number, "set": lambda self, value: set_field(self, edits.plain(shortest(value)))}


def _name_field(kind: str) -> Accessors:
    def store(self, value: str) -> None:
        scene = self.id_data
        before = selected_name(scene, kind)
        change_or_tell(scene, edits.rename(kind, before, value))
        if kind == "labels" and before not in draft_of(scene).labels:
            text = text_of(scene)
            for crowd in crowds_of(scene.crowd_lod):
                for entry in crowd.areas if crowd.machine == text else ():
                    entry.label = value if entry.label == before else entry.label

    return {"get": lambda self: selected_name(self.id_data, kind), "set": store}


def _targets(timer: bool) -> tuple[Callable, Callable]:
    """Return (read, write) of the states that follow, and their weights."""

    def read(self) -> tuple[str, str | None, list]:
        state, label = cell_of(self.id_data)
        where = None if timer else label
        return state, where, draft_of(self.id_data).targets(state, where)[:MOST_TARGETS]

    def write(self, targets) -> None:
        state, where, _ = read(self)
        change_or_tell(self.id_data, edits.set_targets(state, where, targets))

    return read, write


def _weights(timer: bool) -> Accessors:
    read, write = _targets(timer)

    def get(self) -> list[float]:
        weights = [weight for _, weight in read(self)[2]]
        return weights + [0.0] * (MOST_TARGETS - len(weights))

    def store(self, values) -> None:
        before = read(self)[2]
        changed = [
            (name, weight if np.float32(weight) == np.float32(value) else shortest(value))
            for (name, weight), value in zip(before, values, strict=False)
        ]
        write(self, changed)

    return {"get": get, "set": store}


def _single(timer: bool) -> Accessors:
    read, write = _targets(timer)
    return {
        "get": lambda self: read(self)[2][0][0],
        "set": lambda self, value: write(self, [(value, 1.0)]),
    }


def _timer_at(self) -> tuple[float, float]:
    return draft_of(self.id_data).timer(selected_name(self.id_data, "states")) or (0.0, 0.0)


def _set_timer(self, least: float, most: float) -> None:
    change_or_tell(
        self.id_data, edits.set_timer(selected_name(self.id_data, "states"), least, most)
    )


def _set_least(self, value: float) -> None:
    _set_timer(self, shortest(value), max(shortest(value), _timer_at(self)[1]))


def _set_most(self, value: float) -> None:
    _set_timer(self, min(shortest(value), _timer_at(self)[0] or shortest(value)), shortest(value))


def _use_timer(self, value: bool) -> None:
    state = selected_name(self.id_data, "states")
    change_or_tell(
        self.id_data, edits.set_timer(state, 5, 20) if value else edits.drop_timer(state)
    )


def _set_own_rule(self, value: bool) -> None:
    change_or_tell(
        self.id_data, (edits.own_rule if value else edits.drop_rule)(*cell_of(self.id_data))
    )


def _speed_at(self) -> tuple[float, float]:
    return draft_of(self.id_data).speed(*cell_of(self.id_data))


def _set_speed(self, value: float) -> None:
    heading = round(_speed_at(self)[1], 4)
    change_or_tell(self.id_data, edits.set_speed(*cell_of(self.id_data), shortest(value), heading))


def _set_heading(self, value: float) -> None:
    degrees = round(math.degrees(value), 3)  # a float32 of radians holds no more
    change_or_tell(
        self.id_data, edits.set_speed(*cell_of(self.id_data), _speed_at(self)[0], degrees)
    )


def _show_map(self, value: bool) -> None:
    if not value:
        map_painting.hide(self.id_data)
    elif map_painting.map_of(self.id_data) is not None:
        try:
            map_painting.show(self.id_data)
        except CrowdError as error:
            tell(self.id_data, error)


def _edge(self) -> int:
    edge = draft_of(self.id_data).root.get("edge", "clamp")
    return EDGES.index(edge) if edge in EDGES else 0


class CrowdLodMachineEditor(bpy.types.PropertyGroup):
    """A view of the active crowd's state machine: the selection, and fields that edit its text."""

    state_index: IntProperty(
        name="State", min=0, description="The state that is selected in the list"
    )
    rule_index: IntProperty(
        name="Rule", min=0, description="The label whose rule is selected in the list"
    )
    label_index: IntProperty(
        name="Label", min=0, description="The label that is selected in the list"
    )
    area_index: IntProperty(
        name="Area", min=0, description="The wall or area that is selected in the list"
    )
    goal_index: IntProperty(
        name="Goal", min=0, description="The goal of a simulation that is selected in the list"
    )
    group_index: IntProperty(
        name="Character Group", min=0, description="The group that is selected in the list"
    )
    show_map: BoolProperty(
        name="Show on Ground",
        description="Show the active crowd's label map on a plane over its ground, which renders "
        "leave out",
        get=lambda self: map_painting.is_plane_shown(self.id_data),
        set=_show_map,
    )
    edge: EnumProperty(
        name="At Edge",
        description="What agents do at the map's edge",
        items=[(name, name.capitalize(), EDGE_TELLS[name]) for name in EDGES],
        get=_edge,
        set=lambda self, value: change_or_tell(
            self.id_data, edits.set_field(("edge",), EDGES[value])
        ),
    )
    state_name: StringProperty(
        name="Name", description="Name of the state", **_name_field("states")
    )
    state_color: FloatVectorProperty(
        name="Color",
        description="Color of agents in this state",
        subtype="COLOR_GAMMA",
        min=0,
        max=1,
        **_color_field("states"),
    )
    start: FloatProperty(
        name="Start Weight",
        description="How likely an agent starts in this state, beside the other states' weights",
        min=0,
        soft_max=10,
        step=50,
        **_number_field("states", "start"),
    )
    action: StringProperty(
        name="Action",
        description="Action that agents in this state play; each character group plays its own of "
        "that name",
        **_text_field("states", "action"),
    )
    fade: FloatProperty(
        name="Fade",
        description="Seconds in which agents who come into this state from another action pass "
        "over to its action; 0 changes at once",
        min=0,
        soft_max=1,
        step=5,
        **_number_field("states", "fade"),
    )
    use_timer: BoolProperty(
        name="Timer",
        description="The state ends after a time, wherever the agent is",
        get=lambda self: (
            draft_of(self.id_data).timer(selected_name(self.id_data, "states")) is not None
        ),
        set=_use_timer,
    )
    timer_least: FloatProperty(
        name="Seconds Min",
        description="Least time in the state",
        step=50,
        min=SHORTEST,
        soft_max=60,
        get=lambda self: _timer_at(self)[0],
        set=_set_least,
    )
    timer_most: FloatProperty(
        name="Max",
        description="Greatest time in the state: each agent draws its own",
        step=50,
        min=SHORTEST,
        soft_max=60,
        get=lambda self: _timer_at(self)[1],
        set=_set_most,
    )
    then_state: StringProperty(
        name="Then", description="The state that follows when the time is over", **_single(True)
    )
    then_weights: FloatVectorProperty(
        name="Weight",
        description="How likely this state follows",
        size=MOST_TARGETS,
        min=0,
        step=50,
        **_weights(True),
    )
    own_rule: BoolProperty(
        name="Own Rule",
        description="The state has a rule of its own on this label; else that of all others holds",
        get=lambda self: draft_of(self.id_data).has_rule(*cell_of(self.id_data)),
        set=_set_own_rule,
    )
    speed: FloatProperty(
        name="Speed",
        description="Meters per second in this state on this label",
        min=0,
        step=5,
        soft_max=5,
        get=lambda self: _speed_at(self)[0],
        set=_set_speed,
    )
    heading: FloatProperty(
        name="Direction",
        description="Where agents walk: 0 is +X, 90 is +Y, counter-clockwise",
        subtype="ANGLE",
        step=500,
        get=lambda self: math.radians(_speed_at(self)[1]),
        set=_set_heading,
    )
    next_state: StringProperty(
        name="Next", description="The state that follows on this label", **_single(False)
    )
    next_weights: FloatVectorProperty(
        name="Weight",
        description="How likely this state follows",
        size=MOST_TARGETS,
        min=0,
        step=50,
        **_weights(False),
    )
    label_name: StringProperty(
        name="Name", description="Name of the label", **_name_field("labels")
    )
    label_color: FloatVectorProperty(
        name="Color",
        description="Color of the label in the map's image",
        subtype="COLOR_GAMMA",
        min=0,
        max=1,
        **_color_field("labels"),
    )
    spawn: BoolProperty(
        name="Agents Spawn Here",
        description="Agents may spawn on this label",
        get=lambda self: (
            draft_of(self.id_data).label(selected_name(self.id_data, "labels")).get("spawn")
            is not False
        ),
        set=lambda self, value: _field("labels", "spawn", True)[1](self, value),
    )


class CrowdLodRow(bpy.types.PropertyGroup):
    """A row of a list that is drawn from the text, called `name`."""


class CrowdLodRows(bpy.types.PropertyGroup):
    """The rows of the lists, in the window manager; set whenever the lists are drawn."""

    states: CollectionProperty(
        type=CrowdLodRow, name="States", description="Rows of the list of states"
    )
    rules: CollectionProperty(
        type=CrowdLodRow, name="Rules", description="Rows of the list of rules"
    )
    labels: CollectionProperty(
        type=CrowdLodRow, name="Labels", description="Rows of the list of labels"
    )


def rows_of(context, kind: str, names: list[str]) -> CrowdLodRows:
    """Return the rows after setting those of this kind to these names."""
    rows = context.window_manager.crowd_lod_rows
    kind_rows = getattr(rows, kind)
    while len(kind_rows) > len(names):
        kind_rows.remove(len(kind_rows) - 1)
    for n, name in enumerate(names):
        row = kind_rows[n] if n < len(kind_rows) else kind_rows.add()
        if row.name != name:
            row.name = name
    return rows


CLASSES = (CrowdLodMachineEditor, CrowdLodRow, CrowdLodRows)


def register() -> None:
    bpy.types.Scene.crowd_lod_editor = bpy.props.PointerProperty(type=CrowdLodMachineEditor)
    bpy.types.WindowManager.crowd_lod_rows = bpy.props.PointerProperty(type=CrowdLodRows)


def unregister() -> None:
    del bpy.types.Scene.crowd_lod_editor
    del bpy.types.WindowManager.crowd_lod_rows
