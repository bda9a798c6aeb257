"""A child process of worth.py: makes the files, or renders one of them, and prints what that took as a line of JSON.

One file holds the plaza's crowd in each of these ways, as render settings the same:
nobody            the plaza without its crowd: what the scene itself costs
everyone          every agent an instance of its full mesh, moved by the rig of its phase class
camera cull       the same, by Cycles' camera culling (Simplify), which reaches instances by their source objects
geometry nodes    a tree that deletes the points outside the frustum and gives the others their LOD
Crowd LOD         the build: it plans the frame and writes its points while it is rendered; LODs by the plaza's own ratios
Crowd LOD 1 px    the same, LODs by tolerance
baked 1 px        that, baked over a few frames: it holds the characters alone that these show

All but those two of Crowd LOD are files that need no Crowd LOD, and are rendered without it.
"""

import json
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path

import bpy
import crowd_lod_extension
import numpy as np
import peers
from crowd_lod_extension.crowd_lod.agents import Group
from crowd_lod_extension.operators import bake, build, cli, follow
from crowd_lod_extension.operators import scene as io
from crowd_lod_extension.operators.levels import make_levels
from crowd_lod_extension.operators.populate import frame_of, measure_groups, store_groups, trajectory_of

NOBODY, EVERYONE, CAMERA_CULL, NODES, BAKED = "nobody", "everyone", "camera cull", "geometry nodes", "baked 1 px"
CROWD_LOD = {"Crowd LOD": "base.blend", "Crowd LOD 1 px": "tolerance_1.blend"}
WAYS = (NOBODY, EVERYONE, CAMERA_CULL, NODES, *CROWD_LOD, BAKED)
AROUND = 2  # frames on either side that are baked, too


def prepare(folder: str, width: int, sizes: list[int], tolerances: list[float], swept: int, frame: int) -> dict:
    """Write WAY_AGENTS.blend and tolerance_PIXELS.blend (of `swept` agents) into the folder, for pictures `width` pixels
    wide; a row for each build, and the part of the agents that the frame sees. The LOD meshes by tolerance are those chosen
    for 1 pixel: another tolerance says where they begin."""
    crowd_lod_extension.register()
    scene, rows = cli.open_scene("plaza"), []
    settings, film = scene.crowd_lod, scene.render
    film.resolution_x, film.resolution_y = width, round(width * film.resolution_y / film.resolution_x)
    film.resolution_percentage = 100
    settings.count = swept
    store_groups(settings, measure_groups(scene))
    list(make_levels(scene))
    rows.append(_build(scene, "ratios", Path(folder) / "base.blend"))
    settings.choice, settings.tolerance = "BY_TOLERANCE", 1.0
    list(make_levels(scene))
    for tolerance in tolerances:
        settings.tolerance = tolerance
        rows.append(_build(scene, f"{tolerance:g} px", Path(folder) / f"tolerance_{tolerance:g}.blend"))
    for agents in sizes:
        for way in WAYS:
            base = CROWD_LOD.get("Crowd LOD 1 px" if way == BAKED else way, "base.blend")
            bpy.ops.wm.open_mainfile(filepath=f"{folder}/{base}")
            scene = bpy.context.scene
            scene.crowd_lod.count = agents
            if way == BAKED:
                list(bake.bake(scene, range(frame - AROUND, frame + AROUND + 1)))
            elif way not in CROWD_LOD:
                visible = _dress(scene, way, frame)
            bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/{way}_{agents}.blend")
    crowd_lod_extension.unregister()
    return {"builds": rows, "visible_percent": round(100 * visible, 1)}


def _build(scene: bpy.types.Scene, levels: str, path: Path) -> dict:
    """Build the scene and write it to `path`; the row of what that took."""
    begun = time.process_time()
    list(build.build(scene))
    took = time.process_time() - begun
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)
    top = scene.crowd_lod.build
    shelves = [home for home in top.children_recursive if home.get(build.LIBRARY, -1) >= 0]
    meshes = {item.data for item in top.all_objects if build.LEVEL not in item}
    return {
        "lods by": levels,
        "characters, a LOD": " ".join(str(len(home.children)) for home in shelves),
        "vertices_millions": round(sum(len(mesh.vertices) for mesh in meshes) / 1e6, 2),
        "build_cpu_s": round(took, 2),
        "file_mb": round(path.stat().st_size / 1e6, 1),
    }


def _dress(scene: bpy.types.Scene, way: str, number: int) -> float:
    """Show the crowd as it stands in the frame `number` in that way, with nothing left for Crowd LOD to do;
    the part of the agents that the camera sees."""
    settings = scene.crowd_lod
    top, settings.build = settings.build, None
    scene.frame_set(number)
    trajectory = trajectory_of(scene)
    frame = frame_of(scene, scene.view_layers[0].depsgraph, trajectory=trajectory)
    agents, held = np.arange(len(frame.crowd)), follow.Held(frame.crowd, frame.time)
    for points in build.points_of(top).values():
        points.data.clear_geometry()
        if way in (NOBODY, EVERYONE, CAMERA_CULL) and points[build.BUCKET] != "LOD 0":
            bpy.data.objects.remove(points)  # what it instances would be evaluated, picked or not
            continue
        columns = follow.columns_of(
            trajectory, frame.crowd, held, agents, build.library_of(top, points, trajectory.gaits), settings.tilt
        )
        if way in (EVERYONE, CAMERA_CULL) and points[build.BUCKET] == "LOD 0":
            io.write_points(points.data, columns)
        elif way == NODES and points[build.BUCKET].startswith("LOD"):
            io.write_points(points.data, columns)
            _cull(points, trajectory.groups, frame)
    if way == CAMERA_CULL:
        scene.render.use_simplify = scene.cycles.use_camera_cull = True
        for item in top.all_objects:
            item.cycles.use_camera_cull = True
    return float(frame.visible.mean())


def _cull(points: bpy.types.Object, groups: tuple[Group, ...], frame) -> None:
    """Before the tree that instances them, one that leaves the points which the camera sees at this LOD. It has one
    sphere for all groups, and the LODs' distances are the same for them."""
    centre = np.mean([group.centre for group in groups])
    sphere = Group("all", 0.0, max(group.radius + abs(group.centre - centre) for group in groups), 0.0, 1.0)
    nodes = peers.Nodes(frame.crowd, sphere, frame.begins[0])
    nodes.aim(replace(frame.camera, origin=frame.camera.origin - (0, 0, centre)))
    own = bpy.data.node_groups.new("one LOD", "GeometryNodeTree")
    for in_out in ("INPUT", "OUTPUT"):
        own.interface.new_socket("Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    entry, leave, lod, equal, keep = (
        own.nodes.new(kind)
        for kind in (
            "NodeGroupInput",
            "NodeGroupOutput",
            "GeometryNodeInputNamedAttribute",
            "FunctionNodeCompare",
            "GeometryNodeSeparateGeometry",
        )
    )
    lod.data_type, equal.data_type, equal.operation = "INT", "INT", "EQUAL"
    lod.inputs["Name"].default_value = "lod"
    one, other = (socket for socket in equal.inputs if socket.enabled)
    other.default_value = points[build.LEVEL]
    for output, socket in (
        (next(s for s in lod.outputs if s.enabled), one),
        (equal.outputs[0], keep.inputs["Selection"]),
        (entry.outputs[0], keep.inputs["Geometry"]),
        (keep.outputs["Selection"], leave.inputs[0]),
    ):
        own.links.new(output, socket)
    for place, tree in enumerate((nodes.tree.group, own)):
        points.modifiers.new("cull", "NODES").node_group = tree
        points.modifiers.move(len(points.modifiers) - 1, place)
    bpy.data.scenes.remove(nodes.scene)


def render(file: str, picture: str, engine: str, frame: int, width: int, samples: int) -> dict:
    """Render the frame of the file to the EXR `picture`; what it took. export_s: to the first sample, wall time, as is
    render_s, of all; cpu_s, of all; peak_mb: of this process."""
    live = Path(file).name.startswith(("Crowd LOD", "tolerance"))
    if live:
        crowd_lod_extension.register()
    bpy.ops.wm.open_mainfile(filepath=file)
    scene = bpy.context.scene
    settings, cycles = scene.render, scene.cycles
    settings.engine = io.EEVEE if engine == "EEVEE" else engine
    height = round(width * settings.resolution_y / settings.resolution_x)
    settings.resolution_x, settings.resolution_y, settings.resolution_percentage = width, height, 100
    settings.image_settings.file_format, settings.image_settings.color_depth = "OPEN_EXR", "32"
    settings.filepath = str(Path(picture).with_suffix("")) + "_"
    cycles.device, cycles.seed, cycles.samples = "CPU", 0, samples
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    scene.eevee.taa_render_samples = samples
    scene.frame_set(frame - 1)  # the crowd's way to here is no part of one frame's cost
    scene.frame_start = scene.frame_end = frame
    said = []
    bpy.app.handlers.render_stats.append(lambda text, *_: said.append((time.perf_counter(), str(text))))
    begun, cpu = time.perf_counter(), time.process_time()
    bpy.ops.render.render(animation=True)
    ended, used = time.perf_counter(), time.process_time() - cpu
    Path(f"{settings.filepath}{frame:04d}.exr").replace(picture)
    first = next((at for at, text in said if "Sample 0/" in text or "Rendering 1 " in text), ended)
    if live:
        crowd_lod_extension.unregister()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "cpu_s": round(used, 2),
        "render_s": round(ended - begun, 2),
        "export_s": round(first - begun, 2),
        "peak_mb": round(peak / (1e6 if sys.platform == "darwin" else 1e3)),
    }


if __name__ == "__main__":
    job = json.loads(sys.argv[1])
    with io.quiet():
        row = {"prepare": prepare, "render": render}[job.pop("job")](**job)
    print(json.dumps(row), flush=True)
