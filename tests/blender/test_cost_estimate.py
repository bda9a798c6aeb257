"""What a build is said to hold and to show is what Blender's depsgraph has.

What fits in memory is built, and nothing else.
"""

import json

import bpy
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender.mesh_data import count_triangles
from crowd_lod_extension.operators.build import bake, render_setup, shelves
from crowd_lod_extension.operators.build.cost_estimate import estimate
from crowd_lod_extension.operators.deliver.preview.preview import Preview, preview
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene import scene_crowd
from crowd_lod_extension.operators.scene.characters import group_measuring, stored_groups
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd
from crowd_lod_extension.operators.settings.stored_figures import FULL, BuildCase, costs_of

from ..support.built import instances
from ..support.scene_frames import frame_now

# long, and the same on every Blender
pytestmark = [pytest.mark.once, pytest.mark.usefixtures("rough_lods")]


def counts_in_render(scene):
    """(agents, their triangles, the triangles of the characters that they show, each once) of the
    evaluated scene.
    """
    found = [item.original for _, item, _ in instances(scene)]
    instanced, unique = (
        sum(count_triangles(item.data) for item in items) for items in (found, set(found))
    )
    return len(found), instanced, unique


@pytest.fixture
def posed_shape(saved_once, request):
    """The small crowd, whose first character has an animated shape key, which no rig shows."""

    def make():
        scene = request.getfixturevalue("levelled")
        item = next(item for item in scene.crowd_lod.characters.all_objects if item.type == "MESH")
        item.shape_key_add(name="Basis")
        item.shape_key_add(name="flat").keyframe_insert("value", frame=1)
        stored_groups.store_groups(scene.crowd_lod, group_measuring.measure_groups(scene))
        list(make_levels(scene))

    return saved_once("posed shape", make)


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("planned", [False, True])
@pytest.mark.parametrize("crowd", ["levelled", "posed_shape"])
def test_work_is_what_the_depsgraph_shows(request, known, planned, crowd):
    scene = request.getfixturevalue(crowd)
    frames = [3, 9, 14]
    if planned:
        scene.crowd_lod.frames = "3,9,14"
        bpy.ops.crowd_lod.plan_shot()
    found = finished(estimate(scene, frames, known=known))
    assert (
        list(found.looked_at) == frames
        and BuildCase(FULL, known) in found.works
        and found.costs.engine == "EEVEE"
    )
    work = found.works[BuildCase("BY_DISTANCE", known)]
    finished(bake.bake(scene, frames) if known else render_setup.build(read_crowd(scene)))
    top = scene.crowd_lod.build
    for f, number in enumerate(frames):
        scene.frame_set(number)
        agents, instanced, unique = counts_in_render(scene)
        assert (agents, instanced, unique) == (work.instances[f], work.instanced[f], work.unique[f])
    shown = [item for item in top.all_objects if item.type == "MESH" and shelves.LEVEL not in item]
    assert work.posed == sum(count_triangles(item.data) for item in shown)
    assert (work.builds, work.live) == (1, not known)
    assert work.rigs == sum(item.type == "ARMATURE" for item in top.all_objects)
    assert any(top[render_setup.POSED]) == (crowd == "posed_shape")
    whole = found.works[BuildCase(FULL, known)]
    assert (whole.instances == work.instances).all() and (whole.instanced > work.instanced).all()
    assert (
        found.prices[BuildCase(FULL, known)].memory > 0
        and "By Distance" in found.sentence
        and ("times such memory" in found.sentence) == (found.costs.engine == "CYCLES")
        and found.table.costs.keys() == found.works.keys()
    )


def test_what_shines_is_told_from_what_does_not(levelled):
    item = next(item for item in levelled.crowd_lod.characters.all_objects if item.type == "MESH")
    (shader,) = (
        node
        for node in item.material_slots[0].material.node_tree.nodes
        if node.type == "BSDF_PRINCIPLED"
    )
    works = []
    for strength in (0.0, 1.0):
        shader.inputs["Emission Color"].default_value = (1, 1, 1, 1)
        shader.inputs["Emission Strength"].default_value = strength
        works.append(finished(estimate(levelled, [3])).works[BuildCase(FULL)])
    dark, bright = works
    assert dark.emitting.sum() == 0 < bright.emitting.sum() <= bright.unique.sum()


def test_the_button_fills_the_table_and_asks_for_lod_meshes(levelled):
    settings = levelled.crowd_lod
    assert bpy.ops.crowd_lod.estimate() == {"FINISHED"}
    costs = costs_of(settings).costs
    assert [*costs] == [
        BuildCase(FULL),
        BuildCase("BY_DISTANCE"),
        BuildCase("BY_DISTANCE", True),
        BuildCase("BY_TOLERANCE"),
    ] and costs[BuildCase(FULL)].time == 1
    settings.tolerance = 2.0
    assert costs_of(settings) is None
    settings.estimate = "Full Detail\t1 GB"  # by a script
    assert costs_of(settings) is None
    settings.levels = None
    settings.groups.clear()
    stored_groups.store_groups(settings, group_measuring.measure_groups(levelled))
    with pytest.raises(
        RuntimeError, match="LOD meshes of Scene are not made: press Make LOD Meshes"
    ):
        bpy.ops.crowd_lod.estimate()


def least_memory(scene):
    """MB that the scene's memory is said to lack; what there is stays as it was."""
    before = set(bpy.data.user_map())
    groups = stored_groups.groups_of(scene.crowd_lod)
    with pytest.raises(CrowdError, match="The characters cannot take less than .* MB") as error:
        list(make_levels(scene))
    assert set(bpy.data.user_map()) == before
    assert stored_groups.groups_of(scene.crowd_lod) == groups
    return float(str(error.value).split(" MB")[0].rpartition(" ")[2])


def test_lods_that_fit_in_memory_are_built_and_the_others_are_not(scene, tmp_path):
    settings = scene.crowd_lod
    settings.choice = "BY_TOLERANCE"
    settings.tolerance = 0.2
    settings.frames = "1:20"
    stored_groups.store_groups(settings, group_measuring.measure_groups(scene))
    settings.memory = 1.0
    settings.memory = 1.1 * least_memory(scene)  # guesses told the least
    list(make_levels(scene))
    finest = scene_crowd.policy_of(settings).finest
    assert settings.memory_tolerance > 0.2 and max(finest) > 0
    built = finished(render_setup.build(read_crowd(scene)))
    assert "LODs deviate by up to" in render_setup.notes_on_built(read_crowd(scene), built)
    frame = frame_now(scene, bpy.context.evaluated_depsgraph_get())
    assert all(
        (frame.levels[frame.crowd.group == g] >= least).all() for g, least in enumerate(finest)
    )
    scene.frame_set(5)
    frame = frame_now(scene, bpy.context.evaluated_depsgraph_get())
    assert counts_in_render(scene)[0] == len(frame.buckets.order)  # nobody is lost
    inside = {
        item
        for item in settings.build.all_objects
        if item.type == "MESH" and shelves.LEVEL not in item
    }
    for g, (group, own) in enumerate(zip(settings.groups, finest, strict=True)):
        left_out = {
            item.data
            for level in settings.levels.children[:own]
            for item in level.children[g].objects
            if item.type == "MESH"
        }
        kept = {
            item.data
            for level in settings.levels.children[own:]
            for item in level.children[g].objects
            if item.type == "MESH"
        }
        assert kept <= {item.data for item in inside} and not (left_out - kept) & {
            item.data for item in inside
        }, group.name
    assert (
        finished(estimate(scene)).prices[BuildCase("BY_TOLERANCE")].memory
        <= 1e6 * settings.memory * 1.02
    )
    finished(preview(scene, Preview([5], tmp_path / "out", 64), []))
    plan = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert [told["finest_lod"] for told in plan["levels"]["characters"]] == list(finest)
    settings.memory = 1.0
    least_memory(scene)


def test_the_button_asks_what_build_asks_where_lods_are_missing(levelled):
    levelled.crowd_lod.level_count = 5
    with pytest.raises(
        RuntimeError, match="do not fit the settings .5 of 2.: press Make LOD Meshes"
    ):
        bpy.ops.crowd_lod.estimate()
    levelled.crowd_lod.level_count = 3
    level = levelled.crowd_lod.levels.children[1]
    level.children.unlink(level.children[0])
    with pytest.raises(RuntimeError, match="press Make LOD Meshes"):
        bpy.ops.crowd_lod.estimate()
