"""What LOD meshes take from their sources, each against what is known of a made-up source."""

import bmesh
import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.simplification.decimate import LodMesh
from crowd_lod_extension.operators.blender import mesh_data
from crowd_lod_extension.operators.lods.attribute_transfer import dress, set_normals
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.lods.source_mesh import read_source
from mathutils import Matrix, Vector

from ..support.characters import character, new, rig, rigged, tube
from ..support.objects import mesh_of


def lod(k, item):
    """The LOD of `item` with as many triangles as LOD k of the settings has."""
    scene = bpy.context.scene
    settings = scene.crowd_lod
    if settings.characters is None:
        character(item)
    settings.level_count = 2
    settings.ratios[1] = settings.ratios[k]
    list(make_levels(scene))
    return next(
        o for o in settings.levels.children[1].all_objects if o.name.startswith(f"{item.name} LOD")
    )


def samples(mesh, count=4000):
    """(points, face, barycentric weights) spread over a mesh of triangles."""
    mesh.calc_loop_triangles()
    points = np.array([v.co for v in mesh.vertices])
    corners = points[np.array([t.vertices for t in mesh.loop_triangles])]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    random = np.random.default_rng(0)
    face = random.choice(len(area), count, p=area / area.sum())
    weights = random.dirichlet((1, 1, 1), count)
    return np.einsum("nk,nkd->nd", weights, corners[face]), face, weights


def uvs_at(mesh, layer, face, weights):
    loops = np.array([mesh.loop_triangles[f].loops for f in face])
    values = np.array([d.vector for d in mesh.uv_layers[layer].uv])
    return np.einsum("nk,nkd->nd", weights, values[loops])


@pytest.mark.parametrize("split", [False, True])
def test_uvs_of_every_map_are_right_on_both_sides_of_a_seam_within_one_island(split):
    """The tube's u is the angle and its v the height, in the first map.

    The second has them the other way round. Split along its seam, as importers leave meshes, it is
    no different, and does not gape.
    """
    mesh = tube("body", 48, 24, split=split)
    second = mesh.uv_layers.new(name="Second")
    for a, b in zip(mesh.uv_layers["UVMap"].uv, second.uv, strict=True):
        b.vector = tuple(a.vector)[::-1]
    mesh.uv_layers.active = second
    mesh.uv_layers["UVMap"].active_render = True
    made = lod(2, new("body", mesh)).data
    assert [layer.name for layer in made.uv_layers] == ["UVMap", "Second"]
    assert made.uv_layers.active.name == "Second" and made.uv_layers["UVMap"].active_render
    points, face, weights = samples(made)
    u = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) % 1
    v = points[:, 2] / 2
    for layer, expected in (("UVMap", (u, v)), ("Second", (v, u))):
        gap = np.linalg.norm(
            uvs_at(made, layer, face, weights) - np.stack(expected, axis=1), axis=1
        )
        assert (gap > 0.05).mean() < 0.02
        values = np.array([d.vector for d in made.uv_layers[layer].uv])
        assert values.min() >= -1e-5 and values.max() <= 1 + 1e-5
    open_edges = {}
    for polygon in made.polygons:
        for edge in polygon.edge_keys:
            open_edges[edge] = open_edges.get(edge, 0) + 1
    heights = [
        made.vertices[v].co.z for edge, times in open_edges.items() if times == 1 for v in edge
    ]
    assert max(open_edges.values()) == 2 and all(
        min(z, 2 - z) < 0.005 for z in heights
    )  # open at its two ends only


@pytest.mark.once
def test_a_lining_does_not_darken_its_coat():
    """The LOD has eight sides; their middles lie within the lining."""
    coat = tube("coat", 32, 12, radius=0.2)
    lining = tube("lining", 32, 12, radius=0.19)
    lining.flip_normals()
    cloth = bmesh.new()
    for sheet in (coat, lining):
        sheet.uv_layers.remove(sheet.uv_layers[0])
        cloth.from_mesh(sheet)
    hem = [edge for edge in cloth.edges if edge.is_boundary and edge.verts[0].co.z < 1]
    bmesh.ops.bridge_loops(cloth, edges=hem)
    cloth.to_mesh(coat)
    coat.shade_smooth()
    source = read_source(new("coat", coat))
    coarse = tube("coarse", 8, 2, radius=0.2)
    read = mesh_data.read_mesh(coarse)
    away = np.linalg.norm(read.points[:, None] - source.geometry.points, axis=2)
    result = LodMesh(read.points, read.triangles, away.argmin(axis=1))
    dressed = finished(dress("coat LOD", result, source))
    set_normals(dressed)
    assert all(
        dressed.corner_normals[loop].vector @ polygon.normal > 0.5
        for polygon in dressed.polygons
        for loop in polygon.loop_indices
    )


@pytest.mark.once
def test_a_sleeve_takes_nothing_from_the_arm_in_it():
    arm = tube("arm", radius=0.2)
    sleeve = tube("sleeve", radius=0.203)
    points = [tuple(v.co) for mesh in (arm, sleeve) for v in mesh.vertices]
    count = len(arm.vertices)
    faces = [
        tuple(v + shift for v in p.vertices)
        for mesh, shift in ((arm, 0), (sleeve, count))
        for p in mesh.polygons
    ]
    both = mesh_of("both", points, faces)
    both.materials.append(bpy.data.materials.new("skin"))
    both.materials.append(bpy.data.materials.new("cloth"))
    both.polygons.foreach_set(
        "material_index", np.repeat([0, 1], len(arm.polygons)).astype(np.int32)
    )
    color = both.color_attributes.new("Point", "FLOAT_COLOR", "POINT")
    color.data.foreach_set(
        "color", np.repeat([[1, 0, 0, 1], [0, 0, 1, 1]], count, axis=0).astype(np.float32).ravel()
    )
    corner = both.color_attributes.new("Corner", "BYTE_COLOR", "CORNER")
    corner.data.foreach_set(
        "color",
        np.repeat([[1, 0, 0, 1], [0, 0, 1, 1]], 4 * len(arm.polygons), axis=0)
        .astype(np.float32)
        .ravel(),
    )
    both.color_attributes.active_color_index = 1
    made = lod(1, new("both", both)).data
    neighbors = {v.index: set() for v in made.vertices}
    for a, b in (e.vertices for e in made.edges):
        neighbors[a].add(b), neighbors[b].add(a)
    assert (
        made.color_attributes["Corner"].data_type == "BYTE_COLOR"
        and made.color_attributes["Corner"].domain == "CORNER"
    )
    assert made.color_attributes.active_color.name == "Corner"
    seen = set()
    for start in neighbors:  # each loose part is all skin or all cloth, in every layer
        part = set()
        todo = [start]
        while todo:
            vertex = todo.pop()
            if vertex not in part:
                part.add(vertex)
                todo += neighbors[vertex]
        cloth = {p.material_index for p in made.polygons if p.vertices[0] in part}
        blue = {round(made.color_attributes["Point"].data[v].color[2], 3) for v in part}
        corners = {
            round(made.color_attributes["Corner"].data[i].color[2], 2)
            for p in made.polygons
            if p.vertices[0] in part
            for i in p.loop_indices
        }
        assert len(cloth) == 1 and blue == corners == cloth
        seen |= cloth
        if len(seen) == 2:
            break
    assert seen == {0, 1}


@pytest.mark.once
def test_weights_sum_to_one_over_four_bones_at_most_and_other_groups_stay():
    body, armature = rigged("body")
    for number in range(4):  # six bones at each vertex, two of them slight
        name = f"extra {number}"
        body.vertex_groups.new(name=name).add(
            range(len(body.data.vertices)), (0.3, 0.2, 0.01, 0.02)[number], "REPLACE"
        )
    bpy.context.scene.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    for number in range(4):
        bone = armature.data.edit_bones.new(f"extra {number}")
        bone.head = (0, 0, 0)
        bone.tail = (0, 0, 1)
    bpy.ops.object.mode_set(mode="OBJECT")
    body.vertex_groups.new(name="pinned").add(range(len(body.data.vertices)), 0.7, "REPLACE")
    character(armature, body)
    made = lod(2, body)
    assert made.vertex_groups.keys() == body.vertex_groups.keys()
    pinned = made.vertex_groups["pinned"].index
    for vertex in made.data.vertices:
        bones = {
            made.vertex_groups[e.group].name: e.weight
            for e in vertex.groups
            if e.group != pinned and e.weight > 0
        }
        assert len(bones) <= 4 and sum(bones.values()) == pytest.approx(1, abs=1e-4)
        assert (
            "extra 2" not in bones or len(bones) < 4 or "upper" not in bones or "lower" not in bones
        )
        upper = np.clip((vertex.co.z - 0.5) / 1.0, 0, 1)
        total = 1 + 0.3 + 0.2
        assert bones.get("upper", 0) == pytest.approx(
            upper / total, abs=0.15
        )  # those that suit its poses best
        assert next(e.weight for e in vertex.groups if e.group == pinned) == pytest.approx(
            0.7, abs=1e-3
        )


def test_custom_normals_are_rebuilt():
    """A tube whose custom normals all lean up by 45 degrees."""
    body = tube("body", 48, 24)
    lean = [Vector((v.co.x / 0.2, v.co.y / 0.2, 1)).normalized() for v in body.vertices]
    body.normals_split_custom_set_from_vertices(lean)
    made = lod(2, new("body", body)).data
    assert made.has_custom_normals and not any(
        a.name.startswith("crowd_lod") for a in made.attributes
    )
    for loop, normal in zip(made.loops, made.corner_normals, strict=True):
        x, y, _ = made.vertices[loop.vertex_index].co
        assert normal.vector.dot(Vector((x, y, np.hypot(x, y))).normalized()) > 0.98


def test_sharp_edges_and_flat_faces_stay():
    """A smooth tube with a ledge of sharp edges at half its height, and flat above 1.83."""
    body = tube("body", 48, 24)
    for vertex in body.vertices:
        if vertex.co.z > 1.01:
            vertex.co.x *= 1.4
            vertex.co.y *= 1.4
    body.update()
    for edge in body.edges:
        edge.use_edge_sharp = (
            all(0.99 < body.vertices[v].co.z < 1.1 for v in edge.vertices)
            and len({round(body.vertices[v].co.z, 3) for v in edge.vertices}) == 1
        )
    for polygon in body.polygons:
        polygon.use_smooth = polygon.center.z < 1.8
    made = lod(1, new("body", body)).data
    for polygon in made.polygons:
        heights = [made.vertices[v].co.z for v in polygon.vertices]
        if max(heights) < 1.82 or min(heights) > 1.84:
            assert polygon.use_smooth == (polygon.center.z < 1.8)
    on_ledge = [
        e for e in made.edges if all(0.98 < made.vertices[v].co.z < 1.1 for v in e.vertices)
    ]
    level = [
        e
        for e in on_ledge
        if abs(made.vertices[e.vertices[0]].co.z - made.vertices[e.vertices[1]].co.z) < 0.005
    ]
    assert len(level) > 20 and np.mean([e.use_edge_sharp for e in level]) > 0.9
    away = [e for e in made.edges if all(made.vertices[v].co.z < 0.95 for v in e.vertices)]
    assert not any(e.use_edge_sharp for e in away)


@pytest.mark.once
def test_no_face_is_flipped_or_doubled():
    bpy.ops.mesh.primitive_monkey_add()
    item = bpy.context.object
    item.modifiers.new("Subdivision", "SUBSURF").levels = 1
    made = lod(1, item).data
    depsgraph = bpy.context.evaluated_depsgraph_get()
    full = item.evaluated_get(depsgraph)
    flipped = 0.0
    area = 0.0
    for polygon in made.polygons:
        hit, _, normal, _ = full.closest_point_on_mesh(polygon.center)
        area += polygon.area
        flipped += polygon.area * (hit and normal.dot(polygon.normal) < -0.2)
    assert flipped < 0.01 * area
    keys = [tuple(sorted(p.vertices)) for p in made.polygons]
    assert len(set(keys)) == len(keys)


def test_how_and_how_long_are_kept_with_each_lod():
    made = lod(1, new("body", tube("body")))
    assert (made["crowd_lod_method"], made["crowd_lod_why"]) == ("POSE_AWARE", "")
    assert made["crowd_lod_ms"] > 0


@pytest.mark.once
def test_normals_of_few_triangles_are_the_source_s_under_posing_too():
    """A smooth egg without custom normals, which a bone turns: of its LODs normals are those of the
    egg at each place.
    """
    size = np.array([0.3, 0.2, 0.5])
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=32)
    item = bpy.context.object
    item.data.transform(Matrix.Diagonal((*size, 1)))
    item.data.transform(Matrix.Translation((0, 0, 1.5)))
    item.data.shade_smooth()
    armature = rig()
    item.vertex_groups.new(name="upper").add(range(len(item.data.vertices)), 1.0, "REPLACE")
    item.parent = armature
    item.modifiers.new("Armature", "ARMATURE").object = armature
    character(armature, item)
    made = lod(2, item)
    scene = bpy.context.scene
    scene.collection.objects.link(made)
    for frame in (1, 10):
        scene.frame_set(frame)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        posed = armature.evaluated_get(depsgraph).pose.bones["upper"]
        turn = np.array(posed.matrix @ posed.bone.matrix_local.inverted())
        mesh = made.evaluated_get(depsgraph).data
        points, face, weights = samples(mesh)
        loops = np.array([triangle.loops for triangle in mesh.loop_triangles])[face]
        shaded = np.einsum(
            "nk,nkd->nd",
            weights,
            np.array([normal.vector for normal in mesh.corner_normals])[loops],
        )
        back = (points - turn[:3, 3]) @ turn[:3, :3] - (0, 0, 1.5)
        wanted = back / size**2 @ turn[:3, :3].T
        cosine = (
            (shaded * wanted).sum(axis=1)
            / np.linalg.norm(shaded, axis=1)
            / np.linalg.norm(wanted, axis=1)
        )
        assert len(mesh.polygons) < 450 and np.degrees(np.arccos(np.median(cosine))) < 0.6
