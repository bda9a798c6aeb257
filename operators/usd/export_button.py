"""The button that exports the crowd of the shot as USD."""

from collections.abc import Generator
from pathlib import Path

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import byte_size, printable
from ..blender import scene_data
from ..blender.operator import Stepwise
from ..blender.output_folders import output_folder, place_of, with_ending
from ..scene.plan_verdict import plan_verdict
from ..settings import needs
from .export import ENDINGS, UsdExport, export_usd
from .openusd import missing_openusd


class CROWDLOD_OT_export_usd(Stepwise, bpy.types.Operator):
    bl_description = (
        "Write the crowd of the shot as USD: a point instancer, LODs in poses, materials, the "
        "camera"
    )
    bl_idname = "crowd_lod.export_usd"
    bl_label = "Export USD"
    needs = (needs.characters, needs.camera, missing_openusd)

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        settings = scene.crowd_lod
        name = settings.usd_file
        if Path(name).name != name:
            raise CrowdError(
                f"USD File is {printable(name)}: give a name alone, such as crowd.usdc; Output "
                f"Folder says where it goes."
            )
        path = with_ending(output_folder(scene, "usd") / name, *ENDINGS)
        frames = scene_data.frames_of(scene)
        exported = yield from export_usd(
            scene, UsdExport(frames, path, settings.animated_prototypes)
        )
        verdict = plan_verdict(settings, exported.unplanned)
        size = byte_size(path.stat().st_size)
        return f"{verdict} {exported.sentence} The file of {size} is {place_of(path)}."


CLASSES = (CROWDLOD_OT_export_usd,)
