"""The sample characters as coarse as can be, for tests that look at something else.

Scripts in Blender's window use this, too: there the extension's package has another name.
"""

from importlib import import_module

import bmesh
import bpy

CAGE = -2  # steps of subdivision besides the sample characters' two: some 350 faces are left


def coarsen(settings: bpy.types.PropertyGroup) -> None:
    """Leave the crowd's sample characters the faces of their cages.

    Names, materials, UVs and weights stay, and so do the meshes as data-blocks.
    """
    package, _, _ = type(settings).__module__.partition(".operators.")
    makers = import_module(f"{package}.sample_scenes.characters")
    for build in makers.BUILDS:
        fine = bpy.data.objects.get(build.name)
        if fine is None or build.name not in settings.characters.children:
            continue
        body = makers.make_body(build, CAGE)
        if len(fine.data.polygons) == len(body.sizes):
            continue
        coarse = makers.make_mesh(build, body)
        cage = coarse.data
        geometry = bmesh.new()
        geometry.from_mesh(cage)
        geometry.to_mesh(fine.data)
        geometry.free()
        bpy.data.batch_remove([coarse, cage, *cage.materials])
