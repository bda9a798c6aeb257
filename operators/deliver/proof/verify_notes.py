"""What a proof by renders does not show, does not judge and does not prove, in sentences."""

import bpy

from ....crowd_lod.output import tables
from ...blender import cameras, evaluation
from ...scene.lights import has_sky
from .verify_build import BAKE, LIVE, ProvedBuild
from .verify_stage import LONGEST_SHUTTER, PAIRS, Verify

# Cycles displaces a mesh where one of its instances stands, and rounds: differences of linear light
# up to here may come of that.
DISPLACED = 1e-3


def never_shown(scene: bpy.types.Scene) -> list[str]:
    """Return sentences on what the pictures cannot show as renders of `scene` do."""
    render = scene.render
    sentences = []
    if render.use_motion_blur and render.motion_blur_shutter > LONGEST_SHUTTER:
        sentences.append(
            f"The shutter was open for {LONGEST_SHUTTER:g} frames, not "
            f"{render.motion_blur_shutter:g}."
        )
    if render.use_multiview and not PAIRS:
        sentences.append(
            "Only one eye was rendered: this Blender version cannot read stereo pictures back."
        )
    sentences.append(evaluation.describe_unbaked(scene))
    return list(filter(None, sentences))


def unlike_renders(scene: bpy.types.Scene, proved: ProvedBuild) -> list[str]:
    """Return sentences on what the pictures of the build show otherwise than renders do."""
    sentences = []
    if proved.kind == LIVE and scene.render.use_motion_blur:
        sentences.append("The live build was pictured without the blur of its agents' way.")
    if proved.kind == BAKE and scene.render.engine == "BLENDER_WORKBENCH":
        sentences.append(
            "Shadows were left out: Workbench, for which the bake was made, needs nobody for them."
        )
    return sentences


def what_is_not_proved(scene: bpy.types.Scene, task: Verify) -> list[str]:
    """Return short phrases for what this run does not prove of a render of `scene`.

    Call it before the scene is set up.
    """
    render = scene.render
    size = cameras.image_size(render)
    phrases = ["other frames", "light that bounces"]
    if task.size(scene) != size:
        phrases.append(f"colors in pictures of {size[0]} x {size[1]} pixels")
    if has_sky(scene) and not scene.crowd_lod.sky_light:
        phrases.append("light of the sky that agents outside the picture take: Sky Light is off")
    if scene.camera.data.type == "PANO":
        phrases.append("outlines in panoramas")
    if render.use_motion_blur:
        phrases.append("outlines in motion")
    if render.engine != "CYCLES":
        phrases.append(
            f"shading, pixel filter and displacement in {render.engine.removeprefix('BLENDER_')}"
        )
    if render.use_compositing or render.use_sequencer:
        phrases.append("compositing and sequencer")
    if render.engine == "CYCLES" and scene.cycles.use_denoising:
        phrases.append("denoising")
    return phrases


def unjudged(scene: bpy.types.Scene, rows: list[dict]) -> list[str]:
    """Return sentences on what the pictures left unjudged."""
    sentences = [tables.nobody_seen(row["visible"] for row in rows)]
    displaced = displaced_materials(scene)
    if displaced:
        sentences.append(
            f"Meshes of {', '.join(displaced[:3])} are displaced by Cycles where one of their "
            f"instances stands, another one with culling, so differences of up to {DISPLACED:g} "
            f"were not counted."
        )
    return list(filter(None, sentences))


def displaced_materials(scene: bpy.types.Scene) -> list[str]:
    """Return names of materials that displace meshes in Cycles, not only as bumps."""
    slots = (
        slot for item in scene.crowd_lod.characters.all_objects for slot in item.material_slots
    )
    worn = {
        slot.material
        for slot in slots
        if slot.material is not None and slot.material.node_tree is not None
    }
    return sorted(
        material.name
        for material in worn
        if material.displacement_method != "BUMP" and _has_displacement(material.node_tree)
    )


def _has_displacement(tree: bpy.types.NodeTree) -> bool:
    return any(
        node.type == "OUTPUT_MATERIAL" and node.inputs["Displacement"].is_linked
        for node in tree.nodes
    )
