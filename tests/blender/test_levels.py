import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators.blender import mesh_data
from crowd_lod_extension.operators.lods.deviation import measure_levels
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.characters import stored_groups
from mathutils import Matrix
from mathutils.bvhtree import BVHTree

from ..support.objects import collection

pytestmark = pytest.mark.usefixtures("rough_lods")


def make_lods(scene):
    assert list(make_levels(scene))[-1] == 1.0
    return scene.crowd_lod.levels


def digest(collection):
    """All that a LOD run must leave alone in the characters."""
    return {
        item.name: (
            item.data.name,
            item.parent and item.parent.name,
            [(m.name, m.type) for m in item.modifiers],
            [g.name for g in item.vertex_groups],
            np.array(item.matrix_world).tobytes(),
            mesh_data.read_mesh(item.data).points.tobytes() if item.type == "MESH" else None,
            [c.name for c in item.users_collection],
        )
        for item in collection.all_objects
    }


def test_levels_are_there_and_the_characters_untouched(scene):
    people = scene.crowd_lod.characters
    people.children.unlink(people.children["child"])
    before = digest(scene.crowd_lod.characters)
    blocks = set(bpy.data.user_map())
    levels = make_lods(scene)
    assert digest(scene.crowd_lod.characters) == before
    assert [len(level.children) for level in levels.children] == [1, 1, 1]
    for group in scene.crowd_lod.groups:
        full, middle, low = group.triangles[:3]
        assert middle == pytest.approx(0.4 * full, rel=0.05) and low == pytest.approx(
            0.12 * full, rel=0.05
        )
    assert scene.view_layers[0].layer_collection.children[levels.name].exclude
    kinds = {type(b).__name__ for b in set(bpy.data.user_map()) - blocks}
    assert kinds == {"Collection", "Object", "Mesh"}  # no scratch scene, image or text is left


def test_levels_carry_materials_uvs_and_weights_and_follow_the_armature(levelled):
    scene = levelled
    levels = scene.crowd_lod.levels
    groups = stored_groups.groups_of(scene.crowd_lod)
    scene.frame_set(8)
    levels_seen = [c.name for c in levels.children]
    scene.view_layers[0].layer_collection.children[levels.name].exclude = False
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for k, name in enumerate(levels_seen):
        for group, home in zip(groups, bpy.data.collections[name].children, strict=True):
            item = home.objects[0] if home.objects[0].type == "MESH" else home.objects[1]
            finest = next(
                o
                for o in levels.children[0]
                .children[levels.children[k].children.find(home.name)]
                .all_objects
                if o.type == "MESH"
            )
            mesh = item.data
            assert [m.name for m in mesh.materials] == [m.name for m in finest.data.materials]
            used = np.empty(len(mesh.polygons), np.int32)
            mesh.polygons.foreach_get("material_index", used)
            assert set(used) == {0, 1}
            uvs = np.empty((len(mesh.loops), 2), np.float32)
            mesh.uv_layers.active.uv.foreach_get("vector", uvs.ravel())
            assert uvs.min() >= -0.01 and uvs.max() <= 1.01 and np.ptp(uvs, axis=0).min() > 0.3
            weights = [sum(g.weight for g in v.groups) for v in mesh.vertices]
            assert np.allclose(weights, 1, atol=1e-4)
            assert [g.name for g in item.vertex_groups] == [g.name for g in finest.vertex_groups]
            # in the pose of frame 8 the LOD lies on the full mesh in the same pose
            fine, coarse = (
                mesh_data.world_points(o.evaluated_get(depsgraph)) for o in (finest, item)
            )
            triangles = mesh_data.read_mesh(finest.evaluated_get(depsgraph).to_mesh()).triangles
            tree = BVHTree.FromPolygons(fine.tolist(), triangles.tolist())
            off = max(tree.find_nearest(p)[3] for p in coarse.tolist())
            assert off <= group.bounds[k] + 1e-6
            assert off < 0.03 or k == 2  # of some 86 triangles


@pytest.mark.once
def test_a_second_run_replaces_the_first_and_spares_what_the_user_put_there(levelled):
    scene = levelled
    levels = scene.crowd_lod.levels
    mine = bpy.data.objects.new("Mine", None)
    levels.children[1].objects.link(mine)
    names = sorted(o.name for o in levels.all_objects if o is not mine)
    counts = len(bpy.data.meshes), len(bpy.data.collections)
    again = make_lods(scene)
    assert sorted(o.name for o in again.all_objects) == names
    assert (len(bpy.data.meshes), len(bpy.data.collections)) == counts
    assert [c.name for c in mine.users_collection] == [scene.collection.name]


def test_esc_leaves_nothing(scene):
    before = set(bpy.data.user_map())
    steps = make_levels(scene)
    assert any(set(bpy.data.user_map()) - before for _ in steps)
    steps.close()
    assert set(bpy.data.user_map()) == before and scene.crowd_lod.levels is None


@pytest.mark.once
def test_an_error_half_way_keeps_the_levels_that_were_there(levelled):
    scene = levelled
    levels = scene.crowd_lod.levels
    before = set(bpy.data.user_map())
    scene.crowd_lod.ratios[1] = 0.05
    scene.crowd_lod.ratios[2] = 0.05
    with pytest.raises(CrowdError, match="ratio of LOD 2"):
        list(make_levels(scene))
    assert set(bpy.data.user_map()) == before and scene.crowd_lod.levels == levels


@pytest.mark.once
def test_making_levels_measures_them_and_the_user_s_edits_are_measured_again(levelled):
    scene = levelled
    for group in stored_groups.groups_of(scene.crowd_lod):
        assert group.deviations[0] == 0 < group.deviations[1] < group.deviations[2] < 0.4
        assert 0 < group.rms[2] < group.deviations[2] and 1 < group.diagonal < 3
    before = [g.deviations for g in stored_groups.groups_of(scene.crowd_lod)]
    mesh = next(
        o for o in scene.crowd_lod.levels.children[2].children[0].objects if o.type == "MESH"
    ).data
    mesh.transform(Matrix.Translation((0, 0, 0.5)))
    list(measure_levels(scene))
    after = [g.deviations for g in stored_groups.groups_of(scene.crowd_lod)]
    assert after[1] == before[1] and after[0][:2] == before[0][:2] and after[0][2] > 0.4
    bpy.ops.crowd_lod.populate()  # keeps what is known of the LODs
    assert [g.deviations for g in stored_groups.groups_of(scene.crowd_lod)] == after
    for item in list(scene.crowd_lod.levels.children[1].children[0].objects):
        bpy.data.objects.remove(item)
    with pytest.raises(
        CrowdError, match="adult has no LOD meshes in Crowd LOD 1: press Make LOD Meshes again"
    ):
        list(measure_levels(scene))


def test_a_character_of_objects_with_modifiers_ngons_and_loose_vertices(scene):
    top = collection("Robots")
    robot = collection("robot", within=top)
    body = bpy.data.meshes.new("body")
    ring = [
        (np.cos(a), np.sin(a), z)
        for z in (0, 1)
        for a in np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ]
    sides = [(i, (i + 1) % 12, 12 + (i + 1) % 12, 12 + i) for i in range(12)]
    body.from_pydata([*ring, (5, 5, 5)], [], [*sides, tuple(range(12))[::-1], tuple(range(12, 24))])
    for name, z in (("body", 0), ("head", 1)):
        item = bpy.data.objects.new(name, body)
        item.location.z = z
        robot.objects.link(item)
    bpy.data.objects["head"].modifiers.new("smooth", "SUBSURF").render_levels = 2
    bpy.data.objects["head"].modifiers["smooth"].levels = 2
    scene.crowd_lod.characters = top
    levels = make_lods(scene)
    sizes = [[len(o.data.polygons) for o in level.all_objects] for level in levels.children]
    assert [len(s) for s in sizes] == [2, 2, 2]
    group = scene.crowd_lod.groups[0]
    assert group.triangles[0] > 12 * 2 + 10 * 2  # the head counts as modified
    assert group.triangles[0] > group.triangles[1] > group.triangles[2] >= 8
    assert not any(m.type == "SUBSURF" for o in levels.children[1].all_objects for m in o.modifiers)
