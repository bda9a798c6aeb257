"""The state machine that the sidebar edits: the active crowd's text, and no state besides it.

The editor reads the text each time, and each edit writes it. So the sidebar shows at once what was
typed into the text by hand, loaded, or undone.
"""

import bpy

from ....crowd_lod.crowd.json_reader import FieldPath
from ....crowd_lod.crowd.machine_draft import Draft, draft
from ....crowd_lod.crowd.machine_edits import Edit, edit_text
from ....crowd_lod.errors import CrowdError
from ...blender import scene_cache
from ...settings.crowds import active_crowd
from .scene_world import machine_text

# By scene: the text when an edit was refused last, and the sentence that says why.
_refused: dict[int, tuple[str, str]] = scene_cache.add_cache({}, by_scene=True)


def text_of(scene: bpy.types.Scene) -> bpy.types.Text | None:
    """Return the text of the active crowd's state machine, or None."""
    crowd = active_crowd(scene.crowd_lod)
    return crowd and crowd.machine


def missing_text(scene: bpy.types.Scene) -> str:
    """Return a sentence if the active crowd has no text to edit, else ""."""
    text = text_of(scene)
    if text is None:
        return "Choose a state machine of your own first, or one of the Presets"
    return (
        ""
        if text.library is None
        else f"The text {text.name} is linked from another file: make it local"
    )


def draft_of(scene: bpy.types.Scene) -> Draft:
    """Return the machine of the active crowd's text; that of the chapter if the text is empty.

    Without a text the Draft is empty.
    """
    crowd = active_crowd(scene.crowd_lod)
    if crowd is None or crowd.machine is None:
        return Draft({})
    return draft(machine_text(crowd), crowd.machine.name)


def problem_of(scene: bpy.types.Scene) -> str:
    """Return a sentence on the edit just refused, or on the text's first mistake; "" if none."""
    text = text_of(scene)
    if text is None:
        return ""
    left, sentence = _refused.get(scene.session_uid, ("", ""))
    return sentence if sentence and left == text.as_string() else draft_of(scene).problem


def selected_name(scene: bpy.types.Scene, kind: str) -> str:
    """Return the name of the state or label that is selected in the list; "" for none.

    kind: "states", "labels", or "rules": the label, or "*", whose rule is selected.
    """
    draft = draft_of(scene)
    editor = scene.crowd_lod_editor
    if kind == "rules":
        names = draft.rows(selected_name(scene, "states"))
    else:
        names = draft.states if kind == "states" else draft.labels
    index = getattr(editor, f"{kind[:-1]}_index")
    return names[min(index, len(names) - 1)] if names else ""


def cell_of(scene: bpy.types.Scene) -> tuple[str, str]:
    """Return the state and the label, or "*", of the selected rule."""
    return selected_name(scene, "states"), selected_name(scene, "rules")


def change(scene: bpy.types.Scene, edit: Edit) -> None:
    """Make the edit in the active crowd's text; CrowdError if it is refused, and the text stays."""
    lack = missing_text(scene)
    if lack:
        raise CrowdError(f"{lack}.")
    _refused.pop(scene.session_uid, None)
    text = text_of(scene)
    new = edit_text(machine_text(active_crowd(scene.crowd_lod)), text.name, edit)
    if new != text.as_string():
        text.from_string(new)


def change_or_tell(scene: bpy.types.Scene, edit: Edit) -> None:
    """Make the edit; if it is refused, the sidebar says why. For fields, which cannot report."""
    try:
        change(scene, edit)
    except CrowdError as error:
        tell(scene, error)


def tell(scene: bpy.types.Scene, error: CrowdError) -> None:
    """Show in the sidebar why an edit was refused, until the text changes."""
    text = text_of(scene)
    _refused[scene.session_uid] = text.as_string() if text is not None else "", str(error)


def faulty(scene: bpy.types.Scene, *path: str) -> bool:
    """Return whether the text's mistake is in the field at `path`."""
    place: FieldPath = path
    return draft_of(scene).faulty(*place)
