"""What the buttons need of a scene, each as a sentence on what to do; "" if it is there.

They are asked whenever the sidebar is drawn, so they compute nothing and read no file.
"""

import bpy


def characters(scene: bpy.types.Scene) -> str:
    return (
        ""
        if scene.crowd_lod.characters is not None
        else "Choose the collection of characters, or make it from a selection"
    )


def crowd(scene: bpy.types.Scene) -> str:
    settings = scene.crowd_lod
    populated = len(settings.groups) and len(settings.crowds)
    return characters(scene) or ("" if populated else "Press Populate first")


def camera(scene: bpy.types.Scene) -> str:
    return (
        ""
        if scene.camera is not None and scene.camera.type == "CAMERA"
        else "The scene needs an active camera: add one, or choose it in Shot"
    )


def lods(scene: bpy.types.Scene) -> str:
    return "" if scene.crowd_lod.levels is not None else "Press Make LOD Meshes first"


def file(scene: bpy.types.Scene) -> str:
    return "" if bpy.data.filepath else "Save the file first: a farm opens it"


def overlay(scene: bpy.types.Scene) -> str:
    return "" if scene.crowd_lod.overlay else "Switch the overlay on first"


def picked(scene: bpy.types.Scene) -> str:
    return (
        ""
        if scene.crowd_lod.agent >= 0
        else "Pick an agent in the viewport first, with the eyedropper beside Agent"
    )


def plan(scene: bpy.types.Scene) -> str:
    return "" if scene.crowd_lod.shot_plan else "The scene has no shot plan: press Plan Shot"


def build(scene: bpy.types.Scene) -> str:
    return "" if scene.crowd_lod.build is not None else "The scene has no build: press Build"


def crowds(scene: bpy.types.Scene) -> str:
    return "" if len(scene.crowd_lod.crowds) else "There is no crowd: add one to the list"


def points(scene: bpy.types.Scene) -> str:
    crowds = scene.crowd_lod.crowds
    found = any(crowd.source == "POINTS" and crowd.points is not None for crowd in crowds)
    return "" if found else "Choose the object whose points are the agents"


def overrides(scene: bpy.types.Scene) -> str:
    return "" if len(scene.crowd_lod.overrides) else "There are no overrides: add one to the list"


def place(scene: bpy.types.Scene) -> str:
    settings = scene.crowd_lod
    if not 0 <= settings.override_index < len(settings.overrides):
        return "Select an override in the list"
    by = settings.overrides[settings.override_index].select_by
    return "" if by != "NUMBERS" else "Set Select By to Region first"
