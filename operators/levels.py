"""LOD meshes: decimated copies of every character, in collections that the user can see and edit."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ..crowd_lod.agents import Group
from ..crowd_lod.meshes import LodMesh, decimate
from . import chain
from . import scene as io
from .deviation import measure
from .operator import Stepwise
from .populate import characters_of, count_of, measure_groups, store_groups

# LOD 0 red, 1 green, 2 blue, as in the chapter's figure 1.5; then colours that stay apart for colour-blind eyes
# (Okabe and Ito). Linear RGB.
TINTS = (
    (0.80, 0.03, 0.03),
    (0.04, 0.60, 0.06),
    (0.05, 0.12, 0.85),
    (0.78, 0.35, 0.00),
    (0.09, 0.46, 0.81),
    (0.87, 0.78, 0.05),
    (0.60, 0.19, 0.38),
    (0.90, 0.90, 0.90),
)
OWNED = "crowd_lod"  # custom property on what Crowd LOD made, and may remove


def make_levels(scene: bpy.types.Scene) -> Iterator[float]:
    """Make the LOD collections of `scene` anew; yields the progress, 0 to 1.

    "Crowd LOD" holds a collection a LOD, which holds one a character group, named so that their natural order is the
    groups'. LOD 0 shares the characters' own meshes; the others are decimated from the character as modified, keep its
    weights, materials and UVs, and follow its armature. Nothing of the user's is changed. If it fails or is closed
    early, the LODs that were there stay.
    """
    settings = scene.crowd_lod
    characters = characters_of(scene)
    groups = measure_groups(scene)
    ratios = chain.ratios_of(settings)
    count = len(ratios)
    before = set(bpy.data.user_map())
    top = bpy.data.collections.new("Crowd LOD")
    done = False
    try:
        levels = []
        for k in range(count):
            level = bpy.data.collections.new(f"Crowd LOD {k}")
            top.children.link(level)
            levels.append(level)
        made: list[Group] = []
        for g, ((name, objects, origin), group) in enumerate(zip(characters, groups, strict=True)):
            sources = [_source_mesh(item) for item in objects]
            vertices, triangles = [], []
            for k, (level, ratio) in enumerate(zip(levels, ratios, strict=True)):
                home = bpy.data.collections.new(f"{g:03d} {name} LOD {k}")
                home.instance_offset = origin
                level.children.link(home)
                sizes = [_level_object(item, source, home, k, ratio) for item, source in zip(objects, sources, strict=True)]
                vertices.append(sum(v for v, _ in sizes))
                triangles.append(sum(t for _, t in sizes))
                yield (g + 0.5 * (k + 1) / count) / len(groups)
            bpy.data.batch_remove(sources)
            group = replace(group, vertices=tuple(vertices), triangles=tuple(triangles))
            meshes = [list(level.children[g].objects) for level in levels]
            made.append((yield from measure(group, objects, meshes, ((g + 0.5) / len(groups), (g + 1) / len(groups)))))
        keep, dropped = None, []
        if settings.choice == "BY_TOLERANCE":
            keep, dropped = yield from chain.chosen(scene, made, 0.99)
        done = True
    finally:
        if not done:
            bpy.data.batch_remove([block for block in bpy.data.user_map() if block not in before])
    if keep:
        levels, made = chain.prune(levels, made, keep, TINTS)
    if settings.levels is not None:
        remove_owned(settings.levels, levels)
    for block in bpy.data.user_map():
        if block not in before:
            block[OWNED] = True
            block.name = re.sub(r"\.\d+$", "", block.name)  # free again, now that the earlier LODs are gone
    scene.collection.children.link(top)
    for view_layer in scene.view_layers:
        view_layer.update()  # a scene that was never evaluated has no layer collections yet
        view_layer.layer_collection.children[top.name].exclude = True
    settings.levels, settings.dropped = top, "\n".join(dropped)
    store_groups(settings, tuple(made))


def remove_owned(top: bpy.types.Collection, heirs: Sequence[bpy.types.Collection] = ()) -> None:
    """Remove the collection `top` and all that Crowd LOD made in it; what the user put there moves up into the scene.
    Whatever refers to a child of `top`, such as a build, then refers to the heir in its place."""
    inside = {top, *top.children_recursive}
    for item in list(top.all_objects):
        if not item.get(OWNED) and inside.issuperset(item.users_collection):
            for scene in item.users_scene:
                scene.collection.objects.link(item)
    objects = [o for o in top.all_objects if o.get(OWNED)]
    data = [o.data for o in objects if o.data is not None and o.data.get(OWNED)]
    doomed = [*objects, *data, *top.children_recursive, top]
    for child, heir in zip(list(top.children), heirs, strict=False):
        child.user_remap(heir)
    bpy.data.batch_remove(doomed)


def _source_mesh(item: bpy.types.Object) -> bpy.types.Mesh:
    """A new mesh: `item` with its modifiers applied, but for armatures, in its own space and rest pose."""
    with_modifiers = item.copy()
    try:
        for modifier in list(with_modifiers.modifiers):
            if modifier.type == "ARMATURE":
                with_modifiers.modifiers.remove(modifier)
        if with_modifiers.parent_type == "ARMATURE":
            with_modifiers.parent_type = "OBJECT"
        stage = bpy.data.scenes.new("Crowd LOD source")
        try:
            stage.collection.objects.link(with_modifiers)
            stage.view_layers[0].update()
            depsgraph = stage.view_layers[0].depsgraph
            return bpy.data.meshes.new_from_object(
                with_modifiers.evaluated_get(depsgraph), preserve_all_data_layers=True, depsgraph=depsgraph
            )
        finally:
            bpy.data.scenes.remove(stage)
    finally:
        bpy.data.objects.remove(with_modifiers)


def _level_object(item, source: bpy.types.Mesh, home: bpy.types.Collection, level: int, ratio: float) -> tuple[int, int]:
    """Put the LOD `level` of the object `item` into `home`; (vertices, triangles) of its mesh."""
    copy = item.copy()
    home.objects.link(copy)
    copy.name = f"{item.name} LOD {level}"
    copy.color = (*TINTS[level], 1.0)
    copy.hide_render = copy.hide_viewport = False
    if level == 0 and ratio == 1:
        # the character's own mesh; the counts are of what is drawn, modifiers applied
        return len(source.vertices), len(source.loops) - 2 * len(source.polygons)
    for modifier in list(copy.modifiers):
        if modifier.type != "ARMATURE":
            copy.modifiers.remove(modifier)
    # the names live in the mesh, and go with the old one
    names = [group.name for group in item.vertex_groups]
    if len(source.polygons):
        points, triangles, corners, faces = io.read_triangles(source)
        result = decimate(points, triangles, ratio, item.name)
        copy.data = _dress(f"{item.name} LOD {level}", result, source, points, triangles, corners, faces)
        _carry_weights(copy, names, result, source)
    else:
        copy.data = bpy.data.meshes.new(f"{item.name} LOD {level}")
    return len(copy.data.vertices), len(copy.data.polygons)


def _dress(name: str, result: LodMesh, source: bpy.types.Mesh, points, triangles, corners, faces) -> bpy.types.Mesh:
    """The decimated mesh with the source's weights, materials, smoothness and UVs.

    Weights come from the source vertex that each vertex stands for; the rest from the source face nearest to each
    triangle's centre, UVs by barycentric coordinates of the corners on the source face nearest to them, seen from the
    triangle's inside so that a corner on a UV seam takes the right side.
    """
    mesh = io.new_mesh(name, result.points, result.triangles)
    for material in source.materials:
        mesh.materials.append(material)
    tree = BVHTree.FromPolygons(points.tolist(), triangles.tolist())
    centres = result.points[result.triangles].mean(axis=1)
    nearest = np.array([tree.find_nearest(Vector(c))[2] for c in centres])
    for attribute, kind in (("material_index", np.int32), ("use_smooth", bool)):
        values = np.empty(len(source.polygons), kind)
        source.polygons.foreach_get(attribute, values)
        mesh.polygons.foreach_set(attribute, values[faces[nearest]])
    if source.uv_layers:
        _carry_uvs(mesh, result, source, points, triangles, corners, tree, centres)
    mesh.update()
    return mesh


def _carry_uvs(mesh, result: LodMesh, source, points, triangles, corners, tree: BVHTree, centres) -> None:
    inward = 0.9 * result.points[result.triangles] + 0.1 * centres[:, None]
    hits = [tree.find_nearest(Vector(p)) for p in inward.reshape(-1, 3)]
    faces = np.array([hit[2] for hit in hits])
    at = np.array([tuple(hit[0]) for hit in hits])
    a, b, c = (points[triangles[faces, i]].astype(np.float64) for i in range(3))
    weights = _barycentric(at, a, b, c)
    for layer in source.uv_layers:
        uvs = np.empty((len(source.loops), 2), np.float32)
        layer.uv.foreach_get("vector", uvs.ravel())
        carried = np.einsum("nk,nkd->nd", weights, uvs[corners[faces]])
        mesh.uv_layers.new(name=layer.name).uv.foreach_set("vector", carried.astype(np.float32).ravel())


def _barycentric(p, a, b, c) -> np.ndarray:
    """Barycentric coordinates (n, 3) of the points p on the triangles a, b, c, each (n, 3)."""
    u, v, w = b - a, c - a, p - a
    uu, uv, vv, wu, wv = (np.einsum("nd,nd->n", *pair) for pair in ((u, u), (u, v), (v, v), (w, u), (w, v)))
    area = uu * vv - uv * uv
    flat = area <= 1e-30
    area[flat] = 1
    s, t = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
    s[flat] = t[flat] = 1 / 3
    return np.stack([1 - s - t, s, t], axis=1).clip(0, 1)


def _carry_weights(copy: bpy.types.Object, names: list[str], result: LodMesh, source: bpy.types.Mesh) -> None:
    """Give `copy`, whose mesh is `result`, the weights that the source's vertices have in the vertex groups `names`."""
    for name in names:
        copy.vertex_groups.new(name=name)
    vertices_by_entry: dict[tuple[int, float], list[int]] = {}
    for vertex, origin in enumerate(result.source):
        for entry in source.vertices[int(origin)].groups:
            vertices_by_entry.setdefault((entry.group, entry.weight), []).append(vertex)
    for (index, weight), vertices in vertices_by_entry.items():
        copy.vertex_groups[index].add(vertices, weight, "REPLACE")


class CROWDLOD_OT_make_levels(Stepwise, bpy.types.Operator):
    """Make the LOD meshes of every character by decimation; the characters stay as they are"""

    bl_idname = "crowd_lod.make_levels"
    bl_label = "Make LOD Meshes"

    def steps(self, context):
        yield from make_levels(context.scene)
        settings = context.scene.crowd_lod
        return f"{count_of(settings)} LODs of {len(settings.groups)} character groups."


CLASSES = (CROWDLOD_OT_make_levels,)
