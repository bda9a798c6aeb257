"""register() and unregister(): all that Crowd LOD leaves on Blender while it is enabled."""

import bpy

from . import (
    build,
    cli,
    deviation,
    inspector,
    levels,
    machines,
    overlay,
    panels,
    populate,
    preview,
    properties,
    samples,
)

MODULES = (properties, samples, machines, populate, levels, deviation, preview, build, inspector, panels)
CLASSES = tuple(c for module in MODULES for c in module.CLASSES)
_commands = []


def register():
    for c in CLASSES:
        bpy.utils.register_class(c)
    bpy.types.Scene.crowd_lod = bpy.props.PointerProperty(type=properties.CrowdLodSettings)
    bpy.app.handlers.frame_change_post.append(build.follow)
    overlay.register()
    _commands.append(bpy.utils.register_cli_command("crowd_lod", cli.from_blender))


def unregister():
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    overlay.unregister()
    bpy.app.handlers.frame_change_post.remove(build.follow)
    populate.forget()
    del bpy.types.Scene.crowd_lod
    for c in reversed(CLASSES):
        bpy.utils.unregister_class(c)
