"""What LOD meshes, plans, builds and proofs follow from: their parts, by name.

A part is a digest, or words where a message shows what it was and is (WORDED).
"""

from contextlib import suppress

import bpy

from ...crowd_lod.crowd.paces import mixed_in
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.levels.budget_fit import Budget
from ..blender import provenance, scene_data
from ..blender.contents import read_content
from ..blender.provenance import text_digest
from ..scene.characters.character_provenance import character_inputs, of_characters
from ..scene.characters.characters import GROUP, all_characters
from ..scene.characters.stored_groups import count_of
from ..scene.lights import has_sky
from ..scene.machine.scene_world import actions_named
from ..scene.scene_crowd import SceneCrowd, read_crowd
from ..scene.shot_overrides import digest_of
from ..scene.shot_reference import ASKED, CAMERA, OVERRIDES, content_of, plan_inputs
from ..settings.crowds import crowds_of
from ..settings.stored_figures import budget_of, budget_words, limits_levels

RATIOS = "ratios"
BUDGET = "budget"
MEMORY = "memory"
SIMPLIFY = "Simplify"
LEVELS = "levels"
LOD_GROUPS = "character groups"
RANGE = "the frame range"
SKY = "the light of the sky"
WORDED = {
    *(RATIOS, "tolerance", MEMORY, BUDGET, "resolution", "engine", "actions", "lens"),
    *(SIMPLIFY, LEVELS, LOD_GROUPS),
}
# what live builds follow by themselves
FOLLOWED = CAMERA, RANGE, SKY, "the resolution"
# settings of builds that are in no digest of the crowd
SETTINGS = (
    "forward",
    "margin_kind",
    "margin",
    "shadows",
    "sky_light",
    "occlusion",
)


def camera_motion(scene: bpy.types.Scene) -> str:
    """Return a digest of what the scene's cameras do in all frames, and of the markers' cameras."""
    bound = [marker for marker in scene.timeline_markers if marker.camera is not None]
    bound.sort(key=lambda marker: marker.frame)
    cameras = [camera for camera in (scene.camera, *(m.camera for m in bound)) if camera]
    frames = [marker.frame for marker in bound]
    return text_digest(provenance.digest_of(cameras, read=read_content), frames)


def lod_parts(scene: bpy.types.Scene) -> dict[str, str]:
    """Return what LOD meshes follow from. A lens that moves is left out."""
    settings = scene.crowd_lod
    facts = of_characters(character_inputs(scene)) | {SIMPLIFY: _simplify(scene.render)}
    if settings.choice == "BY_DISTANCE":
        ratios = settings.ratios[1 : settings.level_count]
        return facts | {RATIOS: ", ".join(f"{ratio:.3g}" for ratio in ratios)}
    if limits_levels(settings):
        facts[OVERRIDES] = text_digest(digest_of(settings))
    return facts | _view(scene) | {"actions": _actions(scene)}


def _view(scene: bpy.types.Scene) -> dict[str, str]:
    """Return what LODs by tolerance are chosen for."""
    settings = scene.crowd_lod
    render = scene.render
    part = render.resolution_percentage / 100
    facts = {
        "tolerance": f"{settings.tolerance:g} px",
        MEMORY: f"{settings.memory:g} MB",
        BUDGET: budget_words(settings),
        "resolution": f"{render.resolution_x * part:.0f} x {render.resolution_y * part:.0f}",
        "engine": scene_data.engine_of(scene).capitalize(),
    }
    camera = scene.camera
    if camera is not None and camera.type == "CAMERA" and camera.data.animation_data is None:
        data = camera.data
        facts["lens"] = (
            f"{data.ortho_scale * scene_data.meters(scene):.4g} m wide"
            if data.type == "ORTHO"
            else f"{data.lens:.4g} mm"
        )
    return facts


def _simplify(render: bpy.types.RenderSettings) -> str:
    """Return how renders of the scene simplify its meshes."""
    if not render.use_simplify:
        return "off"
    return f"to {render.simplify_subdivision_render} subdivisions"


def _actions(scene: bpy.types.Scene) -> str:
    """Return the actions in which LODs are measured, in words."""
    names: set[str] = set()
    with suppress(CrowdError):  # a bad state machine is told elsewhere
        names.update(*(actions_named(scene, each.name) for each in all_characters(scene)))
    plain = sorted(name for name in names if not mixed_in(name))
    return ", ".join(["the own", *plain]) + (" with cross-fades" if len(plain) < len(names) else "")


def lacking_lods(scene: bpy.types.Scene) -> list[tuple[str, str, str]]:
    """Return (name, what there is, what the settings ask for) of LOD meshes that are missing."""
    settings = scene.crowd_lod
    levels = settings.levels.children
    count = count_of(settings)
    lacking = [(LEVELS, str(len(levels)), str(count))] if len(levels) < count else []
    names = [group.name for group in settings.groups]
    homes = [*levels[0].children] if levels else []
    if names and len(homes) != len(names):
        return [*lacking, (LOD_GROUPS, str(len(homes)), str(len(names)))]
    renamed = [
        (home[GROUP], name)
        for home, name in zip(homes, names, strict=False)
        if home.get(GROUP, name) != name
    ]
    if renamed:
        columns = (", ".join(column) for column in zip(*renamed, strict=True))
        lacking.append((LOD_GROUPS, *columns))
    return lacking


def plan_parts(scene: bpy.types.Scene) -> dict[str, str]:
    """Return what the scene's shot plan follows from."""
    settings = scene.crowd_lod
    inputs = plan_inputs(read_crowd(scene))
    request = request_parts(
        scene, scene_data.frames_of(scene), round(settings.pop_reduction, 6), budget_of(settings)
    )
    return inputs | request


def request_parts(
    scene: bpy.types.Scene, frames, pop_reduction: float, budget: Budget
) -> dict[str, str]:
    """Return what is asked of a plan: its cameras' motion, its frames, and how it chooses."""
    asked = (
        camera_motion(scene),
        text_digest(list(frames)),
        f"{pop_reduction:g}",
        text_digest(budget),
    )
    return dict(zip(ASKED, asked, strict=True))


def build_parts(crowd: SceneCrowd) -> dict[str, str]:
    """Return what a bake follows from; a live build follows FOLLOWED by itself."""
    scene = crowd.scene
    settings = crowd.settings
    render = scene.render
    homes = [home and home.name for home in (settings.mirrors, settings.occlusion_exclude)]
    return plan_inputs(crowd) | {
        "the settings": text_digest(
            homes,
            *(getattr(settings, name) for name in SETTINGS),
            *(crowd.tilt for crowd in crowds_of(settings)),
        ),
        "the frame rate": text_digest(
            render.fps, render.fps_base, render.frame_map_old, render.frame_map_new
        ),
        "the shot plan": content_of(settings),
        CAMERA: camera_motion(scene),
        SKY: text_digest(has_sky(scene)),
        RANGE: text_digest(scene.frame_start, scene.frame_end, scene.frame_step),
        "the resolution": text_digest(
            render.resolution_x, render.resolution_y, render.resolution_percentage
        ),
    }
