"""Batch preview: two pictures and a table row per frame, plan, contact sheet."""

import contextlib
import hashlib
import json
import platform
import time as clock
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...crowd_lod import __version__
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import printable
from ...crowd_lod.levels.assignment import deviations
from ...crowd_lod.planning.frame import Frame
from ...crowd_lod.planning.frame_range import evenly, parse_frames
from ...crowd_lod.planning.index_cache import approach
from ...crowd_lod.progress import aside, share, standing
from ...crowd_lod.reporting import files, tables
from ...crowd_lod.reporting.html_report import page
from ...crowd_lod.validation.leave_out_timing import savings
from ..blender import cameras, cleanup, frame_stepping, image_data, scene_data
from ..blender.operator import Stepwise
from ..build import frame_update, render_setup, view_layers
from ..build.hidden_characters import shows_characters
from ..crowd import lights
from ..crowd.scene_crowd import characters_of, frame_of, groups_of, measure_groups, policy_of, store_groups, trajectory_of
from ..crowd.scene_world import bias_of, machine_of
from ..crowd.stuck_agents import find
from ..lod_meshes.deviation import measure_levels
from ..lod_meshes.make_lods import TINTS, make_levels
from ..overlay.playblast import Playblast, need_gpu
from . import lod_table, top_view

# What renders the pictures; the overlay's are drawn, and only the pictures of LODs rendered.
ENGINES = {"WORKBENCH": "BLENDER_WORKBENCH", "CYCLES": "CYCLES", "EEVEE": scene_data.EEVEE, "OVERLAY": "BLENDER_WORKBENCH"}
COLOR_MODES = ("LOD", "MATERIAL")  # that every engine has
MOST_IN_SHEET = 24  # frames on the contact sheet
BEHAVIOUR = 0.9  # of a frame's time, where the way to it is long
SIZE = "resolution_x", "resolution_y", "resolution_percentage"
# of the progress: LODs made or measured, the crowd built, all frames drawn
LEVELS, PREPARED, DRAWN = 0.1, 0.02, 0.9
GREY = (0.55, 0.58, 0.62)  # the sky of the tinted pictures, linear
LEFT_OUT = "The characters themselves are left out of the pictures (see Keep in Renders)."
THUMBNAIL = 480  # pixels wide, at least


@dataclass(frozen=True)
class Preview:
    """What to preview.

    frames: increasing.
    width: of the pictures, pixels.
    engine: one of ENGINES.
    color: one of COLOR_MODES; with the engine OVERLAY, a value of the setting overlay_color.
    """

    frames: list[int]
    folder: Path
    width: int = 960
    engine: str = "WORKBENCH"
    color: str = "LOD"


def preview(scene: bpy.types.Scene, wanted: Preview, command: list[str]) -> Generator[float, None, dict[str, Any]]:
    """Write the preview of `scene`: yield the progress, return the plan's dict.

    All is made in a copy of the scene, which is removed afterwards. The folder gets its files at
    the end, all or none.

    command: the command line of the run, for plan.json.
    """
    with files.staged(wanted.folder) as folder, cleanup.scratch(), contextlib.ExitStack() as opened:
        started = clock.perf_counter()
        # what is missing is named in the user's own scene
        cameras.active_camera(scene), characters_of(scene)
        drawn = wanted.engine == "OVERLAY"
        if drawn:
            need_gpu()
        stage = stage_of(scene, wanted)
        size = cameras.image_size(stage.render)
        for name in SIZE:  # LODs by pixels are those of the scene's own renders
            setattr(stage.render, name, getattr(scene.render, name))
        layer = stage.view_layers[0]
        layer.update()
        store_groups(stage.crowd_lod, measure_groups(stage))
        yield from standing(approach(trajectory_of(stage), scene_data.time_of(stage)), 0.0)
        # whatever is wrong with the scene is said before the work begins
        frame_of(stage, layer.depsgraph)
        ready = 0.0
        if stage.crowd_lod.levels is None or deviations(groups_of(stage.crowd_lod), policy_of(stage.crowd_lod)) is None:
            ready = LEVELS
            yield from share((make_levels if stage.crowd_lod.levels is None else measure_levels)(stage), 0.0, LEVELS)
        # nothing that these depend on changes from here on, and each look reads the whole map
        trajectory = trajectory_of(stage)
        shots = opened.enter_context(Playblast(stage, trajectory, size)) if drawn else Rendered(stage, wanted)
        yield from share(shots.prepare(), ready, ready + PREPARED)
        ready += PREPARED
        drawing = bpy.data.objects.new("Crowd LOD above", bpy.data.meshes.new("Crowd LOD above"))
        view = first = None
        stage.collection.objects.link(drawing)
        rows, pictures = [], []
        each = (DRAWN - ready) / len(wanted.frames)
        at = opened.enter_context(frame_stepping.stepped(scene))
        for done, number in enumerate(wanted.frames):
            time, begun = scene_data.remapped(scene.render, number), ready + each * done
            yield from share(approach(trajectory, time), begun, begun + BEHAVIOUR * each)
            filming = cameras.bound_camera(scene, time)
            stage.camera = cameras.still(filming, at((), time))
            scene.update_tag()  # what is driven by the scene follows it in the stage, too
            drawing.hide_render = drawing.hide_viewport = True
            stage.frame_set(number)
            frame = frame_of(stage, layer.depsgraph, around=lights.read_surroundings(stage, layer.depsgraph, number))
            ticks = [clock.perf_counter()]
            shots.place(frame)
            ticks.append(clock.perf_counter())
            main = folder / f"main_{number:04d}.png"
            _shade(stage, "TEXTURE" if wanted.color == "MATERIAL" else "OBJECT", "STUDIO")
            caption = stage.render.stamp_note_text = _caption(frame)
            with _sized(stage.render, size):
                shots.main(main, caption)
            ticks.append(clock.perf_counter())

            camera = stage.camera
            view = stage.crowd_lod.above or view or top_view.straight_down(stage, trajectory.world.area, frame.camera)
            with _sized(stage.render, size):
                layer.update()
                top_view.draw_crowd(drawing.data, frame, cameras.camera_from(view, stage.render, layer.depsgraph))
                drawing.hide_render = drawing.hide_viewport = False
                _shade(stage, "VERTEX", "FLAT")
                stage.camera = view
                shots.above(folder / f"above_{number:04d}.png", caption)
                stage.camera = camera
            ticks.append(clock.perf_counter())

            rows.append(tables.row(number, frame, dict(zip(("points", "main", "above"), np.diff(ticks) * 1000, strict=True))))
            pictures.append((main, folder / f"above_{number:04d}.png"))
            first = first or frame
            yield ready + each * (done + 1)
        told = lod_table.tables(stage, trajectory.groups, first.camera, first.begins, folder, (DRAWN, 0.95))
        told = yield from told
        notes = (*shots.notes, *filter(None, [leaves_out(scene) and LEFT_OUT, frame_stepping.unbaked(scene)]))
        plan = yield from standing(_plan(stage, scene, wanted, size, command, rows, told, notes), 0.95)
        plan["camera"] = filming.name
        plan["seconds"] = round(clock.perf_counter() - started, 3)
        (folder / "frames.csv").write_text(tables.to_csv(rows), encoding="utf-8")
        (folder / "plan.json").write_text(tables.to_json(plan), encoding="utf-8")
        (folder / "report.html").write_text(page(plan), encoding="utf-8")
        image_data.save_png(folder / "contact_sheet.png", _sheet(pictures))
        yield 1.0
        return plan


class Rendered:
    """Pictures of the preview that Blender renders from the built crowd."""

    notes = ()

    def __init__(self, stage: bpy.types.Scene, wanted: Preview):
        self.stage, self.layer, self.wanted, self.built = stage, stage.view_layers[0], wanted, None
        self.tint = _tint_material() if wanted.color == "LOD" and wanted.engine != "WORKBENCH" else None

    def prepare(self) -> Iterator[float]:
        yield from render_setup.build(self.stage)
        # else it would follow each change of frame, and the frame's own times be those of a cache
        self.built, self.stage.crowd_lod.build = self.stage.crowd_lod.build, None

    def place(self, frame: Frame) -> None:
        self.stage.crowd_lod.build = self.built
        frame_update.update(self.stage, self.layer.depsgraph)
        self.stage.crowd_lod.build = None

    def main(self, path: Path, caption: str) -> None:
        self.layer.material_override = self.tint
        _render(self.stage, path, ENGINES[self.wanted.engine])

    def above(self, path: Path, caption: str) -> None:
        self.layer.material_override = None  # it is a diagram
        self.built.hide_render = True
        _render(self.stage, path, ENGINES["WORKBENCH"])
        self.built.hide_render = False


def stage_of(scene: bpy.types.Scene, wanted: Preview) -> bpy.types.Scene:
    """Return a copy of `scene` set to render the wanted pictures.

    It shares the objects. The user's own build is left out. So are the characters themselves,
    unless they are kept in renders.
    """
    stage = scene.copy()
    stage.name = "Crowd LOD preview"
    stage.timeline_markers.clear()  # they would take the camera back in the picture from above
    scene_data.let_go(stage, "build")
    for layer in stage.view_layers if leaves_out(stage) else ():
        layer.update()
        view_layers.exclude(layer.layer_collection, stage.crowd_lod.characters)
    set_up(stage, wanted)
    return stage


def set_up(stage: bpy.types.Scene, wanted: Preview) -> None:
    """Set `stage` to render the wanted pictures."""
    render = stage.render
    height = max(1, round(wanted.width * render.resolution_y / render.resolution_x))
    render.resolution_x, render.resolution_y, render.resolution_percentage = wanted.width, height, 100
    render.use_border = render.use_multiview = render.use_compositing = render.use_sequencer = False
    render.use_motion_blur = False
    render.image_settings.file_format = "PNG"
    render.image_settings.color_mode, render.image_settings.color_depth = "RGB", "8"
    for name in dir(render):
        if name.startswith("use_stamp_"):
            setattr(render, name, name in ("use_stamp_frame", "use_stamp_note"))
    render.use_stamp = render.use_stamp_labels = True
    render.stamp_font_size = max(8, wanted.width // 60)
    render.stamp_background = (0, 0, 0, 0.6)
    # one pass; Workbench draws the whole scene anew for every other sample
    stage.display.render_aa = "FXAA"
    if wanted.engine == "OVERLAY":
        stage.crowd_lod.overlay_color = wanted.color
    if wanted.color != "MATERIAL":
        stage.view_settings.view_transform, stage.view_settings.look = "Standard", "None"
        stage.view_settings.exposure, stage.view_settings.gamma = 0, 1
        stage.world = _world()
    if wanted.engine == "CYCLES":
        stage.cycles.samples = min(stage.cycles.samples, 16)
        stage.cycles.max_bounces = min(stage.cycles.max_bounces, 1 if wanted.color == "LOD" else 4)


def leaves_out(scene: bpy.types.Scene) -> bool:
    """Return whether the pictures leave out characters that renders of `scene` show."""
    return not scene.crowd_lod.keep_characters and shows_characters(scene)


@contextlib.contextmanager
def _sized(render: bpy.types.RenderSettings, size: tuple[int, int]) -> Iterator[None]:
    """Set the size of renders, (width, height) pixels, and restore it afterwards."""
    before = [getattr(render, name) for name in SIZE]
    try:
        render.resolution_x, render.resolution_y, render.resolution_percentage = *size, 100
        yield
    finally:
        for name, value in zip(SIZE, before, strict=True):
            setattr(render, name, value)


def _world() -> bpy.types.World:
    """Return a world with an even light gray sky, in every engine."""
    world = bpy.data.worlds.new("Crowd LOD preview")
    world.color = GREY
    world.use_nodes = True
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*GREY, 1.0)
    return world


def _tint_material() -> bpy.types.Material:
    """Return a material that shows each object's own color."""
    material = bpy.data.materials.new("Crowd LOD tint")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    info, surface, output = (
        tree.nodes.new(kind) for kind in ("ShaderNodeObjectInfo", "ShaderNodeBsdfDiffuse", "ShaderNodeOutputMaterial")
    )
    tree.links.new(info.outputs["Color"], surface.inputs["Color"])
    tree.links.new(surface.outputs["BSDF"], output.inputs["Surface"])
    return material


def _shade(stage: bpy.types.Scene, color: str, light: str) -> None:
    shading = stage.display.shading
    shading.color_type, shading.light = color, light
    shading.show_shadows = shading.show_cavity = shading.show_object_outline = shading.show_xray = False
    shading.show_specular_highlight = False


def _render(stage: bpy.types.Scene, path: Path, engine: str) -> None:
    own, stage.render.engine, stage.render.filepath = stage.render.engine, engine, str(path)
    # by override: with the operator's own argument `scene`, Blender renders the frame of the scene
    # in the window
    with image_data.writing(path), bpy.context.temp_override(scene=stage):
        bpy.ops.render.render(write_still=True)
    stage.render.engine = own  # the plan is that of the scene's own renders


def _caption(frame: Frame) -> str:
    seen = int(frame.visible.sum())
    counts = "  ".join(f"LOD{k} {n:,}" for k, n in enumerate(frame.buckets.counts))
    return f"{len(frame.crowd):,} agents  {seen:,} visible ({seen / len(frame.crowd):.1%})  {counts}  {frame.triangles:,} tris"


def _sheet(pictures: list[tuple[Path, Path]]) -> np.ndarray:
    """Return the contact sheet, two frames in a row.

    Each has its main picture and the picture from above. Of a long shot it has MOST_IN_SHEET
    frames, evenly spaced.
    """
    chosen = evenly(pictures, MOST_IN_SHEET)
    shrunk = [tables.shrink(image_data.load_pixels(path), THUMBNAIL) for pair in chosen for path in pair]
    return tables.contact_sheet(shrunk, columns=4 if len(chosen) > 1 else 2)


def _plan(  # noqa: PLR0913 - the parts of what the file tells
    stage, scene, wanted: Preview, size: tuple[int, int], command: list[str], rows: list[dict], characters: list[dict], notes
) -> Generator[float, None, dict[str, Any]]:
    """Make plan.json's dict: all that is needed to repeat the run, and its results.

    Yields between the steps and returns the dict.
    """
    settings, trajectory, policy = stage.crowd_lod, trajectory_of(stage), policy_of(stage.crowd_lod)
    machine = machine_of(settings)
    labels = trajectory.world.labels
    area = trajectory.world.area
    troubles = yield from aside(lambda: find(trajectory))
    file = Path(bpy.data.filepath) if bpy.data.filepath else None
    return {
        "version": tables.PLAN_VERSION,
        "command": command,
        "made_with": {
            "crowd_lod": __version__,
            "blender": bpy.app.version_string,
            "python": platform.python_version(),
            "numpy": np.__version__,
        },
        "scene": {
            "name": scene.name,
            "file": printable(file) if file else None,
            "sha256": hashlib.sha256(file.read_bytes()).hexdigest() if file and file.is_file() else None,
        },
        "crowd": {
            "count": settings.count,
            "seed": settings.seed,
            "area": {"x": [area.x_min, area.x_max], "y": [area.y_min, area.y_max], "z": area.z},
            "forward": settings.forward,
            "first_frame": settings.first_frame,
            "frames_per_second": 1 / trajectory.seconds_per_frame,
            "groups": [vars(group) for group in trajectory.groups],
        },
        "map": {
            "image": settings.map_image.name if settings.map_image else None,
            "cells": list(labels.shape[::-1]),
            "sha256": hashlib.sha256(labels.tobytes()).hexdigest(),
        },
        "height": {
            "image": settings.height_image.name if settings.height_image else None,
            "scale": settings.height_scale,
            "tilt": settings.tilt,
        },
        "machine": json.loads(machine.text),
        "trouble": troubles.rows,
        "trouble_says": troubles.sentence,
        "camera": None,
        "levels": {
            "metric": policy.metric,
            "margin": policy.margin,
            "tolerance": policy.tolerance,
            "shading_counts": policy.shading,
            "pixels": cameras.image_size(stage.render),
            "ratios": [round(r, 6) for r in settings.ratios[: policy.count]] if policy.tolerance is None else None,
            "thresholds": list(policy.thresholds) if policy.tolerance is None else None,
            "group_thresholds": [list(own) for own in policy.group_thresholds],
            "drop_lost": policy.drop_lost,
            "tints": TINTS[: policy.count],
            "characters": characters,
            "dropped": settings.dropped.splitlines(),
        },
        "preview": {
            "frames": wanted.frames,
            "width": wanted.width,
            "height": size[1],
            "engine": wanted.engine,
            "colour": wanted.color,
            "notes": list(notes),
        },
        "left_out": (yield from _left_out(stage, wanted)),
        "frames": rows,
    }


def _left_out(stage: bpy.types.Scene, wanted: Preview) -> Generator[float, None, list[dict[str, Any]]]:
    """List what the scene did not need: yield between the steps, return dicts.

    Each has the reason and, where measured, the milliseconds saved in the last frame.
    """
    number, stage.render.engine = wanted.frames[-1], ENGINES[wanted.engine]
    trajectory, settings = trajectory_of(stage), stage.crowd_lod
    stage.frame_set(number)
    eyes = cameras.read_cameras(stage, stage.view_layers[0].depsgraph)
    bias = bias_of(settings, trajectory.world.area)
    time = max(number, trajectory.first_frame + 2)
    policy = policy_of(settings)
    found = yield from aside(lambda: savings(trajectory, eyes, policy, time, (), bias))
    measured = [
        {"stage": item.stage, "reason": item.reason, "ms_saved": round(ms, 3), "ms_spread": round(found.spread[item], 3)}
        for item, ms in found.items.items()
    ]
    unseen = lights.read_surroundings(stage, stage.view_layers[0].depsgraph, number).left_out
    return measured + [{"stage": item.stage, "reason": item.reason, "ms_saved": None, "ms_spread": None} for item in unseen]


class CROWDLOD_OT_preview(Stepwise, bpy.types.Operator):
    """Render pictures from the camera and from above, with a report, into a folder"""

    bl_idname = "crowd_lod.preview"
    bl_label = "Preview"
    bl_options = {"REGISTER"}

    def steps(self, context) -> Generator[float, None, str]:
        settings = context.scene.crowd_lod
        if settings.folder.startswith("//") and not bpy.data.filepath:
            raise CrowdError(
                f"The output folder {settings.folder} is beside a file that was never saved: save it, or choose a folder."
            )
        wanted = Preview(
            frames=parse_frames(settings.frames, settings.step),
            folder=files.absolute(Path(bpy.path.abspath(settings.folder))),
            width=settings.width,
            engine=settings.engine,
            color=settings.overlay_color if settings.engine == "OVERLAY" else settings.color,
        )
        yield from preview(context.scene, wanted, ["sidebar"])
        said = f"{len(wanted.frames)} frames are in {printable(wanted.folder)}."
        return f"{said} {LEFT_OUT}" if leaves_out(context.scene) else said


CLASSES = (CROWDLOD_OT_preview,)
