"""The operator that makes a sample scene."""

import bpy

from ... import sample_scenes
from ..blender.labeled_properties import EnumProperty
from ..blender.operator import Reporting


class CROWDLOD_OT_sample(Reporting, bpy.types.Operator):
    """Add a sample scene to this file, beside your own scene, and show it"""

    bl_idname = "crowd_lod.sample"
    bl_label = "Sample Scene"

    name: EnumProperty(name="Sample", items=[(n, n.capitalize(), "") for n in sample_scenes.NAMES])

    def run(self, context) -> str:
        scene = bpy.data.scenes.new(self.name.capitalize())
        sample_scenes.make(self.name, scene)
        context.window.scene = scene
        return f"The scene {scene.name} is made; your own is in the scene selector."


CLASSES = (CROWDLOD_OT_sample,)
