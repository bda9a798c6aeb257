"""Props that some agents of a group have: who has them, and that every step shows them."""

import bmesh
import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.animation.skinning import pose, skin
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.shot.shot_cost import work_in
from crowd_lod_extension.operators.blender import scene_cache, scene_data
from crowd_lod_extension.operators.blender.animation import action_range
from crowd_lod_extension.operators.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.characters.stored_groups import groups_of, store_groups
from crowd_lod_extension.operators.lod_meshes import deviation
from crowd_lod_extension.operators.lod_meshes.make_lods import make_levels
from crowd_lod_extension.operators.overlay import skinned_characters
from crowd_lod_extension.operators.render_setup import bake, render_setup
from crowd_lod_extension.operators.render_setup.cost_estimate import estimate
from crowd_lod_extension.operators.scene.scene_crowd import (
    characters_of,
    frame_of,
    policy_of,
    trajectory_of,
)
from crowd_lod_extension.operators.shot.shot_plan import PlanRequest, plan_shot, write_levels
from crowd_lod_extension.operators.sources import crowd_sources
from mathutils import Matrix

from ..support.scatter import scatter
from .test_points_source import crowd_of
from .test_rigs import instances, itself

KINDS = ["adult", "adult + hat", "adult + bag", "adult + bag + hat", "child"]


def ball(name, radius, at, bone, chance=None):
    """A ball of the adult on a bone of its rig, a prop if it has a chance."""
    mesh = bpy.data.meshes.new(name)
    made = bmesh.new()
    bmesh.ops.create_icosphere(made, subdivisions=2, radius=radius)
    made.to_mesh(mesh)
    made.free()
    item = bpy.data.objects.new(name, mesh)
    bpy.data.collections["adult"].objects.link(item)
    item.parent = bpy.data.objects["adult rig"]
    item.parent_type = "BONE"
    item.parent_bone = bone
    bpy.context.view_layer.update()
    item.matrix_world = Matrix.Translation(at)
    if chance is not None:
        item["prop"] = chance
    return item


def populated(scene):
    store_groups(scene.crowd_lod, measure_groups(scene))
    return trajectory_of(scene).start


@pytest.fixture
def dressed(scene):
    """Adults of whom some have a bag in the hand, and some a large hat that is higher than all
    else.
    """
    ball("bag", 0.15, (0, -0.35, 0.7), "hand.L", 0.3)
    ball("hat", 0.4, (0, 0, 1.8), "head", 0.6)
    return scene


@pytest.fixture
def ready(kept, request):
    """The same with LODs."""
    path = kept / "dressed.blend"
    if not path.exists():
        scene = request.getfixturevalue("dressed")
        scene.crowd_lod.level_count = 2
        populated(scene)
        list(make_levels(scene))
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    return bpy.context.scene


def test_props_are_drawn_by_the_seed_and_change_nothing_else(scene):
    scene.crowd_lod.count = 20_000
    plain = populated(scene)
    ball("bag", 0.15, (0, -0.35, 0.7), "hand.L", 0.3)
    ball("hat", 0.4, (0, 0, 1.8), "head", 0.6)
    start = populated(scene)
    assert [group.name for group in groups_of(scene.crowd_lod)] == KINDS
    for name, column in plain.columns.items():
        if name != "group":
            assert (column == start.columns[name]).all(), name
    assert ((plain.group == 0) == (start.group < 4)).all()
    counts = np.bincount(start.group, minlength=5)
    adults = np.count_nonzero(plain.group == 0)
    for count, part in zip(counts, (0.28, 0.42, 0.12, 0.18), strict=False):
        assert abs(count - adults * part) < 5 * np.sqrt(adults * part * (1 - part))
    assert (np.diff(start.group.astype(int)) >= 0).all()
    assert (populated(scene).group == start.group).all() and (
        trajectory_of(scene).at(40).group == start.group
    ).all()
    scene.crowd_lod.seed += 1
    assert (np.bincount(trajectory_of(scene).start.group) != counts).any()


def test_agents_of_points_keep_their_props_when_they_are_recorded(dressed):
    number = np.arange(60) % 2  # adult, child: variants do not count
    item = scatter(dressed, attributes=[("id", "INT", np.arange(60) * 7), ("group", "INT", number)])
    live = crowd_of(dressed, item)
    kinds = live.start.group
    assert ((kinds < 4) == (number == 0)).all() and set(kinds) == {0, 1, 2, 3, 4}
    dressed.frame_set(3)
    assert (trajectory_of(dressed).start.group == kinds).all()
    dressed.frame_start = 1
    dressed.frame_end = 4
    bpy.ops.crowd_lod.record_points()
    recorded = trajectory_of(dressed)
    assert recorded is not live and (recorded.start.group == kinds).all()
    del bpy.data.objects["bag"]["prop"], bpy.data.objects["hat"]["prop"]
    assert (populated(dressed).group == number).all()


def test_a_crowd_names_a_group_with_its_variants_or_a_variant_alone(dressed):
    start = populated(dressed)
    dressed.crowd_lod.group_names = "adult"
    adults = trajectory_of(dressed).start.group
    assert set(adults) == {0, 1, 2, 3}
    dressed.crowd_lod.group_names = "child, adult + hat"
    assert set(trajectory_of(dressed).start.group) == {1, 4}
    dressed.crowd_lod.group_names = ""
    assert (trajectory_of(dressed).start.group == start.group).all()
    own = dressed.crowd_lod.groups["adult"]
    own.own_thresholds = True
    own.scale = (0.5, 2)
    own.share = 0
    assert [bool(each) for each in policy_of(dressed.crowd_lod).group_thresholds] == [True] * 4 + [
        False
    ]
    assert [group.scale for group in groups_of(dressed.crowd_lod)] == [(0.5, 2)] * 4 + [(1, 1)]
    assert set(trajectory_of(dressed).start.group) == {4}


def test_the_sphere_of_a_variant_holds_its_props_and_no_other_does(dressed):
    populated(dressed)
    groups = groups_of(dressed.crowd_lod)
    for g, group in enumerate(groups):
        tops = []
        for phase in np.linspace(0, 1, 9):
            points = itself(dressed, g, phase)
            assert (
                np.linalg.norm(points - [0, 0, group.center], axis=1).max() <= group.radius + 1e-6
            )
            tops.append(points[:, 2].max())
        assert (max(tops) > 2) == ("hat" in group.name)
        assert (group.center + group.radius > 2) == ("hat" in group.name)
    assert len({(group.stride, group.period, group.lowest) for group in groups[:4]}) == 1


@pytest.mark.once
def test_build_bake_and_overlay_show_who_has_what(ready):
    scene = ready
    scene.crowd_lod.thresholds[:1] = (0.99,)  # all at LOD 0
    list(render_setup.build(scene))
    for baked in (False, True):
        if baked:
            finished(bake.bake(scene, [50]))
        rigs = [item for item in scene.crowd_lod.build.all_objects if item.type == "ARMATURE"]
        # of adults one for the body and one for what hangs on bones, whoever has that; of children
        # one
        assert len({item.data for item in rigs}) == 3 and (baked or len(rigs) == 3 * 16)
        scene.frame_set(50)
        trajectory = trajectory_of(scene)
        plan = frame_of(scene, bpy.context.evaluated_depsgraph_get())
        crowd = plan.crowd
        agents = plan.buckets.order
        shown = [points for level, points in instances(scene) if level == 0]
        groups = trajectory.groups
        objects = {g: len(objects) for g, (_, objects, _) in enumerate(characters_of(scene))}
        assert len(shown) == sum(objects[g] for g in crowd.group[agents])
        for g in range(5):
            agent = agents[crowd.group[agents] == g][0]
            rate = trajectory.gaits.rates[g, crowd.pace[agent]]
            phase = (crowd.phase_class[agent] / trajectory.gaits.classes + rate * 50 / 24) % 1.0
            angle = crowd.heading[agent] + scene_data.rotation(scene.crowd_lod.forward)
            c = np.cos(angle)
            s = np.sin(angle)
            whole = itself(scene, g, phase) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
            whole += [crowd.x[agent], crowd.y[agent], crowd.z[agent]]
            sizes = [
                len(item.data.vertices)
                for item in characters_of(scene)[g][1]
                if item.type == "MESH"
            ]
            for points in np.split(whole, np.cumsum(sizes)[:-1]):
                assert (
                    min(abs(other - points).max() for other in shown if other.shape == points.shape)
                    < 1e-4 * groups[g].diagonal
                )
    for g, (name, objects, _) in enumerate(characters_of(scene)[:4]):
        homes = [level.children[g] for level in scene.crowd_lod.levels.children]
        character = finished(skinned_characters.bake_character(name, lambda homes=homes: homes))
        assert character.off < 1e-4
        mesh = character.meshes[0]
        (first, last) = action_range(objects)
        points = skin(mesh, pose(character.frames, np.array([4 / (last - first)], np.float32)))[0]
        own = itself(scene, g, 4 / (last - first))
        np.testing.assert_allclose(
            [points.min(axis=0), points.max(axis=0)], [own.min(axis=0), own.max(axis=0)], atol=1e-4
        )


@pytest.mark.once
@pytest.mark.parametrize("sways", [False, True])
def test_rigs_are_estimated_and_planned_as_they_are_built(dressed, tmp_path, sways):
    scene = dressed
    if sways:  # a prop with a motion of its own, longer than the body's: its variants share no rigs
        bag = bpy.data.objects["bag"]
        bag.keyframe_insert("rotation_euler", frame=1)
        bag.rotation_euler.x += 0.5
        bag.keyframe_insert("rotation_euler", frame=90)
    scene.crowd_lod.level_count = 1
    scene.crowd_lod.thresholds[0] = 0.9
    populated(scene)
    list(make_levels(scene))
    found = finished(estimate(scene, scene.crowd_lod, [50])).works
    known = finished(estimate(scene, scene.crowd_lod, [50], known=True)).works["By Ratio"]
    plan = finished(plan_shot(scene, PlanRequest([50], tmp_path)))
    made = []
    for make in (lambda: list(render_setup.build(scene)), lambda: finished(bake.bake(scene, [50]))):
        make()
        made.append(sum(item.type == "ARMATURE" for item in scene.crowd_lod.build.all_objects))
    assert (
        made == [found["By Ratio"].rigs, known.rigs] and found["By Ratio, Baked"].rigs == known.rigs
    )
    assert (
        made[0] == (7 if sways else 3) * 16
    )  # body and what hangs on it of adults without and with a bag; of children one
    write_levels(tmp_path, plan)
    scene.crowd_lod.shot_plan = str(tmp_path / "plan.npz")
    finished(bake.bake(scene, [50]))
    planned = sum(item.type == "ARMATURE" for item in scene.crowd_lod.build.all_objects)
    assert planned == work_in(plan.shot, plan.plan.bill.agents_shown).rigs < known.rigs


def test_lods_of_a_variant_hold_its_props_and_their_deviation_is_told(ready):
    groups = groups_of(ready.crowd_lod)
    plain, _, bag, *_ = groups
    assert bag.triangles[0] == plain.triangles[0] + 80 and bag.triangles[1] > plain.triangles[1]
    name, objects, _ = characters_of(ready)[2]
    meshes = deviation.meshes_of(ready.crowd_lod.levels, 2, name)
    assert [item.name.startswith("bag") for item in meshes[1]].count(True) == 1
    with deviation.Posed(objects, meshes) as posed:
        body, levels = posed.at(5)
        assert body.distances(levels[1].points).max() <= bag.bounds[1] + 1e-6


def test_a_chance_of_one_or_none_makes_no_variant(scene):
    ball("bag", 0.15, (0, -0.35, 0.7), "hand.L", 1)
    hat = ball("hat", 0.4, (0, 0, 1.8), "head", 0.0)
    feather = ball("feather", 0.1, (0, 0, 2.2), "head")
    feather.parent = hat
    feather.parent_type = "OBJECT"
    assert [(name, sorted(item.name for item in objects if item.type == "MESH")) for name, objects, _ in characters_of(scene)] == [
        ("adult", ["adult", "bag"]), ("child", ["child"]),
    ]  # fmt: skip
    hat["prop"] = 0.5
    assert [name for name, _, _ in characters_of(scene)] == ["adult", "adult + hat", "child"]
    assert feather in characters_of(scene)[1][1] and feather not in characters_of(scene)[0][1]


def test_props_that_cannot_be_used_are_named(scene):
    bag = ball("bag", 0.15, (0, -0.35, 0.7), "hand.L", 1.5)
    with pytest.raises(
        CrowdError, match='"prop" of bag is 1.5, and must be numbers from 0 to 1: set the chance'
    ):
        characters_of(scene)
    bag["prop"] = "often"
    with pytest.raises(
        CrowdError, match="\"prop\" of bag is 'often', and must be numbers from 0 to 1"
    ):
        characters_of(scene)
    bag["prop"] = 0.5
    bag.data.clear_geometry()
    with pytest.raises(
        CrowdError,
        match="The prop bag of the character group adult has no mesh with faces: give it one",
    ):
        characters_of(scene)
    bag["prop"] = 0.0
    bpy.data.objects.remove(bag)
    bpy.data.objects["adult"]["prop"] = 0.5
    with pytest.raises(
        CrowdError, match="All meshes of the character group adult are props: leave it one"
    ):
        characters_of(scene)
    del bpy.data.objects["adult"]["prop"]
    for name in "abcd":
        ball(name, 0.1, (0, 0, 2), "head", 0.5)
    with pytest.raises(
        CrowdError, match=r"adult has 4 props \(a, b, c, d\), and 16 variants of it: use at most 3"
    ):
        characters_of(scene)


def test_mark_as_prop_marks_what_is_selected_or_nothing(scene):
    bag = ball("bag", 0.15, (0, -0.35, 0.7), "hand.L")
    with pytest.raises(RuntimeError, match="Select an object of a character group"):
        bpy.ops.crowd_lod.mark_as_prop()
    populated(scene)
    assert crowd_sources.outdated(scene) == []
    bpy.data.objects["adult"].select_set(True)
    bag.select_set(True)
    with pytest.raises(RuntimeError, match="All meshes of the character group adult are props"):
        bpy.ops.crowd_lod.mark_as_prop(chance=0.3)
    assert "prop" not in bag and "prop" not in bpy.data.objects["adult"]
    bpy.data.objects["adult"].select_set(False)
    bpy.ops.crowd_lod.mark_as_prop(chance=0.3)
    assert bag["prop"] == pytest.approx(0.3)
    scene_cache.forget()
    assert crowd_sources.outdated(scene) == [
        "The characters' props or slots have changed: press Populate."
    ]
    populated(scene)
    scene_cache.forget()
    assert crowd_sources.outdated(scene) == []


@pytest.mark.parametrize("name", ["plan_shot", "estimate", "build", "export_usd"])
def test_buttons_say_that_props_were_marked_since_populate(ready, name):
    del bpy.data.objects["bag"]["prop"]
    with pytest.raises(
        RuntimeError, match="props or slots have changed: press Populate, then Make LOD Meshes"
    ):
        getattr(bpy.ops.crowd_lod, name)()
