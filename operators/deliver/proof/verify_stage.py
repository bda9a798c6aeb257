"""The stage of a proof: the scene itself, set up for Cycles."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy

from ...blender import cameras
from ...blender.ownership import OWNED
from ...blender.removal import is_there
from ...build import bake
from ...build.shelves import points_of
from ...build.visibility import hides_characters
from ..preview.preview_stage import SIZE, Preview, restore_settings, set_up
from .verify_pictures import small

# Blender 4.5 does not read back the values that it writes of two eyes
PAIRS = bpy.app.version >= (5, 2, 0)
WIDEST = 960  # pixels of pictures, if no width is wanted
LONGEST_SHUTTER = 0.99 * bake.LONGEST  # frames
LIGHT = (
    *(f"{kind}_bounces" for kind in ("max", "glossy", "diffuse", "transmission", "volume")),
    *("world", "samples", "use_motion_blur"),
)
RAYS = ("camera", "diffuse", "glossy", "transmission", "shadow")


@dataclass(frozen=True)
class Verify:
    """What to verify.

    frames: increasing.
    width: of the pictures, pixels; None for the scene's own, WIDEST at most.
    samples: per pixel.
    strict: a frame without the LODs of the scene's shot plan is an error.
    """

    frames: list[int]
    folder: Path
    width: int | None = None
    samples: int = 4
    strict: bool = False

    def size(self, scene: bpy.types.Scene) -> tuple[int, int]:
        """Return (width, height) of the pictures, pixels."""
        width, height = cameras.image_size(scene.render)
        wanted = self.width or min(width, WIDEST)
        return wanted, max(1, round(wanted * height / width))


def set_up_cycles(scene: bpy.types.Scene, task: Verify) -> None:
    """Set up `scene` so that Cycles' pictures depend only on what its rays meet.

    That is: one seed, and no adaptive sampling, light tree, path guiding, fast GI, time limit or
    denoiser. The scene's own pixel filter and size stay: the crowd is planned for them. The user's
    own build is hidden, and so are the characters if renders hide them.

    """
    if hides_characters(scene):
        scene.crowd_lod.characters.hide_render = True
    if scene.crowd_lod.build is not None:
        scene.crowd_lod.build.hide_render = True
        scene.crowd_lod.build = None
    render = scene.render
    cycles = scene.cycles
    filmed = (
        render.use_motion_blur,
        render.use_multiview and PAIRS,
    )
    scene_size = [getattr(render, name) for name in SIZE]
    width, _ = task.size(scene)
    set_up(scene, Preview(task.frames, task.folder, width, "CYCLES", "MATERIAL"))
    for name, value in zip(SIZE, scene_size, strict=True):
        setattr(render, name, value)
    render.use_motion_blur, render.use_multiview = filmed
    render.motion_blur_shutter = min(render.motion_blur_shutter, LONGEST_SHUTTER)
    render.image_settings.views_format = "INDIVIDUAL"
    render.engine = "CYCLES"
    cycles.device = "CPU"
    render.use_stamp = render.use_persistent_data = False
    cycles.seed = 0
    cycles.use_animated_seed = False
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_light_tree = (
        cycles.use_guiding
    ) = False
    cycles.use_fast_gi = False
    cycles.time_limit = 0
    render.image_settings.color_mode = "RGBA"
    for layer in scene.view_layers:
        layer.samples = 0


@contextmanager
def without_shadows(scene: bpy.types.Scene) -> Iterator[None]:
    """Let no lamp of `scene` cast shadows, and restore that afterwards."""
    lamps = {item.data: item.data.use_shadow for item in scene.objects if item.type == "LIGHT"}
    try:
        for lamp in lamps:
            lamp.use_shadow = False
        yield
    finally:
        for lamp, casts in lamps.items():
            if is_there(lamp):
                lamp.use_shadow = casts


@dataclass(frozen=True)
class Filming:
    """How a picture of the proof is rendered.

    size: (width, height) pixels.
    world: the sky; dark_world's lights nothing.
    samples: a pixel.
    mirrors: whether what mirrors show is seen.
    blurs: whether the shutter is open.
    """

    size: tuple[int, int]
    world: bpy.types.World | None
    samples: int
    mirrors: bool = False
    blurs: bool = True


@contextmanager
def filmed(stage: bpy.types.Scene, filming: Filming) -> Iterator[None]:
    """Set `stage` up for a picture, and restore it afterwards.

    Light bounces off nothing but mirrors.
    """
    cycles = stage.cycles
    with small(stage, filming.size), restore_settings(stage, stage.render, cycles, only=LIGHT):
        cycles.max_bounces = cycles.glossy_bounces = int(filming.mirrors)
        cycles.diffuse_bounces = cycles.transmission_bounces = cycles.volume_bounces = 0
        cycles.samples = filming.samples
        stage.world = filming.world
        stage.render.use_motion_blur &= filming.blurs
        yield


def dark_world(world: bpy.types.World | None) -> bpy.types.World | None:
    """Return a copy of the world that the camera sees but that lights nothing.

    Agents outside the picture block some of the sky's light everywhere in it, and no bucket holds
    all of them.
    """
    if world is None:
        return None
    dark = world.copy()
    for ray in ("diffuse", "glossy", "transmission", "scatter"):
        setattr(dark.cycles_visibility, ray, False)
    return dark


def add_twins(stage: bpy.types.Scene, top: bpy.types.Collection) -> None:
    """Add a second instance of each instance of the build, invisible to all rays.

    Cycles rounds a mesh differently if it has one instance than if it has more. With the twins
    every mesh has more, however many agents show it.
    """
    for points in points_of(top).values():
        tree = bpy.data.node_groups.new("Crowd LOD twin", "GeometryNodeTree")
        tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
        info = tree.nodes.new("GeometryNodeObjectInfo")
        leave = tree.nodes.new("NodeGroupOutput")
        info.inputs["Object"].default_value = points
        tree.links.new(info.outputs["Geometry"], leave.inputs["Geometry"])
        twin = bpy.data.objects.new(tree.name, bpy.data.meshes.new(tree.name))
        twin[OWNED] = True
        twin.hide_viewport = True  # the window draws everyone at full detail otherwise
        twin.modifiers.new(tree.name, "NODES").node_group = tree
        for ray in RAYS:
            setattr(twin, f"visible_{ray}", False)
        stage.collection.objects.link(twin)
