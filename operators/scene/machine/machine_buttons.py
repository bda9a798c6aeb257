"""Buttons of the state machine editor: presets, what follows, import, export."""

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
    StringProperty,
)
from ...blender.operator import Reporting
from ...settings.crowds import active_or_new
from .machine_editor import cell_of, change, draft_of, missing_text, text_of


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


class _Editing(Reporting):
    needs = (missing_text,)


class CROWDLOD_OT_machine_follow(_Editing, bpy.types.Operator):
    """Add a state that may follow the selected one; one of them is drawn by weight"""

    bl_idname = "crowd_lod.machine_follow"
    bl_label = "Next State"

    state: StringProperty(name="State", description="The state that follows")
    timer: BoolProperty(
        name="After Timer", description="The state follows when the time is over, not on the label"
    )
    remove: BoolProperty(name="Remove", description="Remove the state")

    @classmethod
    def description(cls, context, properties) -> str:
        return properties.bl_rna.properties["remove"].description if properties.remove else ""

    def run(self, context) -> str:
        scene = context.scene
        state, label = cell_of(scene)
        where = None if self.timer else label
        targets = draft_of(scene).targets(state, where)
        if not self.remove:
            change(scene, edits.set_targets(state, where, [*targets, (self.state, 1.0)]))
            return f"{self.state} may follow {state}."
        names = [name for name, _ in targets]
        if self.state not in names:
            raise CrowdError(
                f"{self.state or 'No state'} does not follow {state}: set State to one of "
                f"{', '.join(names)}."
            )
        rest = [target for target in targets if target[0] != self.state]
        change(scene, edits.set_targets(state, where, rest))
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
    CROWDLOD_OT_machine_follow,
    CROWDLOD_OT_machine_import,
    CROWDLOD_OT_machine_export,
)
