"""What an output still needs, and the step to press."""

from typing import NamedTuple

import bpy

from ..runs.update_all import due_steps

STEPS = {
    "Populate": "crowd_lod.populate",
    "Make LOD Meshes": "crowd_lod.make_levels",
    "Plan Shot": "crowd_lod.plan_shot",
}


class Lack(NamedTuple):
    """What is missing or older than what it rests on, in words, and the operator that mends it."""

    sentence: str
    operator: str


def lacks_of(scene: bpy.types.Scene, operator: str) -> list[Lack]:
    """Return what the output of the `operator` still needs.

    A farm plans by itself, but opens a file that lies somewhere.
    """
    due = due_steps(scene)
    lacks = []
    if operator == "crowd_lod.write_farm_job":
        due = {label: reason for label, reason in due.items() if label != "Plan Shot"}
        if not bpy.data.filepath:
            lacks.append(Lack("The file is not saved", "wm.save_mainfile"))
    lacks += [
        Lack(reason[:1].upper() + reason[1:], STEPS[label])
        for label, reason in due.items()
        if label in STEPS
    ]
    return lacks
