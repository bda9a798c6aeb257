"""Buttons of the state machine editor: add, duplicate, remove, move, import, export, presets."""

from pathlib import Path

import bpy

from ....crowd_lod.crowd import machine_edits as edits
from ....crowd_lod.crowd.state_machine import load_preset, parse, preset_names
from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import counted
from ....crowd_lod.output import files
from ...blender.labeled_properties import (
    CONTEXT,
    BoolProperty,
    EnumProperty,
    IntProperty,
    StringProperty,
)
from ...blender.operator import Reporting
from ...settings.crowds import active_or_new
from .machine_editor import cell_of, change, draft_of, missing_text, selected_name, text_of


class CROWDLOD_OT_machine_preset(Reporting, bpy.types.Operator):
    """Load this state machine into a text block of its own, for the active crowd"""

    bl_idname = "crowd_lod.machine_preset"
    bl_label = "State Machine Preset"

    name: EnumProperty(name="Preset", items=[(n, n.capitalize(), "") for n in preset_names()])

    def run(self, context) -> str:
        machine = load_preset(self.name)
        text = bpy.data.texts.new(f"{self.name}.json")
        text.from_string(machine.text)
        active_or_new(context.scene.crowd_lod).machine = text
        return (
            f"{text.name}: {len(machine.states)} states; its labels are "
            f"{', '.join(machine.labels)}."
        )


class CROWDLOD_MT_machine_presets(bpy.types.Menu):
    bl_label = "Presets"
    bl_translation_context = CONTEXT

    def draw(self, context) -> None:
        for name in preset_names():
            self.layout.operator(
                "crowd_lod.machine_preset", text=name.capitalize(), translate=False
            ).name = name
        self.layout.separator()
        self.layout.operator("crowd_lod.machine_import", icon="IMPORT")
        self.layout.operator("crowd_lod.machine_export", icon="EXPORT")


LISTS = [("states", "State", "A state of the machine"), ("labels", "Label", "A label of the map")]


class _Editing(Reporting):
    needs = (missing_text,)


class _OfSelected(_Editing):
    """An edit of what is selected in the list of states or of labels."""

    kind: EnumProperty(name="Kind", items=LISTS, description="Which list")

    def names(self, scene) -> list[str]:
        found = draft_of(scene)
        return found.states if self.kind == "states" else found.labels

    def select(self, scene, name: str) -> None:
        setattr(scene.crowd_lod_editor, f"{self.kind[:-1]}_index", self.names(scene).index(name))


class CROWDLOD_OT_machine_add(_OfSelected, bpy.types.Operator):
    """Add a state in which agents stand, or a label in a color of its own"""

    bl_idname = "crowd_lod.machine_add"
    bl_label = "Add to State Machine"

    def run(self, context) -> str:
        name = edits.unused_name(self.kind[:-1], self.names(context.scene))
        change(context.scene, (edits.add_state if self.kind == "states" else edits.add_label)(name))
        self.select(context.scene, name)
        return f"The {self.kind[:-1]} {name} is added."


class CROWDLOD_OT_machine_duplicate(_OfSelected, bpy.types.Operator):
    """Add a copy of the selected state or label, with its rules"""

    bl_idname = "crowd_lod.machine_duplicate"
    bl_label = "Duplicate in State Machine"

    def run(self, context) -> str:
        name = selected_name(context.scene, self.kind)
        copy = edits.unused_name(name, self.names(context.scene))
        change(context.scene, edits.duplicate(self.kind, name, copy))
        self.select(context.scene, copy)
        return f"{copy} is a copy of {name}."


class CROWDLOD_OT_machine_remove(_OfSelected, bpy.types.Operator):
    """Remove the selected state or label and what leads to it; agents then stay in their state"""

    bl_idname = "crowd_lod.machine_remove"
    bl_label = "Remove from State Machine"

    def run(self, context) -> str:
        name = selected_name(context.scene, self.kind)
        index = self.names(context.scene).index(name)
        change(context.scene, edits.remove(self.kind, name))
        setattr(context.scene.crowd_lod_editor, f"{self.kind[:-1]}_index", max(index - 1, 0))
        return f"The {self.kind[:-1]} {name} is removed."


class CROWDLOD_OT_machine_move(_OfSelected, bpy.types.Operator):
    """Move the selected state or label; the first label is that of open ground"""

    bl_idname = "crowd_lod.machine_move"
    bl_label = "Move in State Machine"

    by: IntProperty(name="By", description="Rows down; up below 0", default=1)

    def run(self, context) -> str:
        name = selected_name(context.scene, self.kind)
        change(context.scene, edits.move(self.kind, name, self.by))
        self.select(context.scene, name)
        return f"{name} is at place {self.names(context.scene).index(name) + 1}."


class _Following(_Editing):
    """An edit of the states that follow the selected one."""

    state: StringProperty(name="State", description="The state that follows")
    timer: BoolProperty(
        name="After Timer", description="The state follows when the time is over, not on the label"
    )

    def targets(self, scene) -> tuple[str, str | None, list[tuple[str, float]]]:
        state, label = cell_of(scene)
        where = None if self.timer else label
        return state, where, draft_of(scene).targets(state, where)


class CROWDLOD_OT_machine_follow(_Following, bpy.types.Operator):
    """Let this state follow as well: one of all is drawn by weight"""

    bl_idname = "crowd_lod.machine_follow"
    bl_label = "Add Next State"

    def run(self, context) -> str:
        state, label, targets = self.targets(context.scene)
        change(context.scene, edits.set_targets(state, label, [*targets, (self.state, 1.0)]))
        return f"{self.state} may follow {state}."


class CROWDLOD_OT_machine_unfollow(_Following, bpy.types.Operator):
    """Let this state not follow"""

    bl_idname = "crowd_lod.machine_unfollow"
    bl_label = "Remove Next State"

    def run(self, context) -> str:
        state, label, targets = self.targets(context.scene)
        names = [name for name, _ in targets]
        if self.state not in names:
            raise CrowdError(
                f"{self.state or 'No state'} does not follow {state}: set State to one of "
                f"{', '.join(names)}."
            )
        change(
            context.scene,
            edits.set_targets(
                state, label, [target for target in targets if target[0] != self.state]
            ),
        )
        return f"{self.state} does not follow {state}."


class _JsonFile:
    """A JSON file that the user chooses."""

    filepath: StringProperty(
        name="File", subtype="FILE_PATH", description="JSON file of a state machine"
    )
    filter_glob: StringProperty(name="Filter", default="*.json", options={"HIDDEN"})

    def invoke(self, context, event) -> set[str]:
        text = text_of(context.scene)
        if not self.filepath and text is not None:
            self.filepath = text.name if text.name.endswith(".json") else f"{text.name}.json"
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def path(self) -> Path:
        return Path(bpy.path.abspath(self.filepath))


class CROWDLOD_OT_machine_import(_JsonFile, Reporting, bpy.types.Operator):
    """Load a state machine from a JSON file into a text of its own, for the active crowd"""

    bl_idname = "crowd_lod.machine_import"
    bl_label = "Import State Machine"

    def run(self, context) -> str:
        path = self.path()
        try:
            content = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            raise CrowdError(
                f"The file {path} is not text in UTF-8: save it as such, or choose another."
            ) from None
        machine = parse(content, path.name)
        text = bpy.data.texts.new(path.name)
        text.from_string(content)
        active_or_new(context.scene.crowd_lod).machine = text
        return (
            f"{text.name}: {counted(len(machine.states), 'state')}, "
            f"{counted(len(machine.labels), 'label')}."
        )


class CROWDLOD_OT_machine_export(_JsonFile, _Editing, bpy.types.Operator):
    """Write the state machine to a JSON file, as it stands in its text"""

    bl_idname = "crowd_lod.machine_export"
    bl_label = "Export State Machine"

    def run(self, context) -> str:
        text = text_of(context.scene)
        parse(text.as_string(), text.name)
        path = self.path()
        with files.staged_file(path) as part:
            part.write_text(text.as_string(), encoding="utf-8", newline="\n")
        return f"{text.name} is written to {path}."


CLASSES = (
    CROWDLOD_OT_machine_preset,
    CROWDLOD_MT_machine_presets,
    CROWDLOD_OT_machine_add,
    CROWDLOD_OT_machine_duplicate,
    CROWDLOD_OT_machine_remove,
    CROWDLOD_OT_machine_move,
    CROWDLOD_OT_machine_follow,
    CROWDLOD_OT_machine_unfollow,
    CROWDLOD_OT_machine_import,
    CROWDLOD_OT_machine_export,
)
