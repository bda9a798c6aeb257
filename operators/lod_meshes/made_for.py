"""For which shot LODs by tolerance were made: another one may need others."""

import json

import bpy

from ..blender import scene_data

MADE_FOR = "crowd_lod_made_for"  # custom property of the collection of all LODs


def note_shot(scene: bpy.types.Scene) -> None:
    """Store in the scene's LODs what they were made for."""
    scene.crowd_lod.levels[MADE_FOR] = json.dumps(_facts(scene))


def outdated(scene: bpy.types.Scene) -> str:
    """Return a sentence on what the LODs by tolerance were made for and is otherwise now; "" if nothing.

    LODs by ratio, and those that do not say what they were made for, are never outdated.
    """
    settings = scene.crowd_lod
    stored = settings.levels.get(MADE_FOR) if settings.levels is not None else None
    if settings.choice != "BY_TOLERANCE" or not isinstance(stored, str):
        return ""
    try:
        before = json.loads(stored)
    except ValueError:
        return ""
    now = _facts(scene)
    told = [f"{name} {before[name]} (now {now[name]})" for name in now if name in before and before[name] != now[name]]
    return f"LODs were made for {', '.join(told)}" if told else ""


def _facts(scene: bpy.types.Scene) -> dict[str, str]:
    """Return what the choice of LODs depends on, besides the crowd. A lens that moves is left out."""
    settings, render, camera = scene.crowd_lod, scene.render, scene.camera
    part = render.resolution_percentage / 100
    facts = {
        "tolerance": f"{settings.tolerance:g} px",
        "memory": f"{settings.memory:g} MB",
        "resolution": f"{render.resolution_x * part:.0f} x {render.resolution_y * part:.0f}",
        "engine": scene_data.engine_of(scene).capitalize(),
    }
    if camera is not None and camera.type == "CAMERA" and camera.data.animation_data is None:
        data = camera.data
        facts["lens"] = f"{data.ortho_scale:.4g} m wide" if data.type == "ORTHO" else f"{data.lens:.4g} mm"
    return facts
