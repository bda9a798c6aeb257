"""The stage of a preview: a copy of the scene, set to render its pictures.

Settings are restored afterwards.
"""

import contextlib
from collections.abc import Container, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ....crowd_lod.frame.frame import Frame
from ...blender import cameras, image_data, mesh_data, removal, scene_data
from ...blender.console import quiet
from ...blender.materials import switch_nodes_on
from ...blender.removal import is_there
from ...build import frame_update, render_setup, visibility
from ...build.appended_builds import STAGE
from ...build.shelves import LEVEL, points_of
from ...build.visibility import shows_characters
from ...scene.scene_crowd import SceneCrowd
from ...viewport.draw_data import by_error
from ...viewport.playblast import caption_size


@contextmanager
def restore_settings(
    *owners: bpy.types.bpy_struct, only: Container[str] | None = None
) -> Iterator[None]:
    """Restore the settings of `owners` at the end.

    Restored are each owner's own writable properties, except collections.

    only: names of those to restore; None for all.

    Those of a data-block that is gone by then are left out: to read them would crash Blender.
    """
    with quiet():  # asked for its device, Cycles looks for all that there are, and says so
        pointers = ((owner, prop) for owner in owners for prop in owner.bl_rna.properties)
        names = [
            (owner, prop.identifier)
            for owner, prop in pointers
            if not prop.is_readonly
            and prop.type != "COLLECTION"
            and (only is None or prop.identifier in only)
        ]
        before = [(owner, name, _plain(getattr(owner, name))) for owner, name in names]
        blocks = [owner.id_data for owner, _ in names]
    try:
        yield
    finally:
        for _ in range(2):  # which values one of them may have depends on others
            for block, (owner, name, value) in zip(blocks, before, strict=True):
                if is_there(block) and _plain(getattr(owner, name)) != value:
                    with suppress(TypeError):
                        setattr(owner, name, value)


def _plain(value) -> Any:
    return (
        tuple(value)
        if hasattr(value, "__len__") and not isinstance(value, str | set | bpy.types.bpy_struct)
        else value
    )


# What renders the pictures; the overlay's are drawn, and only the pictures of LODs rendered.
ENGINES = {
    "WORKBENCH": "BLENDER_WORKBENCH",
    **scene_data.BLENDER_ENGINES,
    "OVERLAY": "BLENDER_WORKBENCH",
}
COLOR_MODES = "LOD", "ERROR", "MATERIAL"  # that every engine has
TINTED = "LOD", "ERROR"  # of COLOR_MODES, those without materials
SIZE = "resolution_x", "resolution_y", "resolution_percentage"
GRAY = (0.55, 0.58, 0.62)  # the sky of the tinted pictures, linear


@dataclass(frozen=True)
class Preview:
    """What to preview.

    frames: increasing.
    width: of the pictures, pixels.
    engine: one of ENGINES.
    color: one of COLOR_MODES; with the engine OVERLAY, a value of the setting overlay_color.
    strict: a frame without the LODs of the scene's shot plan is an error.
    """

    frames: list[int]
    folder: Path
    width: int = 960
    engine: str = "WORKBENCH"
    color: str = "LOD"
    strict: bool = False


@dataclass(frozen=True)
class Staged:
    """A scene and its stage.

    scene: the user's own.
    stage: the copy, which is drawn.
    size: of the pictures, and of the scene's own renders, (width, height) pixels.
    """

    scene: bpy.types.Scene
    stage: bpy.types.Scene
    task: Preview
    size: tuple[int, int]


def staged(scene: bpy.types.Scene, task: Preview) -> Staged:
    """Return `scene` with a stage for the wanted pictures."""
    stage = _stage_of(scene, task)
    size = cameras.image_size(stage.render)
    for name in SIZE:  # LODs by pixels are those of the scene's own renders
        setattr(stage.render, name, getattr(scene.render, name))
    return Staged(scene, stage, task, size)


def _stage_of(scene: bpy.types.Scene, task: Preview) -> bpy.types.Scene:
    """Return a copy of `scene` set to render the wanted pictures.

    It shares the objects. The user's own build is left out. So are the characters themselves,
    unless they are kept in renders.
    """
    stage = scene.copy()
    stage.name = ".Crowd LOD preview"
    scene_data.let_go(stage, "build")
    for layer in stage.view_layers if leaves_out(stage) else ():
        layer.update()
        visibility.exclude(layer.layer_collection, stage.crowd_lod.characters)
    set_up(stage, task)
    return stage


def set_up(stage: bpy.types.Scene, task: Preview) -> None:
    """Set `stage` to render the wanted pictures."""
    stage[STAGE] = True
    render = stage.render
    height = max(1, round(task.width * render.resolution_y / render.resolution_x))
    render.resolution_x = task.width
    render.resolution_y = height
    render.resolution_percentage = 100
    render.use_border = render.use_multiview = render.use_compositing = render.use_sequencer = False
    render.use_motion_blur = False
    render.image_settings.file_format = "PNG"
    render.image_settings.color_mode = "RGB"
    render.image_settings.color_depth = "8"
    for name in dir(render):
        if name.startswith("use_stamp_"):
            setattr(render, name, name in ("use_stamp_frame", "use_stamp_note"))
    render.use_stamp = render.use_stamp_labels = True
    render.stamp_font_size = caption_size(task.width)
    render.stamp_foreground = (1, 1, 1, 1)
    render.stamp_background = (0, 0, 0, 0.85)
    # one pass; Workbench draws the whole scene anew for every other sample
    stage.display.render_aa = "FXAA"
    if task.engine == "OVERLAY":
        stage.crowd_lod.overlay_color = task.color
    if task.color != "MATERIAL":
        stage.view_settings.view_transform = "Standard"
        stage.view_settings.look = "None"
        stage.view_settings.exposure = 0
        stage.view_settings.gamma = 1
        stage.world = _world()
    if task.engine == "CYCLES":
        stage.cycles.samples = min(stage.cycles.samples, 16)
        stage.cycles.max_bounces = min(stage.cycles.max_bounces, 1 if task.color in TINTED else 4)


def leaves_out(scene: bpy.types.Scene) -> bool:
    """Return whether the pictures leave out characters that renders of `scene` show."""
    return not scene.crowd_lod.render_source_characters and shows_characters(scene)


@contextlib.contextmanager
def sized(render: bpy.types.RenderSettings, size: tuple[int, int]) -> Iterator[None]:
    """Set the size of renders, (width, height) pixels, and restore it afterwards."""
    before = [getattr(render, name) for name in SIZE]
    try:
        render.resolution_x, render.resolution_y = size
        render.resolution_percentage = 100
        yield
    finally:
        for name, value in zip(SIZE, before, strict=True):
            setattr(render, name, value)


def shade(stage: bpy.types.Scene, color: str, light: str) -> None:
    """Set the solid shading of `stage`: its color type and its light, by Blender's names."""
    shading = stage.display.shading
    shading.color_type = color
    shading.light = light
    shading.show_shadows = shading.show_cavity = shading.show_object_outline = shading.show_xray = (
        False
    )
    shading.show_specular_highlight = False


class Rendered:
    """Pictures of the preview that Blender renders from the built crowd."""

    notes = ()

    def __init__(self, crowd: SceneCrowd, task: Preview):
        self.crowd = crowd
        self.stage = crowd.scene
        self.layer = self.stage.view_layers[0]
        self.task = task
        self.built = None
        tints = task.color in TINTED and task.engine != "WORKBENCH"
        self.tint = _tint_material() if tints else None
        self.tinted_points: list[bpy.types.Object] = []

    def prepare(self) -> Iterator[float]:
        yield from render_setup.build(self.crowd)
        # else it would follow each change of frame, and the frame's own times be those of a cache
        self.built = self.stage.crowd_lod.build
        self.stage.crowd_lod.build = None

    def place(self, frame: Frame) -> None:
        self.stage.crowd_lod.build = self.built
        frame_update.update(self.stage, self.layer.depsgraph)
        self.stage.crowd_lod.build = None
        if self.task.color == "ERROR":
            self._tint_by_error(frame)

    def _tint_by_error(self, frame: Frame) -> None:
        """Show copies of the LODs' points instead, an object for each color.

        Workbench knows no color but that of objects.
        """
        meshes = [item.data for item in self.tinted_points]
        removal.remove([*self.tinted_points, *meshes])
        self.tinted_points = []
        colors = by_error(frame)
        for bucket, points in points_of(self.built).items():
            if not bucket.is_seen:
                continue
            points.hide_render = True
            rows = mesh_data.read_points(points.data)
            tints = (
                colors.index[frame_update.indices_in(rows)]
                if "id" in rows
                else np.empty(0, np.uint8)
            )
            for tint in np.unique(tints):
                item = points.copy()
                del item[LEVEL]
                item.data = bpy.data.meshes.new(item.name)
                item.color = colors.palette[tint]
                item.hide_render = False
                mesh_data.write_points(
                    item.data, {key: values[tints == tint] for key, values in rows.items()}
                )
                for collection in points.users_collection:
                    collection.objects.link(item)
                self.tinted_points.append(item)

    def main(self, path: Path, caption: str) -> None:
        self.layer.material_override = self.tint
        _render(self.stage, path, ENGINES[self.task.engine])

    def above(self, path: Path, caption: str) -> None:
        self.layer.material_override = None  # it is a diagram
        self.built.hide_render = True
        _render(self.stage, path, ENGINES["WORKBENCH"])
        self.built.hide_render = False


def _render(stage: bpy.types.Scene, path: Path, engine: str) -> None:
    engine_before = stage.render.engine
    stage.render.engine = engine
    stage.render.filepath = str(path)
    # by override: with the operator's own argument `scene`, Blender renders the frame of the scene
    # in the window
    with image_data.check_written(path), bpy.context.temp_override(scene=stage):
        bpy.ops.render.render(write_still=True)
    stage.render.engine = engine_before  # the plan is that of the scene's own renders


def _world() -> bpy.types.World:
    """Return a world with an even light gray sky, in every engine."""
    world = bpy.data.worlds.new("Crowd LOD preview")
    world.color = GRAY
    nodes = switch_nodes_on(world).nodes
    background = next(node for node in nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*GRAY, 1.0)
    return world


def _tint_material() -> bpy.types.Material:
    """Return a material that shows each object's own color."""
    material = bpy.data.materials.new("Crowd LOD tint")
    tree = switch_nodes_on(material)
    tree.nodes.clear()
    info, surface, output = (
        tree.nodes.new(kind)
        for kind in ("ShaderNodeObjectInfo", "ShaderNodeBsdfDiffuse", "ShaderNodeOutputMaterial")
    )
    tree.links.new(info.outputs["Color"], surface.inputs["Color"])
    tree.links.new(surface.outputs["BSDF"], output.inputs["Surface"])
    return material
