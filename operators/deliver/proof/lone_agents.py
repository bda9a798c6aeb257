"""Crops of single agents at the size of the final picture: at full detail, and as they were
built.
"""

import re
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ....crowd_lod.culling.camera import Camera, Window
from ....crowd_lod.output import file_checks
from ....crowd_lod.progress import run_in_thread
from ....crowd_lod.srgb import encoded
from ....crowd_lod.validation import silhouette
from ....crowd_lod.validation.judged_agents import JudgedAgent
from ....crowd_lod.validation.render_proof import describe_difference, worst_agents
from ...blender import console, image_data, mesh_data, removal, scene_data
from ...build.appended_builds import STAGE
from ...build.nodes import trees
from ..preview.lettering import labeled_sheet
from .verify_pictures import AGENT_TITLES, amplified

SAMPLES = 4  # a pixel
# settings of the scene's renders
TAKEN_OVER = (
    "fps",
    "fps_base",
    "frame_map_old",
    "frame_map_new",
    "use_simplify",
    "simplify_subdivision_render",
)
# pixels of a crop across the shift that is allowed, as far as its larger side then has no more than
# LARGEST; a pixel of the final picture has one at least
ACROSS = 8
LARGEST = 600
MOST_FINER = 32  # pixels of a crop in one of the final picture, along each axis
ERROR = 1.0  # pixels of a crop by which a shift between two of them errs, see silhouette.shift
# of 1, encoded as sRGB: by how much the mean color of an agent may be off. LODs of people
# are off by 0.003, of shiny balls by 0.07 (docs/notes/shot_plan.md)
COLOR_OFF = 0.1
TILE = 480  # pixels of a crop's larger side in the picture of all of them
BEHIND = 0.4  # behind the agents in that picture, sRGB


@dataclass(frozen=True)
class Shown:
    """An agent on a point object of a build.

    points: the object.
    row: its attributes, one row, for mesh_data.write_points.
    """

    points: bpy.types.Object
    row: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class LoneCrop:
    """Two pictures of an agent, (rows, columns, 4) float32, linear, and what they show.

    facts: a dict for JSON, see `facts_of`.
    """

    full: np.ndarray
    as_built: np.ndarray
    facts: dict[str, Any]


class LoneStage:
    """A scene in which one agent at a time stands alone, lit from the camera.

    It has no motion blur and a box pixel filter: the deviation of LODs is of sharp silhouettes.

    folder: for the pictures that are rendered and read again.
    """

    def __init__(self, scene: bpy.types.Scene, folder: Path):
        self.stage = bpy.data.scenes.new(".Crowd LOD lone agent")
        self.path = folder / "lone_agent.exr"
        self.stage[STAGE] = True
        render = self.stage.render
        cycles = self.stage.cycles
        own = scene.render
        for name in TAKEN_OVER:
            setattr(render, name, getattr(own, name))
        render.engine = "CYCLES"
        render.film_transparent = True
        render.resolution_percentage = 100
        render.image_settings.file_format = "OPEN_EXR"
        render.image_settings.color_mode = "RGBA"
        render.image_settings.color_depth = "32"
        cycles.device = "CPU"
        cycles.samples = SAMPLES
        cycles.max_bounces = 0
        cycles.use_adaptive_sampling = cycles.use_denoising = False
        cycles.pixel_filter_type = "BOX"
        cycles.seed = 0
        self.camera = bpy.data.objects.new("Crowd LOD lone", bpy.data.cameras.new("Crowd LOD lone"))
        self.sun = bpy.data.objects.new(
            "Crowd LOD lone", bpy.data.lights.new("Crowd LOD lone", "SUN")
        )
        self.sun.data.energy = np.pi
        for item in (self.camera, self.sun):
            self.stage.collection.objects.link(item)
        self.stage.camera = self.camera

    def look(self, camera: Camera, window: Window, size: tuple[int, int]) -> None:
        """Look through the `window` of a perspective or orthographic camera, with `size` pixels."""
        data = self.camera.data
        wide = window.right - window.left
        data.type = camera.kind
        data.sensor_fit = "HORIZONTAL"
        data.clip_start = camera.near
        data.clip_end = camera.far
        if camera.kind == "ORTHO":
            data.ortho_scale = wide
        else:
            data.lens = max(36 / wide, 1.0)
            data.sensor_width = wide * data.lens
        data.shift_x = (window.left + window.right) / 2 / wide
        data.shift_y = (window.bottom + window.top) / 2 / wide
        for item in (self.camera, self.sun):
            scene_data.look_at(item, camera.origin, camera.X, camera.Y, camera.Z)
        self.stage.render.resolution_x, self.stage.render.resolution_y = size

    def render(self, number: int, agent: Shown | None) -> np.ndarray:
        """Return the picture of the agent at the frame `number`, (rows, columns, 4) float32,
        linear.

        None is nobody.
        """
        width = self.stage.render.resolution_x
        height = self.stage.render.resolution_y
        if agent is None:
            return np.zeros((height, width, 4), np.float32)
        with removal.scratch():
            self.stage.collection.objects.link(_alone(agent))
            self.stage.frame_set(number)
            self.stage.render.filepath = str(self.path)
            with console.quiet(), bpy.context.temp_override(scene=self.stage):
                bpy.ops.render.render(write_still=True)
            file_checks.check(self.path)
            values = image_data.read_values(bpy.data.images.load(str(self.path)))
        self.path.unlink()
        return values


def _alone(agent: Shown) -> bpy.types.Object:
    """Return a copy of the agent's point object that has this point alone.

    It instances the one character that the point shows from a collection of that alone, so that
    Blender evaluates no rig but its own.
    """
    alone = agent.points.copy()
    alone.data = bpy.data.meshes.new(alone.name)
    row = dict(agent.row)
    modifier = next(
        (m for m in alone.modifiers if m.type == "NODES" and trees.is_ours(m.node_group)), None
    )
    inputs = scene_data.node_inputs(modifier).values() if modifier else ()
    shelf = next((value for value in inputs if isinstance(value, bpy.types.Collection)), None)
    if shelf is not None and len(shelf.children) and "pose" in row:
        characters = sorted(shelf.children, key=_natural)
        lone = bpy.data.collections.new("Crowd LOD lone")
        lone.children.link(characters[int(row["pose"][0]) % len(characters)])
        scene_data.set_node_input(modifier, "Characters", lone)
        row["pose"] = np.zeros(1, np.int32)
    mesh_data.write_points(alone.data, row)
    return alone


def _natural(collection: bpy.types.Collection) -> list:
    """Return the key by which geometry nodes order collections: numbers in names as numbers."""
    parts = re.split(r"(\d+)", collection.name.casefold())
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts if part]


def lone_crop(
    stage: LoneStage, number: int, judged: JudgedAgent, pair: tuple[Shown, Shown | None]
) -> Generator[float, None, LoneCrop]:
    """Crop one of the chosen agents at the frame `number`: yield the progress, return the crop.

    pair: the agent at full detail and as it was built.
    """
    finer, window, size = _finer(judged)
    stage.look(judged.camera, window, size)
    full = stage.render(number, pair[0])
    yield 0.0
    as_built = stage.render(number, pair[1])
    yield 0.0
    facts = yield from run_in_thread(partial(facts_of, judged, full, as_built, finer))
    return LoneCrop(full, as_built, facts)


def _finer(judged: JudgedAgent) -> tuple[float, Window, tuple[int, int]]:
    """Return (pixels of the crop in one of the final picture, the crop's window, its size)."""
    window = judged.window
    density = judged.camera.pixels_per_unit
    side = density * max(window.right - window.left, window.top - window.bottom)
    finer = min(MOST_FINER, ACROSS / max(judged.allowed or 1.0, 1e-6), LARGEST / side)
    finer = max(finer, 1.0)
    columns, rows = (
        max(1, int(np.ceil(extent * density * finer)))
        for extent in (window.right - window.left, window.top - window.bottom)
    )
    right = window.left + columns / density / finer
    top = window.bottom + rows / density / finer
    return finer, Window(window.left, right, window.bottom, top), (columns, rows)


def facts_of(
    judged: JudgedAgent, full: np.ndarray, lod: np.ndarray, finer: float
) -> dict[str, Any]:
    """Return the figures of an agent, for JSON.

    shift_px, error_px: by how many pixels of the final picture its silhouette lies off, and by how
        many that may be wrong. At most the crop's diagonal.
    color_off: by how much its mean color is off, of 1, encoded as sRGB. A pixel counts as white at
        most: a glint of the sun, thousands of times as bright, would outweigh all others.
    ok: whether both are within what is allowed; None where that is not known, or it stands apart.

    full, lod: its pictures, `finer` times as fine as the final one.
    """
    most = float(np.hypot(*full.shape[:2]))
    shift = min(silhouette.shift(full[..., 3], lod[..., 3]), most) / finer
    error = ERROR / finer
    solid = np.minimum(full[..., 3], lod[..., 3]) >= silhouette.SOLID
    colors = (
        [encoded(each[solid][:, :3].clip(0, 1).mean(axis=0)) for each in (full, lod)]
        if solid.any()
        else [np.zeros(3)] * 2
    )
    color_off = float(np.abs(colors[0] - colors[1]).max())
    right = judged.allowed is None or shift - error <= judged.allowed
    unknown = judged.apart != "" or (judged.allowed is None and color_off <= COLOR_OFF)
    return {
        "agent": judged.agent,
        "group": judged.group,
        "lod": judged.level,
        "shift_px": shift,
        "error_px": error,
        "predicted_px": judged.predicted,
        "allowed_px": judged.allowed,
        "apart": judged.apart,
        "color_off": color_off,
        "ok": None if unknown else right and color_off <= COLOR_OFF,
    }


def sheet_of(crops: Sequence[LoneCrop]) -> Generator[float, None, np.ndarray]:
    """Draw the worst crops, the worst first: yield between steps, return the picture.

    It is (rows, columns, 4) uint8.
    Side by side: at full detail, as built, and where they differ, amplified.
    """
    tiles = []
    labels = []
    for k in worst_agents([crop.facts for crop in crops]):
        crop = crops[k]
        step = max(1, int(np.ceil(max(crop.full.shape[:2]) / TILE)))
        tiles += yield from run_in_thread(partial(_tiles, crop, step))
        labels.append(
            f"Agent {crop.facts['agent']:,}\nLOD {crop.facts['lod']}\n"
            + describe_difference(crop.facts)
        )
    return (yield from labeled_sheet(tiles, len(AGENT_TITLES), AGENT_TITLES, labels))


def _tiles(crop: LoneCrop, step: int) -> list[np.ndarray]:
    """Return the crop's two pictures and how they differ, each (rows, columns, 4) uint8.

    step: pixels of the crop in one of these.
    """
    pair = [_over_gray(values[::step, ::step]) for values in (crop.full, crop.as_built)]
    return [*pair, amplified(*(picture / np.float32(255) for picture in pair))]


def _over_gray(values: np.ndarray) -> np.ndarray:
    """Return linear values (rows, columns, 4) over gray, as (rows, columns, 4) uint8, sRGB."""
    alpha = values[..., 3:].clip(0, 1)
    color = encoded(values[..., :3].clip(0, 1)) + (1 - alpha) * BEHIND
    color = np.concatenate([color.clip(0, 1), np.ones_like(alpha)], axis=2)
    return np.rint(255 * color).astype(np.uint8)
