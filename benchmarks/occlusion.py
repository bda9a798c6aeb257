"""Who is hidden by scenery, judged by pictures and rays that share nothing with the culling.

./crowd-lod bench --occlusion [--quick] [--out DIR]

For each case of street.py a live build shows every agent in the frustum, each with its number as
its light; Cycles renders it four times as wide and high as the picture that was planned, a ray a
pixel. A pixel of an agent that the plan hides is a false cull. Blender's BVH of the opaque meshes
then has rays to places in the agents' spheres: a place in sight of a hidden agent is a false cull,
too; agents without one in sight are those that could be hidden. Then 100,000 agents: a million
rays, and the processor's milliseconds. Last, what baked renders take with and without it.
"""

import tempfile
import time
from pathlib import Path

import bpy
import crowd_lod_extension
import numpy as np
import street
from crowd_lod_extension.crowd_lod.frame.frame import Frame
from crowd_lod_extension.crowd_lod.frame.hidden import hidden_wholly, hide
from crowd_lod_extension.crowd_lod.output import files, tables
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import scene_data
from crowd_lod_extension.operators.build import bake, render_setup, shelves
from crowd_lod_extension.operators.build.aovs import materials_of
from crowd_lod_extension.operators.build.visibility import hide_characters
from crowd_lod_extension.operators.deliver.accuracy.measured_render import peak_mb
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.lights import read_surroundings
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd
from crowd_lod_extension.operators.scene.shot_reference import frame_of, moment_now
from jobs import answer, job
from mathutils import Vector
from mathutils.bvhtree import BVHTree

AGENTS = 1500
RAYS = 60  # at each agent
MANY = 100_000
MANY_RAYS = 1_000_000
FINER = 4  # times as many pixels along each axis
REPEATS = 5
RENDERS = (
    ("WORKBENCH", 10_000),
    ("EEVEE", 10_000),
    ("CYCLES", 10_000),
    ("CYCLES", 100_000),
    ("CYCLES", 1_000_000),
)
ENGINES = {**scene_data.BLENDER_ENGINES, "WORKBENCH": "BLENDER_WORKBENCH"}
SHOWN = 70  # the frame that is rendered
LEAST_CROWD = 0.05  # of what a street without a crowd takes
LIMIT = 1200.0  # seconds, to make a file or to render it


def main(out: Path, quick: bool) -> None:
    """Write occlusion.csv, occlusion_many.csv and occlusion_renders.csv, and print them."""
    from worth import show

    crowd_lod_extension.register()
    with files.staged(out) as folder:
        rows = [row for name in street.CASES for row in judge_case(name)]
        many = [judge_many(frame) for frame in (1, 70, 110)]
        with tempfile.TemporaryDirectory() as scratch:
            renders = [
                row
                for engine, agents in RENDERS[: 2 if quick else None]
                for row in compare_renders(Path(scratch), engine, agents)
            ]
        for name, found in (("", rows), ("_many", many), ("_renders", renders)):
            show(f"occlusion{name}", found)
            (folder / f"occlusion{name}.csv").write_text(tables.to_csv(found), encoding="utf-8")


def judge_case(name: str) -> list[dict]:
    """A row for each frame of a case of street.py."""
    change, frames = street.CASES[name]
    scene = street.make_street(AGENTS)
    change(scene)
    finished(make_levels(scene))
    finished(render_setup.build(read_crowd(scene)))
    # the frame before may not decide: frames are planned last first
    plans = {number: plan_of(scene, number) for number in reversed(frames)}
    scene.crowd_lod.occlusion = False
    _shine(scene)
    rows = []
    for number in frames:
        frame = plans[number]
        pixels = item_buffer(scene, number)
        rows.append(
            {
                "case": name,
                "frame": number,
                **_counts(frame),
                "false_in_pixels": int(np.isin(pixels, np.flatnonzero(frame.hidden)).sum()),
                "agents_in_pixels": len(np.unique(pixels)),
                **judge_by_rays(scene, frame, RAYS),
            }
        )
        print(*rows[-1].values(), sep="\t", flush=True)
    return rows


def plan_of(scene: bpy.types.Scene, number: int) -> Frame:
    """The plan of a frame, with who is hidden in it."""
    scene.frame_set(number)
    depsgraph = scene.view_layers[0].depsgraph
    around = read_surroundings(scene, depsgraph, scene_data.time_of(scene))
    return frame_of(read_crowd(scene), moment_now(scene, depsgraph, around))


def _counts(frame: Frame) -> dict:
    hidden = int(frame.hidden.sum())
    return {
        "in_picture": hidden + len(frame.buckets.order),
        "hidden": hidden,
        "wholly": hidden_wholly(frame),
    }


def _shine(scene: bpy.types.Scene) -> None:
    """Have the characters show their agent's number, plus 1, as the only light of the picture."""
    bpy.data.batch_remove([item for item in scene.objects if item.type == "LIGHT"])
    for surface in materials_of(scene):
        tree = surface.node_tree
        tree.nodes.clear()
        number = tree.nodes.new("ShaderNodeAttribute")
        number.attribute_type = "INSTANCER"
        number.attribute_name = "id"
        more = tree.nodes.new("ShaderNodeMath")
        tree.links.new(number.outputs["Fac"], more.inputs[0])
        more.inputs[1].default_value = 1.0
        sees = tree.nodes.new("ShaderNodeMath")
        sees.operation = "MULTIPLY"
        tree.links.new(more.outputs[0], sees.inputs[0])
        path = tree.nodes.new("ShaderNodeLightPath")
        tree.links.new(path.outputs["Is Camera Ray"], sees.inputs[1])
        light = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(sees.outputs[0], light.inputs["Strength"])
        end = tree.nodes.new("ShaderNodeOutputMaterial")
        tree.links.new(light.outputs[0], end.inputs["Surface"])


def item_buffer(scene: bpy.types.Scene, number: int) -> np.ndarray:
    """The agents (pixels of all eyes,) int that the frame's pixels show; -1 for none."""
    render = scene.render
    cycles = scene.cycles
    render.resolution_percentage = 100 * FINER
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_depth = "32"
    cycles.device = "CPU"
    cycles.samples = 1
    cycles.max_bounces = 0
    cycles.transparent_max_bounces = 64
    cycles.pixel_filter_type = "BOX"
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    scene.frame_set(number)
    with tempfile.TemporaryDirectory() as folder:
        render.filepath = str(Path(folder) / "item.exr")
        bpy.ops.render.render(write_still=True)
        views = [_red(path) for path in sorted(Path(folder).glob("*.exr"))]
    render.resolution_percentage = 100
    return np.rint(np.concatenate(views)).astype(np.int64) - 1


def _red(path: Path) -> np.ndarray:
    return _values(path)[::4]


def _values(path: Path) -> np.ndarray:
    """The pixels' values, four each."""
    image = bpy.data.images.load(str(path))
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    bpy.data.images.remove(image)
    return values


def judge_by_rays(scene: bpy.types.Scene, frame: Frame, rays: int) -> dict:
    """False culls in rays, and the part found of those that the opaque meshes hide wholly."""
    camera = frame.camera
    if camera.kind == "PANO":
        return {"rays": 0, "false_in_rays": 0, "recall": None}
    hidden = frame.hidden.copy()
    hidden[frame.buckets.order] = False
    agents = np.sort(np.concatenate([frame.buckets.order, np.flatnonzero(hidden)]))
    spheres = frame.trajectory.spheres
    group = frame.crowd.group[agents]
    centers = np.stack(frame.crowd.places(spheres.center, agents), axis=1)
    random = np.random.default_rng(0)
    way = random.normal(size=(len(agents), rays, 3))
    way /= np.linalg.norm(way, axis=2, keepdims=True)
    way *= 0.999 * random.random((len(agents), rays, 1)) ** 0.1
    points = centers[:, None] + way * spheres.radius[group][:, None, None]
    v = (points - camera.origin) @ np.array([camera.X, camera.Y, camera.Z]).T
    across = v[..., :2] / (v[..., 2:] if camera.kind == "PERSP" else 1.0)
    w = camera.window
    inside = (across > (w.left, w.bottom)).all(axis=2) & (across < (w.right, w.top)).all(axis=2)
    inside &= v[..., 2] > camera.near
    row, place = np.nonzero(inside)
    free = _free(opaque_tree(scene), frame, points[row, place], v[row, place, 2])
    seen = np.zeros(len(agents), bool)
    seen[row[free]] = True
    sought = ~seen & inside.any(axis=1)
    return {
        "rays": len(row),
        "false_in_rays": int((seen & hidden[agents]).sum()),
        "recall": round(float(hidden[agents][sought].mean()), 3) if sought.any() else None,
    }


def _free(tree: BVHTree, frame: Frame, points: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Which of the places (n, 3) meters, at the depth (n,), no mesh is before, (n,) bool."""
    camera = frame.camera
    begin = np.broadcast_to(camera.origin, points.shape)
    if camera.kind == "ORTHO":
        begin = points - depth[:, None] * camera.Z
    way = points - begin
    begin = begin + way * (camera.near / depth)[:, None]
    length = np.linalg.norm(points - begin, axis=1)
    rays = zip(begin.tolist(), way.tolist(), length.tolist(), strict=True)
    return np.array([tree.ray_cast(Vector(a), Vector(b), c)[0] is None for a, b, c in rays], bool)


def opaque_tree(scene: bpy.types.Scene) -> BVHTree:
    """The tree of all meshes that let nothing through, as they are now."""
    points = []
    faces = []
    for instance in scene.view_layers[0].depsgraph.object_instances:
        item = instance.object
        materials = {slot.material.name for slot in item.material_slots if slot.material}
        if not item.name.startswith(street.MESHES) or materials & street.SEE_THROUGH:
            continue
        matrix = instance.matrix_world.copy()
        first = len(points)
        points += [matrix @ vertex.co for vertex in item.data.vertices]
        faces += [[first + k for k in face.vertices] for face in item.data.polygons]
    return BVHTree.FromPolygons(points, faces)


def judge_many(number: int) -> dict:
    """A row for a frame of a street of MANY agents: rays, recall, milliseconds."""
    scene = street.make_street(MANY, 12)
    frame = plan_of(scene, number)
    around = read_surroundings(scene, scene.view_layers[0].depsgraph, scene_data.time_of(scene))
    scene.crowd_lod.occlusion = False
    whole = plan_of(scene, number)
    cpu = time.process_time()
    for _ in range(REPEATS):
        hide(whole, around.occluders)
    cpu = time.process_time() - cpu
    rays = max(8, MANY_RAYS // len(whole.buckets.order))
    return {
        "frame": number,
        **_counts(frame),
        "triangles": len(around.occluders.topology.triangles),
        "cpu_ms": round(1000 * cpu / REPEATS, 1),
        **judge_by_rays(scene, frame, rays),
    }


def compare_renders(folder: Path, engine: str, agents: int) -> list[dict]:
    """Rows for bakes of a frame without a crowd, with everyone, and without who is hidden.

    Each has its parts of what everyone takes, whole and less what nobody takes (none where
    everyone takes hardly more than that).
    """
    rows = []
    for way in ("nobody", "everyone", "occlusion"):
        file = str(folder / f"{way}_{agents}.blend")
        made = job(
            LIMIT, "occlusion.py", job="make", way=way, engine=engine, file=file, agents=agents
        )
        picture = str(folder / f"{way}.exr")
        took = job(LIMIT, "occlusion.py", job="render", file=file, picture=picture)
        rows.append({"engine": engine, "agents": agents, "way": way, **made, **took})
    if any("ended" in row for row in rows):
        return rows
    nobody, everyone, _ = rows
    values = [_values(folder / f"{row['way']}.exr") for row in rows]
    for row, pixels in zip(rows, values, strict=True):
        for name in ("cpu_s", "peak_mb"):
            row[f"{name}_part"] = round(row[name] / everyone[name], 3)
            crowd = everyone[name] - nobody[name]
            is_told = crowd > LEAST_CROWD * nobody[name]
            part = round((row[name] - nobody[name]) / crowd, 3) if is_told else None
            row[f"{name}_part_of_crowd"] = part
        row["values_that_differ"] = int((np.abs(pixels - values[1]) > 1e-4).sum())
        print(*row.values(), sep="\t", flush=True)
    return rows


def make(way: str, engine: str, file: str, agents: int) -> dict:
    """Write the file of a street, baked for one frame; return what it holds."""
    crowd_lod_extension.register()
    scene = street.make_street(agents, 12)
    settings = scene.crowd_lod
    settings.occlusion = way == "occlusion"
    scene.render.engine = ENGINES[engine]
    scene.cycles.device = "CPU"
    scene.cycles.samples = 4
    scene.eevee.taa_render_samples = 1
    scene.render.resolution_percentage = {"EEVEE": 33}.get(engine, 100)  # a GPU may be software
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.cycles.max_bounces = 0  # hidden agents' light that bounces is lost (docs/limits.md)
    finished(make_levels(scene))
    finished(bake.bake(scene, [SHOWN]))
    shown = sum(len(item.data.vertices) for item in shelves.points_of(settings.build).values())
    hide_characters(scene)
    bake.keep_what_renders(scene)
    if way == "nobody":
        render_setup.remove_build(settings)
    bpy.ops.wm.save_as_mainfile(filepath=file)
    return {"agents_in_file": shown, "file_mb": round(Path(file).stat().st_size / 1e6, 2)}


def render(file: str, picture: str) -> dict:
    """Render the file's frame; return the processor's seconds and the largest memory, MB."""
    bpy.ops.wm.open_mainfile(filepath=file)
    scene = bpy.context.scene
    scene.frame_set(SHOWN)
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = picture
    cpu = time.process_time()
    bpy.ops.render.render(write_still=True)
    cpu = time.process_time() - cpu
    return {
        "cpu_s": round(cpu, 2),
        "peak_mb": round(peak_mb()),
    }


if __name__ == "__main__":
    answer(make, render)
