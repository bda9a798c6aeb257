"""The button that exports the crowd of the shot as USD."""

from collections.abc import Generator

import bpy

from ..blender import scene_data
from ..blender.operator import Stepwise
from ..blender.output_folders import output_file, output_folder, place_of
from ..crowd import needs
from .export import ENDINGS, UsdExport, export_usd


class CROWDLOD_OT_export_usd(Stepwise, bpy.types.Operator):
    """Write the crowd of the shot as USD: a point instancer, LODs in poses, materials, the camera"""

    bl_idname = "crowd_lod.export_usd"
    bl_label = "Export USD"
    needs = (needs.characters, needs.camera)

    def steps(self, context) -> Generator[float, None, str]:
        scene, settings = context.scene, context.scene.crowd_lod
        path = output_file(output_folder(settings.usd_file), *ENDINGS)
        found = yield from export_usd(scene, UsdExport(scene_data.frames_of(scene), path, settings.usd_animated))
        return f"{found.sentence} The file is {place_of(settings.usd_file)}."


CLASSES = (CROWDLOD_OT_export_usd,)
