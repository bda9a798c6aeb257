"""What an output still needs, with the step to press, and how large handed over files are."""

import os
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import byte_size
from ..blender.output_folders import output_folder
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


def sizes_of(scene: bpy.types.Scene) -> dict[str, str]:
    """Return the sizes on disk, in words, of the files that hold what was handed over.

    The keys are the operators that make them: the open file of a bake, if it is saved as it is; the
    USD file; and the scene of the farm's job.
    """
    blend = Path(bpy.data.filepath)
    paths = {} if bpy.data.is_dirty else {"crowd_lod.bake": blend}
    with suppress(CrowdError):  # Output Folder is empty
        paths["crowd_lod.export_usd"] = output_folder(scene, "usd") / scene.crowd_lod.usd_file
        paths["crowd_lod.write_farm_job"] = output_folder(scene, "farm") / blend.name
    return {
        operator: byte_size(os.path.getsize(path))
        for operator, path in paths.items()
        if os.path.isfile(path)
    }
