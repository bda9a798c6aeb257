"""register() and unregister(): all that Crowd LOD leaves on Blender while it is enabled."""

import bpy

from . import (
    build,
    cli,
    collection_caches,
    deviation,
    estimate,
    follow,
    inspector,
    levels,
    machines,
    overlay,
    panels,
    populate,
    preview,
    properties,
    render_setup,
    samples,
    scenery,
    threads,
    versions,
    viewport_render,
)

MODULES = (
    properties,
    samples,
    machines,
    populate,
    levels,
    deviation,
    estimate,
    preview,
    viewport_render,
    render_setup,
    inspector,
    panels,
)
CLASSES = tuple(c for module in MODULES for c in module.CLASSES)
HANDLERS = {
    "frame_change_post": [scenery.noticed, follow.follow],
    "depsgraph_update_post": [scenery.edited],
    "load_pre": [scenery.forget, populate.forget, follow.forget],
    "undo_pre": [scenery.forget],
    "redo_pre": [scenery.forget],
    "undo_post": [collection_caches.renew],
    "redo_post": [collection_caches.renew],
    "load_post": [versions.upgrade, build.upgrade],
    "save_pre": [versions.note],
    "render_pre": [follow.rendering],
    "render_post": [follow.rendered],
    "render_complete": [follow.ended],
    "render_cancel": [follow.rendered, follow.ended],
}
_commands = []


def register():
    for c in CLASSES:
        bpy.utils.register_class(c)
    bpy.types.Scene.crowd_lod = bpy.props.PointerProperty(type=properties.CrowdLodSettings)
    for name, functions in HANDLERS.items():
        for function in functions:
            getattr(bpy.app.handlers, name).append(function)
    threads.register()
    overlay.register()
    _commands.append(bpy.utils.register_cli_command("crowd_lod", cli.from_blender))


def unregister():
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    overlay.unregister()
    threads.unregister()
    for name, functions in HANDLERS.items():
        handlers = getattr(bpy.app.handlers, name)
        for function in functions:
            if function in handlers:  # a script may have cleared them
                handlers.remove(function)
    populate.forget()
    scenery.forget()
    del bpy.types.Scene.crowd_lod
    for c in reversed(CLASSES):
        bpy.utils.unregister_class(c)
