"""The lists of states and labels: their rows are those of the active crowd's text."""

from dataclasses import dataclass

import bpy

from ....crowd_lod.crowd import machine_edits as edits
from ....crowd_lod.errors import CrowdError
from .machine_editor import change, draft_of, missing_text, selected_name


@dataclass(frozen=True)
class MachineList:
    """A list of the state machine.

    kind: "states" or "labels".
    tells: what its buttons do, by "add", "remove" and "move".
    """

    kind: str
    tells: dict[str, str]

    def add(self, context, copy: bool) -> str:
        scene = context.scene
        names = self._names(scene)
        if copy:
            name = selected_name(scene, self.kind)
            added = edits.unused_name(name, names)
            change(scene, edits.duplicate(self.kind, name, added))
            sentence = f"{added} is a copy of {name}."
        else:
            added = edits.unused_name(self.kind[:-1], names)
            add = edits.add_state if self.kind == "states" else edits.add_label
            change(scene, add(added))
            sentence = f"Added the {self.kind[:-1]} {added}."
        self._select(scene, self._names(scene).index(added))
        return sentence

    def remove(self, scene: bpy.types.Scene) -> str:
        names = self._names(scene)
        name = selected_name(scene, self.kind)
        change(scene, edits.remove(self.kind, name))
        self._select(scene, max(names.index(name) - 1, 0))
        return f"Removed the {self.kind[:-1]} {name}."

    def move(self, scene: bpy.types.Scene, by: int) -> str:
        self._names(scene)
        name = selected_name(scene, self.kind)
        change(scene, edits.move(self.kind, name, by))
        place = self._names(scene).index(name)
        self._select(scene, place)
        return f"Moved {name} to place {place + 1}."

    def _names(self, scene: bpy.types.Scene) -> list[str]:
        if lack := missing_text(scene):
            raise CrowdError(lack)
        draft = draft_of(scene)
        return draft.states if self.kind == "states" else draft.labels

    def _select(self, scene: bpy.types.Scene, index: int) -> None:
        setattr(scene.crowd_lod_editor, f"{self.kind[:-1]}_index", index)


STATES = MachineList(
    "states",
    {
        "add": "Add a state in which agents stand",
        "remove": "Remove the selected state and what leads to it; agents then stay in their state",
        "move": "Move the selected state",
    },
)
LABELS = MachineList(
    "labels",
    {
        "add": "Add a label in a color of its own",
        "remove": "Remove the selected label and its rules",
        "move": "Move the selected label; the first one is that of open ground",
    },
)
