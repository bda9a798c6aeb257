"""Register everything that Crowd LOD adds to Blender, and unregister it."""

import atexit

import bpy

from .blender import (
    callbacks,
    collection_caches,
    operator,
    output_folders,
    provenance,
    scene_cache,
    scenery,
    steps,
)
from .build import aovs, buttons, frame_update
from .cli import commands
from .deliver import farm_job, open_report, update_all
from .deliver.accuracy import accuracy
from .deliver.preview import preview
from .deliver.proof import measured_error, verify
from .deliver.usd import export
from .lods import give_lod, make_lods
from .plan import shot_plan
from .scene import plan_verdict, populate, scene_crowd, simulate_button, walls_button
from .scene.characters import characters_from_selection, take_action, take_along, wardrobe_buttons
from .scene.machine import machine_buttons, machine_settings, map_areas, map_painting
from .scene.sources import record_points
from .settings import crowd_settings, presets, properties, setting_changes, shot_settings
from .ui import (
    action_menu,
    agent_overrides,
    area_list,
    crowd_list,
    crowd_panels,
    delivery_panels,
    drawing,
    goal_list,
    group_list,
    list_buttons,
    lod_panels,
    machine_panels,
    manual,
    menus,
    overlay_panel,
    override_list,
    panels,
    popovers,
    shot_panels,
    wardrobe_panel,
)
from .viewport import agent_picker, playblast, viewport_overlay

MODULES = (
    operator,
    crowd_settings,
    shot_settings,
    override_list,
    agent_overrides,
    area_list,
    properties,
    machine_settings,
    machine_buttons,
    map_painting,
    populate,
    walls_button,
    simulate_button,
    record_points,
    characters_from_selection,
    give_lod,
    wardrobe_buttons,
    take_action,
    take_along,
    make_lods,
    preview,
    shot_plan,
    accuracy,
    update_all,
    verify,
    measured_error,
    open_report,
    playblast,
    buttons,
    aovs,
    export,
    farm_job,
    agent_picker,
    presets,
    popovers,
    menus,
    action_menu,
    crowd_list,
    goal_list,
    group_list,
    list_buttons,
    # the panels, in their order
    panels,
    crowd_panels,
    machine_panels,
    wardrobe_panel,
    lod_panels,
    shot_panels,
    delivery_panels,
    overlay_panel,
)
CLASSES = tuple(c for module in MODULES for c in module.CLASSES)
HANDLERS = {
    "frame_change_post": [provenance.note_edits_of_frame, scenery.note_frame, frame_update.follow],
    "depsgraph_update_post": [
        provenance.note_edits,
        scenery.note_edit,
        map_areas.moved_or_edited,
        frame_update.follow_points,
    ],
    "load_pre": [steps.stop_for_file, scene_cache.forget, frame_update.forget],
    "load_post": [output_folders.after_opening, plan_verdict.note_plan_files],
    "save_pre": [steps.stop_for_saving, output_folders.before_saving],
    "save_post": [output_folders.after_saving],
    "save_post_fail": [output_folders.after_failed_saving],
    "undo_pre": [steps.stop_for_undo, scenery.forget],
    "redo_pre": [steps.stop_for_undo, scenery.forget],
    "undo_post": [
        provenance.note_undo,
        collection_caches.restore,
        collection_caches.renew,
        map_areas.undone,
    ],
    "redo_post": [
        provenance.note_undo,
        collection_caches.restore,
        collection_caches.renew,
        map_areas.undone,
    ],
    "render_pre": [frame_update.rendering],
    "render_post": [frame_update.rendered],
    "render_complete": [frame_update.ended],
    "render_cancel": [frame_update.rendered, frame_update.ended],
}
# what follows when settings change
FOLLOWERS = {
    "active_crowd": lambda settings: map_painting.follow_active(settings.id_data),
    "areas": lambda entry: map_areas.follow_soon(entry.id_data),
    "on_ground": scene_crowd.set_down,
    "shot_plan": plan_verdict.note_plan_file,
}
_commands = []


def register() -> None:
    if bpy.app.module:  # a script may end without it, and then Blender 4.5 crashes
        atexit.register(unregister)
    setting_changes.FOLLOWERS.update(FOLLOWERS)
    for c in CLASSES:
        bpy.utils.register_class(c)
    bpy.types.Scene.crowd_lod = bpy.props.PointerProperty(type=properties.CrowdLodSettings)
    machine_settings.register()
    for name, functions in HANDLERS.items():
        for function in functions:
            getattr(bpy.app.handlers, name).append(function)
    callbacks.register()
    menus.register()
    manual.register()
    viewport_overlay.register()
    _commands.append(bpy.utils.register_cli_command("crowd_lod", commands.from_blender))


def unregister() -> None:
    atexit.unregister(unregister)
    steps.end_all("was stopped, as Crowd LOD was disabled")
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    viewport_overlay.unregister()
    manual.unregister()
    menus.unregister()
    callbacks.unregister()
    for name, functions in HANDLERS.items():
        handlers = getattr(bpy.app.handlers, name)
        for function in functions:
            if function in handlers:  # a script may have cleared them
                handlers.remove(function)
    scene_cache.forget()
    setting_changes.FOLLOWERS.clear()
    drawing.unregister()
    map_areas.unregister()
    machine_settings.unregister()
    del bpy.types.Scene.crowd_lod
    for c in reversed(CLASSES):
        bpy.utils.unregister_class(c)
