"""Proof by renders: the same frames with and without culling and LOD, compared."""

from collections.abc import Generator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...crowd_lod.culling.camera import Camera
from ...crowd_lod.culling.stereo import EYES
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted
from ...crowd_lod.planning.frame import Frame
from ...crowd_lod.planning.frame_range import evenly
from ...crowd_lod.planning.index_cache import approach
from ...crowd_lod.planning.planned import HIDDEN, noted, told_unplanned
from ...crowd_lod.progress import share, standing
from ...crowd_lod.reporting import file_checks, tables
from ...crowd_lod.reporting.frame_parts import FrameParts
from ...crowd_lod.reporting.verify_report import verify_page
from ...crowd_lod.sorting.buckets import sort
from ...crowd_lod.validation import image_difference
from ..blender import cameras, cleanup, console, frame_stepping, image_data, mesh_data, scene_data
from ..build import bake, render_setup
from ..build.frame_update import Held, held_by, members
from ..crowd import lights
from ..crowd.glow import glowing
from ..crowd.record_points import on_record
from ..crowd.scene_crowd import characters_of, frame_of, groups_of, measure_groups, policy_of, store_groups, trajectory_of
from ..lod_meshes.make_lods import make_levels
from .shared_frames import ALONE, Sharing, made, state_of
from .verify_stage import LONGEST_SHUTTER, PAIRS, Verify, add_twins, dark_world, light_by, outline_of, put_cameras, set_up_cycles

# The pictures of a frame. The third is the culled one without those whom the camera does not see
# itself.
PICTURES = {
    "a": "all agents, full detail",
    "b": "culled, full detail",
    "bare": "culled, without shadows and reflections from outside the picture",
    "c": "culled, with LODs",
}
COMPARED = "b", "bare", "c"  # with "a"
AMPLIFIED, FAINTEST = 16, 60  # in the pictures of differences: times, and at least, of 255
# of linear light: how far off Cycles' rounding may be that displaces a mesh where one of its
# instances stands
DISPLACED = 1e-3
LODS_MADE = 0.05  # of the progress: LODs made
MOST_PROVED_IN_SHEET = 8  # frames on the contact sheet


@on_record(lambda scene, wanted, *_: wanted.frames)
def verify(
    scene: bpy.types.Scene, wanted: Verify, command: list[str], sharing: Sharing = ALONE
) -> Generator[float, None, dict[str, Any]]:
    """Write the proof for `scene`: yield the progress, return verify.json's dict.

    The scene itself is stepped and rendered, because a copy lacks some of what its frames show.
    Afterwards it is restored. The folder gets its files at the end, all or none.

    command: the command line of the run, for verify.json.
    sharing: which part of it is done here; of a part of the frames, only their rows are returned.
    """
    if not hasattr(scene, "cycles"):
        raise CrowdError("The frames are rendered with Cycles: enable the add-on Cycles Render Engine in the preferences.")
    own, groups = scene.crowd_lod, groups_of(scene.crowd_lod)
    with ExitStack() as opened:
        folder = opened.enter_context(sharing.opened(wanted.folder))
        opened.callback(store_groups, own, groups)
        opened.enter_context(cleanup.scratch())
        layer = scene.view_layers[0]
        lent = scene.render, scene.render.image_settings, scene.cycles, scene.display, scene.view_settings, own, *scene.view_layers
        opened.enter_context(cleanup.lent(*lent, *filter(None, (own.build, own.characters))))
        opened.callback(setattr, scene, "world", scene.world)
        # what is missing is named before anything is set
        cameras.active_camera(scene), characters_of(scene)
        left_out, not_proved = _never_shown(scene), _not_proved(scene, wanted)
        for material in {material for worn in glowing(scene).values() for material in worn}:
            opened.callback(setattr, material.cycles, "emission_sampling", material.cycles.emission_sampling)
            # rays that are aimed at lights meet others where fewer agents glow: the noise would differ
            material.cycles.emission_sampling = "NONE"
        set_up_cycles(scene, wanted)
        layer.update()
        store_groups(own, measure_groups(scene))
        trajectory = trajectory_of(scene)
        yield from standing(approach(trajectory, scene_data.time_of(scene)), 0.0)
        # whatever is wrong with the scene is said before the work begins
        frame_of(scene, layer.depsgraph)
        if own.levels is None:
            yield from share(make_levels(scene), 0.0, LODS_MADE)
        sharing.save(folder)
        # also of LODs that are left out to save memory: they are what is proved
        run = _Run(scene, wanted, folder, opened.enter_context(frame_stepping.stepped(scene)))
        parts = FrameParts(folder, state_of(scene, wanted))
        with sharing.helped(parts, wanted.frames) as helpers:
            found = yield from share(made(parts, wanted.frames, sharing, run.prepare, run.prove, helpers), LODS_MADE, 0.95)
        rows, unplanned = [each["row"] for each in found], [tuple(each["unplanned"]) for each in found]
        if sharing.part is not None:
            return {"frames": rows, "ok": True}
        result = _result(
            rows,
            wanted,
            command,
            left_out + _left_out(scene, rows, wanted) + [told_unplanned(unplanned)] * any(why for _, why in unplanned),
            not_proved,
        )
        (folder / "verify.json").write_text(tables.to_json(result), encoding="utf-8")
        (folder / "verify.csv").write_text(tables.to_csv(rows), encoding="utf-8")
        title = Path(bpy.data.filepath).stem or scene.name
        (folder / "report.html").write_text(verify_page(title, result), encoding="utf-8")
        shown = [path for number in evenly(wanted.frames, MOST_PROVED_IN_SHEET) for path in run.pictures(number)]
        tiles = [image_data.load_pixels(path) for path in shown]
        image_data.save_png(folder / "contact_sheet.png", tables.contact_sheet(tiles, columns=len(PICTURES) + 3))
        yield 1.0
        return result


@dataclass
class _Run:
    """A proof while it is made.

    folder: where the files lie until all are made.
    at: steps the scene.
    top: the build, once it is made.
    outline: see outline_of.
    """

    scene: bpy.types.Scene
    wanted: Verify
    folder: Path
    at: frame_stepping.At
    top: bpy.types.Collection | None = None
    outline: bpy.types.Scene | None = None

    def prepare(self) -> Generator[float, None, None]:
        """Build the crowd of all LODs: yield the progress."""
        scene, own = self.scene, self.scene.crowd_lod
        # also of LODs that are left out to save memory: they are what is proved
        yield from render_setup.build(scene, [range(2**31)] * policy_of(own).count)
        bake.mark(scene, self.wanted.frames)  # with motion blur its points move by themselves
        render_setup.dress_all(scene)
        self.top, own.build = own.build, None  # it holds what is written here, not what the frame asks
        self.outline = outline_of(scene, self.top)
        add_twins(scene, self.top)

    def pictures(self, number: int) -> list[Path]:
        """Return the files of a frame's pictures, in the order of the contact sheet."""
        endings = ("", "_bounces") if self.wanted.bounces else ("",)
        names = [*PICTURES, *(f"a_{name}" for name in COMPARED)]
        return [self.folder / f"frame_{number:04d}_{name}{ending}.png" for ending in endings for name in names]

    def prove(self, number: int) -> Generator[float, None, tuple[dict[str, Any], list[Path]]]:
        """Verify one frame: yield the progress, return (what is told of it, its pictures); see FrameParts.put."""
        scene, wanted, folder, outline = self.scene, self.wanted, self.folder, self.outline
        trajectory, time = trajectory_of(scene), scene_data.remapped(scene.render, number)
        yield from share(approach(trajectory, time), 0.0, 0.5 / len(PICTURES))
        film, around, shutter = lights.read_moment(scene, time, self.at)
        depsgraph = self.at((), time)
        planned, full = (
            frame_of(scene, depsgraph, time, film, trajectory, each, shutter)
            for each in (around, replace(around, level=0, finest=()))
        )
        frames = _variants(planned, full)
        put_cameras(outline, scene, depsgraph)
        outline.frame_set(number)
        total, so_far = 2 * len(frames) if wanted.bounces else len(frames), 0
        held = held_by(scene, trajectory, number, planned.crowd)
        worlds = scene.world, dark_world(scene.world)
        row = {
            "frame": number,
            "agents": len(planned.crowd),
            "visible": int(planned.visible.sum()),
            "shadow": len(planned.shadow.order),
            "mirrored": len(planned.mirrored.order),
        }
        masks = {}
        for bounces in (0, wanted.bounces)[: 1 + (wanted.bounces > 0)]:
            light_by(scene, bounces, worlds)
            ending = "_bounces" if bounces else ""
            shot = {}
            for name, frame in frames.items():
                _write(scene, self.top, trajectory, frame, number, held)
                shot[name] = _render(scene, folder / f"frame_{number:04d}_{name}{ending}.png")
                if not bounces and name in ("a", "c"):
                    masks[name] = _render(outline, folder / f"outline_{number:04d}.png")[..., 3]
                so_far += 1
                yield so_far / total
            for name in COMPARED:
                found = image_difference.between(shot["a"], shot[name])
                row |= {f"{name}{ending}_{key}": value for key, value in vars(found).items()}
                picture = _amplified(shot["a"], shot[name])
                image_data.save_png(folder / f"frame_{number:04d}_a_{name}{ending}.png", picture)
        scene.world = worlds[0]
        (folder / f"outline_{number:04d}.png").unlink()
        shift, predicted = _shifts(scene, planned, film, masks)
        row |= {"silhouette_shift": shift, "predicted_shift": predicted}
        row["culling_ok"] = row["b_pixels"] == 0 or (row["b_largest"] <= DISPLACED and bool(_displaced(scene)))
        row["lod_ok"] = predicted is None or shift <= predicted + 1
        return {"row": row, "unplanned": noted(number, planned.unplanned, wanted.strict)}, self.pictures(number)


def _shifts(
    scene: bpy.types.Scene, planned: Frame, film: Sequence[Camera], masks: dict[str, np.ndarray]
) -> tuple[float, float | None]:
    """Return by how many pixels the silhouettes moved, and what was predicted; None if nothing was.

    masks: the crowd's silhouettes at full detail, "a", and with LODs, "c".
    """
    eyes = len(_views(scene.render))
    shift = max(image_difference.shift(*pair) for pair in zip(*(np.split(masks[name], eyes, axis=1) for name in "ac"), strict=True))
    each = [image_difference.predicted(replace(planned, eyes=(camera,))) for camera in film]
    return shift, None if None in each else max(each)


def _write(stage, home: bpy.types.Collection, trajectory, frame: Frame, number: int, held: Held) -> None:
    """Write the agents of the frame's buckets to the point objects in `home`.

    With motion blur, the points also get velocities.
    """
    points = render_setup.points_of(home)
    for name, agents in members(frame).items():
        library = render_setup.library_of(home, points[name], trajectory.gaits)
        columns = bake.columns_in_time(trajectory, held, number, agents, library)
        mesh_data.write_points(points[name].data, columns)


def _variants(planned: Frame, full: Frame) -> dict[str, Frame]:
    """Return a Frame for each of PICTURES.

    planned: the frame's plan.
    full: the same, with the finest LOD also for agents that the camera does not see itself.
    """
    count = len(planned.buckets.counts)
    finest = np.zeros(len(planned.crowd), np.uint8)
    nobody = sort(np.zeros(len(planned.crowd), bool), finest, count)
    everyone = np.isfinite(planned.crowd.places()).all(axis=0) & (planned.visible | planned.culled)
    if planned.plan_row is not None:  # who is hidden by an exception is not there
        everyone &= planned.plan_row & HIDDEN == 0
    culled = replace(full, buckets=sort(planned.visible, finest, count))
    return {
        "a": replace(full, buckets=sort(everyone, finest, count), shadow=nobody, mirrored=nobody),
        "b": culled,
        "bare": replace(culled, shadow=nobody, mirrored=nobody),
        "c": planned,
    }


def _views(render: bpy.types.RenderSettings) -> list[str]:
    """Return the file suffixes of the picture's views, such as the eyes of stereo."""
    if not render.use_multiview:
        return [""]
    stereo = render.views_format == "STEREO_3D"
    return [view.file_suffix for view in render.views if view.use and (view.name in EYES or not stereo)]


def _render(stage: bpy.types.Scene, path: Path) -> np.ndarray:
    """Render to the PNG `path`; return the linear values, (rows, columns, 4) float32.

    The bottom row is first. The views of a stereo picture stand side by side.
    """
    render, settings = stage.render, stage.render.image_settings
    stem = path.with_suffix("")
    with console.quiet(), bpy.context.temp_override(scene=stage):
        settings.file_format, settings.color_depth, render.filepath = "OPEN_EXR", "32", f"{stem}.exr"
        bpy.ops.render.render(write_still=True)
    settings.file_format, settings.color_depth = "PNG", "8"
    values, shown = [], []
    for view in _views(render):
        raw, seen = Path(f"{stem}{view}.exr"), Path(f"{stem}{view}.png")
        file_checks.check(raw)
        image = bpy.data.images.load(str(raw))
        try:
            values.append(image_data.read_values(image))
            with image_data.writing(seen):
                image.save_render(str(seen), scene=stage)
            shown.append(image_data.load_pixels(seen))
        finally:
            bpy.data.images.remove(image)
        raw.unlink()
        seen.unlink()
    image_data.save_png(path, np.concatenate(shown, axis=1))
    return np.concatenate(values, axis=1)


def _amplified(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the amplified difference of two pictures, (rows, columns, 4) uint8.

    Black is no difference. Any other is at least FAINTEST.
    """
    off = np.abs(a - b)
    shown = np.rint(255 * (AMPLIFIED * off).clip(0, 1)).astype(np.uint8)
    shown[off > 0] = np.maximum(shown[off > 0], FAINTEST)
    shown[..., 3] = 255
    return shown


def _never_shown(scene: bpy.types.Scene) -> list[str]:
    """Return sentences on what the pictures cannot show as renders of `scene` do."""
    render, said = scene.render, []
    if render.use_motion_blur and render.motion_blur_shutter > LONGEST_SHUTTER:
        said.append(f"The shutter was open for {LONGEST_SHUTTER:g} frames, not {render.motion_blur_shutter:g}.")
    if render.use_multiview and not PAIRS:
        said.append("Only one eye was rendered: this Blender version cannot read stereo pictures back.")
    return said + list(filter(None, [frame_stepping.unbaked(scene)]))


def _not_proved(scene: bpy.types.Scene, wanted: Verify) -> list[str]:
    """Return short phrases for what this run does not prove of a render of `scene`.

    Call it before the scene is set up.
    """
    render, (width, height) = scene.render, cameras.image_size(scene.render)
    found = ["other frames"]
    if wanted.bounces:
        found.append(f"more than {counted(wanted.bounces, 'bounce')} of light")
    else:
        found.append("the light of the sky and of bounces")
    if width != wanted.width:
        found.append(f"pictures of {width} x {height} pixels")
    if render.engine != "CYCLES":
        found.append(f"shading, pixel filter and displacement in {render.engine.removeprefix('BLENDER_')}")
    if render.use_compositing or render.use_sequencer:
        found.append("compositing and sequencer")
    return found + ["denoising"] * (render.engine == "CYCLES" and scene.cycles.use_denoising)


def _displaced(scene: bpy.types.Scene) -> list[str]:
    """Return names of materials that displace meshes in Cycles, not only as bumps."""
    slots = (slot for item in scene.crowd_lod.characters.all_objects for slot in item.material_slots)
    worn = {slot.material for slot in slots if slot.material is not None and slot.material.node_tree is not None}
    return sorted(each.name for each in worn if each.displacement_method != "BUMP" and _has_displacement(each.node_tree))


def _has_displacement(tree: bpy.types.NodeTree) -> bool:
    return any(node.type == "OUTPUT_MATERIAL" and node.inputs["Displacement"].is_linked for node in tree.nodes)


def _left_out(scene: bpy.types.Scene, rows: list[dict], wanted: Verify) -> list[str]:
    """Return sentences on what the pictures left unjudged."""
    said = list(filter(None, [tables.nobody_seen(row["visible"] for row in rows)]))
    if any(row["predicted_shift"] is None for row in rows):
        said.append(
            "Silhouettes were not judged: an agent stands at the camera, a LOD is not measured, or the lens bends the picture."
        )
    displaced = _displaced(scene)
    if displaced:
        said.append(
            f"Meshes of {', '.join(displaced[:3])} are displaced by Cycles where one of their instances stands, another one with "
            f"culling, so differences of up to {DISPLACED:g} were not counted."
        )
    mirrors = lights.read_surroundings(scene, scene.view_layers[0].depsgraph, scene_data.time_of(scene)).mirrors
    if wanted.bounces > 1 and len(mirrors) > 1:
        said.append("Reflections of one mirror in another are not checked: pixels may differ there.")
    return said


def _result(rows: list[dict], wanted: Verify, command: list[str], left_out: list[str], not_proved: list[str]) -> dict:
    """Return the dict of verify.json."""
    return {
        "version": 1,
        "command": command,
        "ok": all(row["culling_ok"] and row["lod_ok"] for row in rows),
        "width": wanted.width,
        "samples": wanted.samples,
        "bounces": wanted.bounces,
        "pictures": PICTURES,
        "amplified": AMPLIFIED,
        "left_out": left_out,
        "not_proved": not_proved,
        "frames": rows,
    }
