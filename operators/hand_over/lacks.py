"""What an output still needs, and the step to press."""

from typing import NamedTuple

import bpy

from ..freshness.artifacts import CROWD, LODS, PLAN, reasons


class Lack(NamedTuple):
    """What is missing or older than what it rests on, in words, and the operator that mends it."""

    sentence: str
    operator: str


def lacks_of(scene: bpy.types.Scene, operator: str) -> list[Lack]:
    """Return what the output of the `operator` still needs.

    A farm plans by itself, but opens a file that lies somewhere.
    """
    lacks = []
    needed = [CROWD, LODS, PLAN]
    if operator == "crowd_lod.write_farm_job":
        needed.remove(PLAN)
        if not bpy.data.filepath:
            lacks.append(Lack("The file is not saved", "wm.save_mainfile"))
    due = reasons(scene)
    operators = [artifact.operator for artifact in needed if artifact.operator in due]
    return [*lacks, *(Lack(due[name][:1].upper() + due[name][1:], name) for name in operators)]
