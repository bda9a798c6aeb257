"""LOD meshes against their peers, at the same count of triangles.

Prints Hausdorff distance and CPU time.

The distance is measured at points spread over each of the two surfaces and at all their vertices,
in percent of the bounding box's diagonal. "x" is the distance over that of fast-simplification with
its default aggressiveness, 7.
"""

import argparse
import time
from pathlib import Path

import bpy
import fast_simplification
import numpy as np
from crowd_lod_extension.crowd_lod.mesh import Mesh
from crowd_lod_extension.crowd_lod.output.accuracy_page import COLORS
from crowd_lod_extension.crowd_lod.simplification.decimate import decimate
from crowd_lod_extension.operators.blender.mesh_data import new_mesh, read_mesh
from crowd_lod_extension.operators.lods.surface import Surface, deviation
from crowd_lod_extension.sample_scenes.characters import make_characters
from matplotlib.figure import Figure

MARKERS = "osD^v<>"  # of matplotlib

RATIOS = (0.4, 0.12, 0.03)
SAMPLES = 10_000  # points over each surface, besides its vertices
FLOOR = 1e-4  # percent: smaller distances are drawn there


def crowd_lod(points, triangles, ratio):
    lod = decimate(Mesh(points, triangles), ratio, "benchmark")
    return lod.points, lod.triangles


def fast(points, triangles, ratio):
    return fast_simplification.simplify(
        points, triangles.astype(np.int32), target_count=round(ratio * len(triangles))
    )


def blender(points, triangles, ratio):
    item = bpy.data.objects.new("benchmark", new_mesh("benchmark", points, triangles))
    bpy.context.scene.collection.objects.link(item)
    modifier = item.modifiers.new("Decimate", "DECIMATE")
    modifier.ratio = ratio
    modifier.use_collapse_triangulate = True
    try:
        coarse = read_mesh(item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data)
        return coarse.points, coarse.triangles
    finally:
        bpy.data.objects.remove(item)


METHODS = {"fast-simplification": fast, "Crowd LOD": crowd_lod, "Blender's Decimate": blender}


def evaluated(item: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    for modifier in [m for m in item.modifiers if m.type == "ARMATURE"]:
        item.modifiers.remove(modifier)
    read = read_mesh(item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data)
    return read.points.astype(np.float64), read.triangles


def added(add, modifier: str = "", **settings) -> tuple[np.ndarray, np.ndarray]:
    add()
    if modifier:
        made = bpy.context.object.modifiers.new(modifier, modifier)
        for name, value in settings.items():
            setattr(made, name, value)
    return evaluated(bpy.context.object)


def terrain(n: int = 174) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(0, 10, n), np.linspace(0, 10, n), indexing="ij")
    z = np.zeros_like(x)
    for fx, fy in random.normal(scale=2, size=(40, 2)):
        z += 0.175 * np.sin(fx * x + fy * y + random.uniform(0, 7)) / np.hypot(fx, fy)
    i = np.arange(n * n).reshape(n, n)
    a = i[:-1, :-1]
    b = i[1:, :-1]
    c = i[1:, 1:]
    d = i[:-1, 1:]
    return np.stack([x, y, z], -1).reshape(-1, 3), np.concatenate(
        [np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    )


def loose(points, triangles, count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    copies = [points * random.uniform(0.1, 0.5, 3) + random.uniform(-6, 6, 3) for _ in range(count)]
    return np.concatenate(copies), np.concatenate(
        [triangles + k * len(points) for k in range(count)]
    )


def knot(p: int, q: int, along: int, around: int) -> tuple[np.ndarray, np.ndarray]:
    """A tube about the torus knot (p, q)."""
    u, v = (np.linspace(0, 2 * np.pi, n, endpoint=False) for n in (along, around))

    def path(u):
        return np.stack(
            [
                (2 + np.cos(q * u)) * np.cos(p * u),
                (2 + np.cos(q * u)) * np.sin(p * u),
                -np.sin(q * u),
            ],
            -1,
        )

    ahead = path(u + 1e-4) - path(u - 1e-4)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    out = np.stack(
        [np.cos(q * u) * np.cos(p * u), np.cos(q * u) * np.sin(p * u), -np.sin(q * u)], -1
    )
    out -= ahead * (out * ahead).sum(axis=1, keepdims=True)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    ring = np.cos(v)[:, None] * out[:, None] + np.sin(v)[:, None] * np.cross(ahead, out)[:, None]
    a = np.arange(along * around).reshape(along, around)
    b = np.roll(a, -1, axis=0)
    d = np.roll(a, -1, axis=1)
    c = np.roll(b, -1, axis=1)
    triangles = [np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    return (path(u)[:, None] + 0.4 * ring).reshape(-1, 3), np.concatenate(triangles)


def other_meshes() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Meshes that are hard to decimate: many parts, noise, knots, poles."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    mesh = bpy.ops.mesh
    shapes = {}
    kinds = {
        "UV spheres": lambda: mesh.primitive_uv_sphere_add(segments=16, ring_count=10),
        "icospheres": lambda: mesh.primitive_ico_sphere_add(subdivisions=2),
        "tori": lambda: mesh.primitive_torus_add(major_segments=16, minor_segments=10),
        "cylinders": lambda: mesh.primitive_cylinder_add(vertices=24),
        "cubes": mesh.primitive_cube_add,
        "Suzannes": mesh.primitive_monkey_add,
    }
    for name, add in kinds.items():
        count = 60 if name == "Suzannes" else 200
        shapes[f"{count} {name}"] = loose(*added(add), count)
    shapes["knot (2, 3)"] = knot(2, 3, 600, 50)
    shapes["knot (3, 5)"] = knot(3, 5, 400, 30)
    shapes["UV sphere"] = added(mesh.primitive_uv_sphere_add)
    shapes["torus, small"] = added(
        lambda: mesh.primitive_torus_add(major_segments=80, minor_segments=48)
    )
    points, triangles = shapes["remeshed"] = added(
        mesh.primitive_monkey_add, "REMESH", mode="VOXEL", voxel_size=0.017
    )
    shapes["with noise"] = (
        points + np.random.default_rng(0).normal(scale=0.002, size=points.shape),
        triangles,
    )
    return shapes


def meshes(files: list[str]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    mesh = bpy.ops.mesh
    shapes = {"Suzanne": added(mesh.primitive_monkey_add, "SUBSURF", levels=3)}
    shapes["sphere"] = added(lambda: mesh.primitive_ico_sphere_add(subdivisions=6))
    shapes["torus"] = added(lambda: mesh.primitive_torus_add(major_segments=192, minor_segments=96))
    shapes["cube"] = added(mesh.primitive_cube_add, "SUBSURF", subdivision_type="SIMPLE", levels=6)
    shapes["terrain"] = terrain()
    shapes["200 parts"] = loose(*added(lambda: mesh.primitive_ico_sphere_add(subdivisions=3)))
    characters = bpy.data.collections.new("characters")
    bpy.context.scene.collection.children.link(characters)
    for group in make_characters(characters):
        shapes[group.name] = evaluated(next(item for item in group.objects if item.type == "MESH"))
    for path in files:
        before = set(bpy.data.objects)
        bpy.ops.import_scene.gltf(filepath=path)
        body = max(
            (o for o in set(bpy.data.objects) - before if o.type == "MESH"),
            key=lambda o: len(o.data.polygons),
        )
        shapes[body.name] = evaluated(body)
    return shapes


def main(picture: Path | None, files: list[str], other: bool) -> None:
    rows = []
    print(
        f"{'mesh':14} {'ratio':>5}  {'method':20} {'triangles':>9} {'ms':>7} {'distance %':>10} "
        f"{'x':>6}"
    )
    for name, (points, triangles) in (other_meshes() if other else meshes(files)).items():
        source = Surface(points, triangles)
        diagonal = np.linalg.norm(np.ptp(points, axis=0))
        for ratio in RATIOS:
            base = None
            for method, run in METHODS.items():
                begin = time.process_time()
                new_points, new_triangles = run(points, triangles, ratio)
                ms = 1000 * (time.process_time() - begin)
                distance = (
                    100
                    * deviation(source, Surface(new_points, new_triangles), SAMPLES)[0]
                    / diagonal
                )
                # the first is what the others are held against
                base = distance if base is None else base
                rows.append((ratio, method, ms, distance))
                count = len(new_triangles)
                x = distance / base
                print(
                    f"{name:14} {ratio:5}  {method:20} {count:9,} {ms:7.0f} {distance:10.4f} "
                    f"{x:6.2f}",
                    flush=True,
                )
    if picture:
        draw(picture, rows)


def draw(picture: Path, rows: list[tuple]) -> None:
    figure = Figure(figsize=(12, 5.5), dpi=100, layout="constrained")
    figure.suptitle(
        "Decimation: distance to the source against run time, a point a mesh; nearer to the lower "
        "left is better"
    )
    for axes, ratio in zip(
        figure.subplots(1, len(RATIOS), sharex=True, sharey=True), RATIOS, strict=True
    ):
        for k, method in enumerate(METHODS):
            dots = [
                (ms, max(distance, FLOOR))
                for r, m, ms, distance in rows
                if (r, m) == (ratio, method)
            ]
            axes.plot(
                *zip(*dots, strict=True), MARKERS[k], color=COLORS[k], alpha=0.8, label=method
            )
        axes.set(
            xscale="log",
            yscale="log",
            title=f"{100 * ratio:g} % of the triangles",
            xlabel="CPU time (ms)",
        )
        axes.grid(alpha=0.25)
    figure.axes[0].set_ylabel("Hausdorff distance (% of the diagonal)")
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=3,
        frameon=False,
    )
    figure.savefig(picture, pil_kwargs={"optimize": True})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "files", nargs="*", metavar="FILE.glb", help="more meshes: the largest of each file"
    )
    parser.add_argument(
        "--picture",
        type=Path,
        metavar="PICTURE.png",
        help="draw the distances against the run times",
    )
    parser.add_argument(
        "--other", action="store_true", help="other meshes: many parts, knots, scans"
    )
    args = parser.parse_args()
    main(args.picture, args.files, args.other)
