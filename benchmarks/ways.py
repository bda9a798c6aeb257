"""A child process of worth.py: makes the files, or renders one of them.

Prints what that took as a line of JSON.

One file holds a crowd of crowds.py in each of these ways, its render settings the same:
nobody            the ground without its crowd: what the scene itself costs
everyone          every agent an instance of its full mesh, moved by the rig of its phase class:
                  the strongest rival
camera cull       the same, by Cycles' camera culling (Simplify), ticked on the source objects
geometry nodes    a tree that deletes the points outside the frustum and gives the others their LOD
by distance       the build, which plans the frame and writes its points while it is rendered; LODs
                  of set ratios and distances
1 px              the same, LODs by tolerance
1 px, baked       that, baked over the frames with --render-only: only what these show

By distance and 1 px are rendered with Crowd LOD; the others are files that need none, and hold the
points of FRAMES.
"""

import time
from dataclasses import replace
from pathlib import Path

import bpy
import crowd_lod_extension
import crowds
import numpy as np
import peers
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import mesh_data, scene_data
from crowd_lod_extension.operators.blender.ownership import remove_owned
from crowd_lod_extension.operators.build import (
    bake,
    cost_estimate,
    frame_update,
    render_setup,
    shelves,
)
from crowd_lod_extension.operators.build.shelves import RIGS, SHELF
from crowd_lod_extension.operators.build.visibility import hide_characters
from crowd_lod_extension.operators.deliver.accuracy.measured_render import peak_mb
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.characters.stored_groups import store_groups
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd
from crowd_lod_extension.operators.scene.shot_reference import frame_of, moment_now
from crowd_lod_extension.operators.settings.stored_figures import FULL, BuildCase
from jobs import answer

NOBODY = "nobody"
EVERYONE = "everyone"
CAMERA_CULL = "camera cull"
NODES = "geometry nodes"
BAKED = "1 px, baked"
CROWD_LOD = ("by distance", "1 px")
WAYS = (NOBODY, EVERYONE, CAMERA_CULL, NODES, *CROWD_LOD, BAKED)
# the build whose LODs a way has, if not full's
BASES = {NODES: "by distance", "by distance": "by distance", "1 px": "1 px", BAKED: "1 px"}
FRAMES = range(30, 33)  # that a baked file holds; the middle one is rendered
CHOSEN_FOR = 10_000  # agents of the shot for which LODs by tolerance are chosen


def shown_by(engine: str) -> tuple[str, ...]:
    """The ways that the engine has."""
    return tuple(way for way in WAYS if engine == "CYCLES" or way != CAMERA_CULL)


def prepare(
    folder: str, crowd: dict, engine: str, sizes: list[int], width: int, samples: int
) -> dict:
    """Write WAY_AGENTS.blend into the folder of a crowd of crowds.make.

    For pictures `width` pixels wide of so many `samples` by the `engine`. Returns a row for each
    choice of LODs, of each file its MB, and of each of `sizes` what was predicted.
    """
    crowd_lod_extension.register()
    scene = _scene(crowd, engine, width, samples)
    rows = []
    files = {}
    predicted = {}
    settings = scene.crowd_lod
    crowds.spread(scene, CHOSEN_FOR)
    store_groups(settings, measure_groups(scene))
    settings.thresholds[:2] = [meters / scene.camera.data.clip_end for meters in (15, 40)]
    for way, choice, count in (
        ("full", "BY_DISTANCE", 1),
        ("by distance", "BY_DISTANCE", 3),
        ("1 px", "BY_TOLERANCE", 3),
    ):
        settings.choice = choice
        settings.level_count = count
        rows.append(_build(scene, way, Path(folder) / f"{way}.blend"))
    for agents in sizes:
        for way in shown_by(engine):
            bpy.ops.wm.open_mainfile(filepath=f"{folder}/{BASES.get(way, 'full')}.blend")
            scene = bpy.context.scene
            crowds.spread(scene, agents)
            if way == BAKED:
                predicted[agents] = finished(
                    cost_estimate.estimate(scene, FRAMES, known=True)
                ).as_json
                finished(bake.bake(scene, FRAMES))
            elif way not in (NOBODY, *CROWD_LOD):
                dress_scene(scene, way)
            path = Path(folder) / f"{way}_{agents}.blend"
            if way == NOBODY:
                render_setup.remove_build(scene.crowd_lod)
                remove_owned(scene.crowd_lod.levels)
                bpy.data.batch_remove(scene.crowd_lod.characters.all_objects)
                bpy.data.orphans_purge(do_recursive=True)
            if way == BAKED:
                hide_characters(scene)
                bake.keep_what_renders(scene)
            files[path.stem] = _save(path)
    crowd_lod_extension.unregister()
    return {"builds": rows, "files": files, "predicted": predicted}


def _save(path: Path) -> float:
    """Write the open file to `path`: its MB."""
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return round(path.stat().st_size / 1e6, 2)


def counts(
    folder: str, crowd: dict, sizes: list[int], lods: bool, width: int, samples: int
) -> dict:
    """Write files of the crowd, of nobody and of each of `sizes` agents.

    Everyone at full detail, and, with `lods`, a bake with LODs by distance. Returns a row of counts
    for each (see crowd_lod/levels/cost_model.py).
    """
    crowd_lod_extension.register()
    scene = _scene(crowd, "CYCLES", width, samples)
    rows = []
    settings = scene.crowd_lod
    settings.choice = "BY_DISTANCE"
    store_groups(settings, measure_groups(scene))
    settings.thresholds[:2] = [meters / scene.camera.data.clip_end for meters in (8, 25)]
    level_counts = {EVERYONE: 1} | ({"by distance": 3} if lods else {})
    for way, settings.level_count in level_counts.items():
        _build(scene, way, Path(folder) / f"{way}.blend")
    for way, agents in [
        (EVERYONE, 0),
        *((way, agents) for way in level_counts for agents in sizes),
    ]:
        bpy.ops.wm.open_mainfile(filepath=f"{folder}/{way}.blend")
        row = _counted(bpy.context.scene, way, agents)
        path = Path(folder) / f"{way}_{agents}.blend"
        rows.append({**crowd, "way": way, "agents": agents, **row, "file": str(path)})
        _save(path)
        if not agents:
            bpy.data.batch_remove(bpy.data.images)  # those of hidden characters are loaded, too
            _save(path)
    crowd_lod_extension.unregister()
    return {"rows": rows}


def _counted(scene: bpy.types.Scene, way: str, agents: int) -> dict:
    """Show so many agents in that way; return the row of what the build holds.

    And of what it shows at the first of FRAMES.
    """
    crowds.spread(scene, agents or 1)
    if not agents:
        render_setup.remove_build(scene.crowd_lod)
        return {}
    works = finished(cost_estimate.estimate(scene, FRAMES[:1], known=True)).works
    if way != EVERYONE:
        finished(bake.bake(scene, FRAMES[:1]))
        return {
            name: float(np.sum(value))
            for name, value in vars(works[BuildCase("BY_DISTANCE", True)]).items()
        }
    top = scene.crowd_lod.build
    full = works[BuildCase(FULL, True)]
    dress_scene(scene, EVERYONE)
    return counted(top) | {
        "rays": float(full.rays[0]),
        "images": full.images,
    }


def counted(top: bpy.types.Collection) -> dict[str, int]:
    """What the build `top`, of one LOD, holds and shows.

    See crowd_lod/levels/cost_model.py.
    """
    (points,) = shelves.points_of(top).values()
    shelf = next(child for child in top.children_recursive if child.get(SHELF, -1) == 0)
    homes = sorted(shelf.children, key=lambda home: home.name)
    triangles = np.array(
        [sum(mesh_data.count_triangles(item.data) for item in home.objects) for home in homes]
    )
    split = np.array([home.objects[0].data.has_custom_normals for home in homes])
    numbers = np.zeros(len(points.data.vertices), np.int32)
    points.data.attributes["pose"].data.foreach_get("value", numbers)
    at = np.zeros(len(numbers), np.int32)
    points.data.attributes["frame"].data.foreach_get("value", at)
    instances = np.bincount(numbers[at == FRAMES[0]], minlength=len(homes))
    rigs = next(child for child in top.children_recursive if RIGS in child)
    return {
        "posed": int(triangles.sum()),
        "unique": int(triangles[instances > 0].sum()),
        "split": int((triangles * split)[instances > 0].sum()),
        "instances": int(instances.sum()),
        "instanced": int((instances * triangles).sum()),
        "rigs": len(rigs.objects),
    }


def _scene(crowd: dict, engine: str, width: int, samples: int) -> bpy.types.Scene:
    """The scene of a crowd of crowds.make, for such pictures."""
    scene = crowds.make(**crowd)
    scene.render.engine = scene_data.BLENDER_ENGINES[engine]
    scene.render.resolution_x = width
    scene.render.resolution_y = round(width * 9 / 16)
    scene.cycles.samples = scene.eevee.taa_render_samples = samples
    return scene


def _build(scene: bpy.types.Scene, way: str, path: Path) -> dict:
    """Make the scene's LODs, build it and write it to `path`.

    Returns the row of what that took.
    """
    begun = time.process_time()
    finished(make_levels(scene))
    levels_end = time.process_time()
    finished(render_setup.build(read_crowd(scene)))
    build_end = time.process_time()
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return {
        "lods": way,
        "triangles": "; ".join(
            " ".join(f"{n:,}" for n in group.triangles if n) for group in scene.crowd_lod.groups[:1]
        ),
        "make_cpu_s": round(levels_end - begun, 1),
        "build_cpu_s": round(build_end - levels_end, 1),
    }


def dress_scene(scene: bpy.types.Scene, way: str) -> None:
    """Show the crowd as it stands in FRAMES in that way.

    Nothing is left for Crowd LOD to do.
    """
    settings = scene.crowd_lod
    crowd = read_crowd(scene)
    trajectory = crowd.trajectory
    top = settings.build
    points = shelves.points_of(top)
    rows = {bucket: [] for bucket in points}
    cast = render_setup.cast_of(top, trajectory)
    for number in FRAMES:
        scene.frame_set(number)
        frame = frame_of(crowd, moment_now(scene, scene.view_layers[0].depsgraph))
        agents = np.arange(len(frame.crowd))
        crowd_now = frame_update.OpenShutter(frame.crowd, frame.time)
        for bucket in points:
            is_used = (
                bucket == (shelves.BucketKind.LOD, 0)
                if way in (EVERYONE, CAMERA_CULL)
                else way == NODES and bucket.is_seen
            )
            if is_used:
                rows[bucket].append(
                    bake.columns_in_time(trajectory, crowd_now, number, agents, cast)
                )
    bake.mark(scene, FRAMES)
    render_setup.dress_all(scene)
    settings.build = None
    for bucket, item in points.items():
        if not rows[bucket]:
            bpy.data.objects.remove(item)  # what it instances would be evaluated, picked or not
            continue
        columns = rows[bucket][0].keys()
        mesh_data.write_points(
            item.data,
            {column: np.concatenate([each[column] for each in rows[bucket]]) for column in columns},
        )
        if way == NODES:
            _cull(item, trajectory.groups, frame)
    if way == CAMERA_CULL:
        scene.render.use_simplify = scene.cycles.use_camera_cull = True
        for item in top.all_objects:
            item.cycles.use_camera_cull = True


def _cull(points: bpy.types.Object, groups: tuple[Group, ...], frame) -> None:
    """Put a tree before the one that instances, which leaves what is seen.

    These are the points which the camera sees at this LOD. It has one sphere for all groups, and
    the LODs' distances are the same for them.
    """
    center = np.mean([group.center for group in groups])
    sphere = Group(
        "all", 0.0, max(group.radius + abs(group.center - center) for group in groups), 0.0, 1.0
    )
    nodes = peers.Nodes(frame.crowd, sphere, frame.thresholds[0])
    nodes.aim(replace(frame.camera, origin=frame.camera.origin - (0, 0, center)))
    level_tree = bpy.data.node_groups.new("one LOD", "GeometryNodeTree")
    for in_out in ("INPUT", "OUTPUT"):
        level_tree.interface.new_socket("Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    entry, leave, lod, equal, keep = (
        level_tree.nodes.new(kind)
        for kind in (
            "NodeGroupInput",
            "NodeGroupOutput",
            "GeometryNodeInputNamedAttribute",
            "FunctionNodeCompare",
            "GeometryNodeSeparateGeometry",
        )
    )
    lod.data_type = "INT"
    equal.data_type = "INT"
    equal.operation = "EQUAL"
    lod.inputs["Name"].default_value = "lod"
    lod_input, level_input = (socket for socket in equal.inputs if socket.enabled)
    level_input.default_value = points[shelves.LEVEL]
    for output, socket in (
        (next(s for s in lod.outputs if s.enabled), lod_input),
        (equal.outputs[0], keep.inputs["Selection"]),
        (entry.outputs[0], keep.inputs["Geometry"]),
        (keep.outputs["Selection"], leave.inputs[0]),
    ):
        level_tree.links.new(output, socket)
    for place, tree in enumerate((nodes.tree.group, level_tree)):
        points.modifiers.new("cull", "NODES").node_group = tree
        points.modifiers.move(len(points.modifiers) - 1, place)
    bpy.data.scenes.remove(nodes.scene)


def render(file: str, picture: str, engine: str, frame: int, width: int, samples: int) -> dict:
    """Render the frame of the file to the EXR `picture`; return what it took.

    export_s: to the first sample, wall time, as is render_s, of all; cpu_s, of all; peak_mb: of
    this process.
    """
    live = Path(file).stem.rpartition("_")[0] in CROWD_LOD
    if live:
        crowd_lod_extension.register()
    bpy.ops.wm.open_mainfile(filepath=file)
    scene = bpy.context.scene
    settings = scene.render
    cycles = scene.cycles
    settings.engine = scene_data.BLENDER_ENGINES[engine]
    height = round(width * settings.resolution_y / settings.resolution_x)
    settings.resolution_x = width
    settings.resolution_y = height
    settings.resolution_percentage = 100
    settings.image_settings.file_format = "OPEN_EXR"
    settings.image_settings.color_depth = "32"
    settings.filepath = str(Path(picture).with_suffix("")) + "_"
    cycles.device = "CPU"
    cycles.seed = 0
    cycles.samples = samples
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    scene.eevee.taa_render_samples = samples
    scene.frame_set(frame - 1)  # the crowd's way to here is no part of one frame's cost
    scene.frame_start = scene.frame_end = frame
    messages = []
    bpy.app.handlers.render_stats.append(
        lambda text, *_: messages.append((time.perf_counter(), str(text)))
    )
    begun = time.perf_counter()
    cpu = time.process_time()
    bpy.ops.render.render(animation=True)
    ended = time.perf_counter()
    cpu_seconds = time.process_time() - cpu
    Path(f"{settings.filepath}{frame:04d}.exr").replace(picture)
    first = next(
        (at for at, text in messages if "Sample 0/" in text or "Rendering 1 " in text), ended
    )
    if live:
        crowd_lod_extension.unregister()
    return {
        "cpu_s": round(cpu_seconds, 2),
        "render_s": round(ended - begun, 2),
        "export_s": round(first - begun, 2),
        "peak_mb": round(peak_mb()),
    }


if __name__ == "__main__":
    answer(prepare, counts, render)
