"""The proof that culling and LOD change nothing they should not: the same frames rendered with and without them."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np

from ..crowd_lod import difference, outputs, report, whole
from ..crowd_lod.frame import Frame
from ..crowd_lod.sorting import sort
from ..crowd_lod.steps import share, standing
from ..crowd_lod.stereo import EYES
from . import bake, build, cameras, lights
from . import scene as io
from .follow import Held, held_by, members
from .levels import OWNED, make_levels
from .populate import characters_of, frame_of, measure_groups, store_groups, trajectory_of
from .preview import Preview, stage_of

# The pictures of a frame. The third is the culled one without those whom the camera does not see itself.
PICTURES = {
    "a": "everyone, full detail",
    "b": "culled, full detail",
    "bare": "culled, without shadows and reflections from outside the picture",
    "c": "culled, with LODs",
}
AMPLIFIED, FAINTEST = 16, 60  # in the pictures of differences: times, and at least, of 255
SILHOUETTE_SAMPLES = 16  # a pixel
PAIRS = bpy.app.version >= (5, 2, 0)  # Blender 4.5 does not read back the values that it writes of two eyes
LONGEST_SHUTTER = 0.99 * bake.LONGEST  # frames
MOST_IN_SHEET = 8  # frames on the contact sheet
RAYS = ("camera", "diffuse", "glossy", "transmission", "shadow")


@dataclass(frozen=True)
class Verify:
    """What to verify. frames: increasing. width: of the pictures, pixels. samples: a pixel. bounces: with more than 0 each
    picture is rendered once more, with the sky's light and so many bounces of light and reflections."""

    frames: list[int]
    folder: Path
    width: int = 320
    samples: int = 4
    bounces: int = 0


def verify(scene: bpy.types.Scene, wanted: Verify, command: list[str]) -> Iterator[float]:
    """Write the proof for `scene` into the wanted folder; yields the progress, 0 to 1, and returns the dict of verify.json.

    All is made in a copy of the scene that is gone afterwards; the folder gets its files at the end, all or none.
    """
    with outputs.staged(wanted.folder) as folder, io.scratch():
        cameras.active_camera(scene), characters_of(scene)  # what is missing is named in the user's own scene
        stage = _stage(scene, wanted)
        layer = stage.view_layers[0]
        layer.update()
        store_groups(stage.crowd_lod, measure_groups(stage))
        trajectory = trajectory_of(stage)
        yield from standing(trajectory.approach(io.time_of(stage)), 0.0)
        frame_of(stage, layer.depsgraph)  # whatever is wrong with the scene is said before the work begins
        if stage.crowd_lod.levels is None:
            for part in make_levels(stage):
                yield 0.05 * part
        for part in build.build(stage):
            yield 0.05 + 0.05 * part
        bake.mark(stage, wanted.frames)  # with motion blur its points move by themselves
        build.dress_all(stage)
        top, stage.crowd_lod.build = stage.crowd_lod.build, None  # it holds what is written here, not what the frame asks
        outline = _outline(stage, top)
        _twin(stage, top)
        rows, sheet = [], []
        each = 0.85 / len(wanted.frames)
        for number in wanted.frames:
            time, begun = io.remapped(stage.render, number), 0.1 + each * len(rows)
            yield from share(trajectory.approach(time), begun, begun + each / (2 * len(PICTURES)))
            outline.camera = stage.camera = cameras.bound_camera(scene, time)
            stage.frame_set(number)
            row, pictures = yield from _frame(stage, layer.depsgraph, top, outline, number, wanted, folder, len(rows))
            rows.append(row)
            sheet.append(pictures)
        result = _result(rows, wanted, command, _left_out(scene, stage, rows, wanted))
        (folder / "verify.json").write_text(report.to_json(result), encoding="utf-8")
        (folder / "verify.csv").write_text(report.to_csv(rows), encoding="utf-8")
        chosen = np.unique(np.linspace(0, len(sheet) - 1, min(len(sheet), MOST_IN_SHEET)).round().astype(int))
        tiles = [picture for i in chosen for picture in sheet[i]]
        io.save_png(folder / "contact_sheet.png", report.contact_sheet(tiles, columns=len(PICTURES) + 3))
        yield 1.0
        return result


def _stage(scene: bpy.types.Scene, wanted: Verify) -> bpy.types.Scene:
    """A copy of the scene in which Cycles' picture depends on what its rays meet and on nothing else: one seed, no samples
    saved where the picture is smooth, no lamp drawn by its share of the light, no denoiser, pixels that do not overlap."""
    stage = stage_of(scene, Preview(wanted.frames, wanted.folder, wanted.width, "CYCLES", "MATERIAL"))
    stage.name = "Crowd LOD verify"
    render, cycles, own = stage.render, stage.cycles, scene.render
    render.use_motion_blur, render.use_multiview = own.use_motion_blur, own.use_multiview and PAIRS
    render.motion_blur_shutter = min(own.motion_blur_shutter, LONGEST_SHUTTER)
    render.use_border = own.use_border and scene.crowd_lod.cull_to_border
    render.image_settings.views_format = "INDIVIDUAL"
    render.engine, cycles.device = "CYCLES", "CPU"
    render.use_stamp = render.use_persistent_data = render.use_simplify = False
    cycles.samples, cycles.seed, cycles.use_animated_seed = wanted.samples, 0, False
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_light_tree = cycles.use_guiding = False
    cycles.use_fast_gi, cycles.time_limit, cycles.pixel_filter_type = False, 0, "BOX"
    render.image_settings.color_mode = "RGBA"
    for layer in stage.view_layers:
        layer.samples = 0
    return stage


def _light(stage: bpy.types.Scene, bounces: int, worlds: tuple) -> None:
    """Light the stage by its lamps alone, or with so many bounces and the sky, too: worlds are (sky, dark sky)."""
    cycles = stage.cycles
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = bounces
    cycles.transmission_bounces = cycles.volume_bounces = bounces
    stage.world = worlds[0] if bounces else worlds[1]


def _dark(world: bpy.types.World | None) -> bpy.types.World | None:
    """A copy of the world that the camera sees and that lights nothing: agents out of the picture keep some of the sky's
    light from every place in it, and no bucket holds them all."""
    if world is None:
        return None
    dark = world.copy()
    for ray in ("diffuse", "glossy", "transmission", "scatter"):
        setattr(dark.cycles_visibility, ray, False)
    return dark


def _twin(stage: bpy.types.Scene, top: bpy.types.Collection) -> None:
    """Put a second of each instance of the build into the stage, which no ray meets. Cycles rounds a mesh differently where
    it is instanced once and where it is more often; so every mesh is, however many agents show it."""
    for points in build.points_of(top).values():
        tree = bpy.data.node_groups.new("Crowd LOD twin", "GeometryNodeTree")
        tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
        shown, leave = tree.nodes.new("GeometryNodeObjectInfo"), tree.nodes.new("NodeGroupOutput")
        shown.inputs["Object"].default_value = points
        tree.links.new(shown.outputs["Geometry"], leave.inputs["Geometry"])
        twin = bpy.data.objects.new(tree.name, bpy.data.meshes.new(tree.name))
        twin[OWNED] = True
        twin.modifiers.new(tree.name, "NODES").node_group = tree
        for ray in RAYS:
            setattr(twin, f"visible_{ray}", False)
        stage.collection.objects.link(twin)


def _outline(stage: bpy.types.Scene, top: bpy.types.Collection) -> bpy.types.Scene:
    """A scene of nothing but the build and the cameras, whose pictures' alpha is the crowd's silhouette."""
    outline = stage.copy()
    for child in outline.collection.children:
        outline.collection.children.unlink(child)
    for item in outline.collection.objects:
        outline.collection.objects.unlink(item)
    for item in (*build.points_of(top).values(), *(item for item in stage.objects if item.type == "CAMERA")):
        outline.collection.objects.link(item)
    outline.render.film_transparent, outline.world = True, None
    outline.cycles.samples, outline.cycles.max_bounces = SILHOUETTE_SAMPLES, 0
    return outline


def _frame(stage, depsgraph, top, outline, number: int, wanted: Verify, folder: Path, done: int):
    """One frame: yields the progress of the whole run and returns (its row, its pictures on the contact sheet)."""
    around, trajectory = lights.read_surroundings(stage, depsgraph, io.time_of(stage)), trajectory_of(stage)
    planned = frame_of(stage, depsgraph, around=around)
    frames = _variants(planned, frame_of(stage, depsgraph, around=replace(around, level=0)))
    outline.frame_set(number)
    total = len(wanted.frames) * (2 * len(frames) if wanted.bounces else len(frames))
    at = done * total / len(wanted.frames)
    film = cameras.read_cameras(stage, depsgraph)
    held = held_by(stage, trajectory, number, planned.crowd, film)
    worlds = stage.world, _dark(stage.world)
    row = {
        "frame": number,
        "agents": len(planned.crowd),
        "visible": int(planned.visible.sum()),
        "shadow": len(planned.shadow.order),
        "mirrored": len(planned.mirrored.order),
    }
    sheet, masks = [], {}
    for bounces in (0, wanted.bounces)[: 1 + (wanted.bounces > 0)]:
        _light(stage, bounces, worlds)
        ending = "_bounces" if bounces else ""
        shot = {}
        for name, frame in frames.items():
            _write(stage, top, trajectory, frame, number, held)
            shot[name] = _render(stage, folder / f"frame_{number:04d}_{name}{ending}.png")
            if not bounces and name in ("a", "c"):
                masks[name] = _render(outline, folder / "outline.png")[..., 3]
            at += 1
            yield 0.1 + 0.85 * at / total
        for name in ("b", "bare", "c"):
            found = difference.between(shot["a"], shot[name])
            row |= {f"{name}{ending}_{key}": value for key, value in vars(found).items()}
            picture = _amplified(shot["a"], shot[name])
            io.save_png(folder / f"frame_{number:04d}_a_{name}{ending}.png", picture)
        pictures = [io.load_pixels(folder / f"frame_{number:04d}_{name}{ending}.png") for name in frames]
        pictures += [io.load_pixels(folder / f"frame_{number:04d}_a_{name}{ending}.png") for name in ("b", "bare", "c")]
        sheet += pictures
    stage.world = worlds[0]
    (folder / "outline.png").unlink()
    eyes = len(_views(stage.render))
    shift = max(difference.shift(*pair) for pair in zip(*(np.split(masks[name], eyes, axis=1) for name in "ac"), strict=True))
    each = [difference.predicted(replace(planned, camera=camera), trajectory.groups) for camera in film]
    predicted = None if None in each else max(each)
    row |= {"silhouette_shift": shift, "predicted_shift": predicted}
    row["culling_ok"] = row["b_pixels"] == 0
    row["lod_ok"] = predicted is None or shift <= predicted + 1
    return row, sheet


def _write(stage, home: bpy.types.Collection, trajectory, frame: Frame, number: int, held: Held) -> None:
    """Write the agents of the frame's buckets to the point objects in `home`, where with motion blur they move."""
    points = build.points_of(home)
    for name, agents in members(frame).items():
        library = build.library_of(points[name], len(trajectory.groups))
        columns = bake.columns_in_time(trajectory, held, number, agents, library, stage.crowd_lod.tilt)
        io.write_points(points[name].data, columns)


def _variants(planned: Frame, full: Frame) -> dict[str, Frame]:
    """The frames of PICTURES: of the plan, and of the same with the finest LOD for those that the camera does not see."""
    count = len(planned.buckets.counts)
    finest = np.zeros(len(planned.crowd), np.uint8)
    nobody = sort(np.zeros(len(planned.crowd), bool), finest, count)
    finite = np.isfinite([planned.crowd.x, planned.crowd.y, planned.crowd.z]).all(axis=0)
    culled = replace(full, buckets=sort(planned.visible, finest, count))
    return {
        "a": replace(full, buckets=sort(finite, finest, count), shadow=nobody, mirrored=nobody),
        "b": culled,
        "bare": replace(culled, shadow=nobody, mirrored=nobody),
        "c": planned,
    }


def _views(render: bpy.types.RenderSettings) -> list[str]:
    """What the files of the picture's views, the eyes of stereo among them, are called after the picture's name."""
    if not render.use_multiview:
        return [""]
    stereo = render.views_format == "STEREO_3D"
    return [view.file_suffix for view in render.views if view.use and (view.name in EYES or not stereo)]


def _render(stage: bpy.types.Scene, path: Path) -> np.ndarray:
    """Render the picture to the PNG `path`; (rows, columns, 4) float32 of its own linear values, bottom row first; the
    views of a stereo picture side by side."""
    render, settings = stage.render, stage.render.image_settings
    stem = path.with_suffix("")
    with io.quiet(), bpy.context.temp_override(scene=stage):
        settings.file_format, settings.color_depth, render.filepath = "OPEN_EXR", "32", f"{stem}.exr"
        bpy.ops.render.render(write_still=True)
    settings.file_format, settings.color_depth = "PNG", "8"
    values, shown = [], []
    for view in _views(render):
        raw, seen = Path(f"{stem}{view}.exr"), Path(f"{stem}{view}.png")
        whole.check(raw)
        image = bpy.data.images.load(str(raw))
        try:
            values.append(io.read_values(image))
            with io.writing(seen):
                image.save_render(str(seen), scene=stage)
            shown.append(io.load_pixels(seen))
        finally:
            bpy.data.images.remove(image)
        raw.unlink()
        seen.unlink()
    io.save_png(path, np.concatenate(shown, axis=1))
    return np.concatenate(values, axis=1)


def _amplified(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The difference of two pictures as (rows, columns, 4) uint8: black is none, however small."""
    off = np.abs(a - b)
    shown = np.rint(255 * (AMPLIFIED * off).clip(0, 1)).astype(np.uint8)
    shown[off > 0] = np.maximum(shown[off > 0], FAINTEST)
    shown[..., 3] = 255
    return shown


def _left_out(scene: bpy.types.Scene, stage: bpy.types.Scene, rows: list[dict], wanted: Verify) -> list[str]:
    """What the pictures do not prove of a render of `scene`, a sentence each."""
    said = []
    if scene.render.use_motion_blur and scene.render.motion_blur_shutter > LONGEST_SHUTTER:
        said.append(f"The shutter was open for {LONGEST_SHUTTER:g} frames, not {scene.render.motion_blur_shutter:g}.")
    if scene.render.use_multiview and not PAIRS:
        said.append("One eye was looked at: this Blender does not read back pictures of two.")
    if any(row["predicted_shift"] is None for row in rows):
        said.append(
            "Silhouettes were not judged: an agent stands at the camera, a LOD is not measured, or the lens bends the picture."
        )
    mirrors = lights.read_surroundings(stage, stage.view_layers[0].depsgraph, io.time_of(stage)).mirrors
    if wanted.bounces > 1 and len(mirrors) > 1:
        said.append("What one mirror shows in another is not looked for: there pixels may differ.")
    return said


def _result(rows: list[dict], wanted: Verify, command: list[str], left_out: list[str]) -> dict:
    """The dict of verify.json."""
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
        "frames": rows,
    }


def to_text(result: dict) -> str:
    """The result as lines of text: a sentence a frame, and the verdict."""
    lines = []
    for row in result["frames"]:
        lines.append(
            f"frame {row['frame']}: {row['visible']:,} of {row['agents']:,} agents visible, {row['shadow']:,} kept for their "
            f"shadows, {row['mirrored']:,} for mirrors. Culled against everyone: {row['b_pixels']:,} pixels differ"
            f" ({row['bare_pixels']:,} without those kept). LODs: {row['c_share']:.2%} of the pixels differ visibly, silhouettes "
            f"shift {row['silhouette_shift']:.1f} pixels"
            + ("." if row["predicted_shift"] is None else f", {row['predicted_shift']:.2f} predicted.")
        )
        if result["bounces"]:
            lines.append(
                f"  with sky and {result['bounces']} bounces: {row['b_bounces_share']:.2%} of the pixels differ visibly, mean "
                f"{row['b_bounces_mean']:.2g} ({row['bare_bounces_share']:.2%}, {row['bare_bounces_mean']:.2g} without those kept)."
            )
    lines += result["left_out"]
    lines.append(
        "Culling and LODs change nothing they should not." if result["ok"] else f"NOT the same: {_failed(result['frames'])}."
    )
    return "\n".join(lines)


def _failed(rows: list[dict]) -> str:
    wrong = [f"frame {row['frame']}, culling" for row in rows if not row["culling_ok"]]
    return "; ".join(wrong + [f"frame {row['frame']}, LODs" for row in rows if not row["lod_ok"]])
