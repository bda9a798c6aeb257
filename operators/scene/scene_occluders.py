"""From the scene's settings to the scenery that may hide agents, at one time or over a shutter."""

from collections.abc import Sequence

import bpy

from ...crowd_lod.crowd.leave_outs import LeftOut
from ...crowd_lod.culling.occluders import Occluders, join_occluders
from ..blender import evaluation
from ..blender.materials import hides_in_all_engines
from ..blender.objects import SHOWN
from ..blender.occluders import read_occluders
from ..blender.ownership import OWNED
from ..blender.provenance import character_digest, text_digest
from ..blender.scenery import Scenery

STAGE = "occlusion"
UNSHADOWED = LeftOut(STAGE, "Occlusion Culling is off: it needs Shadows and Reflections.")
UNMAPPED = LeftOut(
    STAGE,
    "Occlusion Culling is off for cameras with depth of field, and for panoramas.",
)
SEE_THROUGH = LeftOut(
    STAGE,
    "Occlusion Culling is off in Workbench with X-ray, shadows, textures, outlines, backface "
    "culling, or characters In Front.",
)
NO_OCCLUDERS = LeftOut(STAGE, "The scene has no opaque meshes that may hide agents.")


def needs_shadows(settings) -> tuple[LeftOut, ...]:
    """Return why scenery hides nobody if hidden agents' shadows are not looked for."""
    return (UNSHADOWED,) if settings.occlusion else ()


def occluders_of(
    scene: bpy.types.Scene,
    scenery: Scenery,
    depsgraph: bpy.types.Depsgraph | None,
    times: Sequence[float],
    at: evaluation.At | None,
) -> tuple[Occluders | None, tuple[LeftOut, ...]]:
    """Return (what may hide agents, what may not); (None, why) if nobody is to be hidden.

    depsgraph: has evaluated the `scenery`, or None.
    times: while the shutter is open, in frames of the animation. What moves hides nobody.
    at: see lights.read_surroundings.
    """
    if not scene.crowd_lod.occlusion or depsgraph is None:
        return None, ()
    if scene.render.engine == "BLENDER_WORKBENCH" and _is_see_through(scene):
        return None, (SEE_THROUGH,)
    if _camera_blurs(scene):
        return join_occluders(()), (UNMAPPED,)
    excluded = _excluded(scene.crowd_lod)
    if scenery.occluding is None or scenery.occluding[0] != excluded:
        scenery.occluding = excluded, read_occluders(scenery, scene, depsgraph, excluded)
    reading = scenery.occluding[1]
    if times and at is None:
        with evaluation.stage() as staged:
            return occluders_of(scene, scenery, depsgraph, times, staged)
    items = {block for item, inside in scenery.solid for block in (item, *inside)}
    names = [item.name for item, _ in scenery.solid]
    for time in times:
        later = read_occluders(scenery, scene, at(items, time), excluded)
        reading = reading.without_moving(later, names)
    refused = [LeftOut(STAGE, sentence) for sentence in reading.sentences()]
    if not reading.parts:
        refused.append(NO_OCCLUDERS)
    return reading.join(), tuple(refused)


def scenery_digest(scene: bpy.types.Scene) -> dict[str, str]:
    """Return a digest of what may hide agents in any frame, by its name; none if nobody is hidden.

    It is the same in all frames.
    """
    if not scene.crowd_lod.occlusion:
        return {}
    excluded = _excluded(scene.crowd_lod)
    homes = {scene.collection, *scene.collection.children_recursive}
    homes |= {item.instance_collection for home in homes for item in home.objects} - {None}
    items = {
        item
        for home in homes
        for item in home.all_objects
        if item.type == "MESH"
        and not item.get(OWNED)
        and item not in excluded
        and (item.animation_data or not item.hide_render)
    }
    sorted_items = sorted(items, key=lambda item: item.name_full)
    looks = [(item.name_full, *map(repr, _flags(item))) for item in sorted_items]
    opaque = [
        [hides_in_all_engines(slot.material) for slot in item.material_slots]
        for item in sorted_items
    ]
    return {"the scenery": text_digest(character_digest(sorted_items), looks, opaque)}


def _flags(item: bpy.types.Object) -> list:
    """Return how renders show the object, as plain values."""
    return [*(getattr(item, flag) for flag in SHOWN if flag != "color"), tuple(item.color)]


def _is_see_through(scene: bpy.types.Scene) -> bool:
    """Return whether Workbench shows more than the nearest surface."""
    shading = scene.display.shading
    characters = scene.crowd_lod.characters
    return (
        shading.type == "WIREFRAME"
        or shading.show_xray
        or shading.show_shadows
        or shading.show_backface_culling
        or shading.color_type == "TEXTURE"
        or (characters is not None and any(x.show_in_front for x in characters.all_objects))
    )


def _camera_blurs(scene: bpy.types.Scene) -> bool:
    """Return whether the scene's own camera can have no map (frame.hidden.can_hide)."""
    data = scene.camera.data if scene.camera is not None else None
    return isinstance(data, bpy.types.Camera) and (
        data.type not in ("PERSP", "ORTHO") or data.dof.use_dof
    )


def _excluded(settings) -> set[bpy.types.Object]:
    """Return the objects that hide nobody: the crowd's own, and those that the user excludes."""
    homes = settings.characters, settings.levels, settings.build, settings.occlusion_exclude
    return {item for home in homes if home is not None for item in home.all_objects}
