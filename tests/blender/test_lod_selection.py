"""LODs by tolerance in a scene: as many as pay, of each character, and nothing of the others
left.
"""

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.messages import from_json
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender.mesh_data import count_triangles
from crowd_lod_extension.operators.build import render_setup
from crowd_lod_extension.operators.lods.candidates import CANDIDATE, MEASURED
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.lods.measurements import COLUMNS
from crowd_lod_extension.operators.scene import scene_crowd
from crowd_lod_extension.operators.scene.characters import stored_groups
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd
from mathutils import Vector

from ..support.objects import collection
from ..support.scene_frames import frame_now

pytestmark = pytest.mark.usefixtures("rough_lods")
MADE = "by tolerance"


@pytest.fixture
def tolerant(scene):
    """A crowd of adults and rocks, which stand still and have no armature."""
    people = scene.crowd_lod.characters
    people.children.unlink(people.children["child"])
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4)
    rock = bpy.context.object
    scene.collection.objects.unlink(rock)
    collection("rock", rock, within=people)
    scene.crowd_lod.choice = "BY_TOLERANCE"
    scene.crowd_lod.tolerance = 1.0
    scene.crowd_lod.frames = "1:20"
    return scene


@pytest.mark.once
def test_as_many_are_made_as_pay_and_the_build_shows_them(tolerant, saved_once):
    settings = tolerant.crowd_lod
    before = set(bpy.data.user_map())
    list(make_levels(tolerant))
    groups = stored_groups.groups_of(settings)
    count = stored_groups.count_of(settings)
    assert count == len(settings.levels.children) == max(len(set(g.triangles)) for g in groups) >= 2
    for g, group in enumerate(groups):
        own = len(set(group.triangles))
        assert (np.diff(group.triangles[:own]) < 0).all() and (
            np.diff(group.deviations[:own]) > 0
        ).all()
        assert set(group.triangles[own:]) <= {group.triangles[own - 1]}  # it repeats its last
        for k, level in enumerate(settings.levels.children):
            (item,) = (o for o in level.children[g].objects if o.type == "MESH")
            shown = min(k, own - 1)
            assert (
                item.name.endswith(f"LOD {shown}")
                and level.children[g].name == f"{g:03d} {group.name} LOD {shown}"
            )
            if k:
                assert count_triangles(item.data) == group.triangles[k]
    rock = groups[1]
    assert rock.triangles[0] == 20 * 4**3 and len(rock.triangles) >= 2 and set(rock.worst) == {1.0}
    assert {message.subject for message in from_json(settings.dropped)} <= {g.name for g in groups}
    new = set(bpy.data.user_map()) - before
    assert all(block.users for block in new)
    meshes = {b for b in new if isinstance(b, bpy.types.Mesh)}
    assert len(meshes) == sum(len(set(g.triangles)) - 1 for g in groups)
    list(render_setup.build(read_crowd(tolerant)))
    tolerant.frame_set(5)
    frame = frame_now(tolerant, bpy.context.evaluated_depsgraph_get())
    assert len(frame.buckets.counts) == count
    found = [
        o.instance_object.name
        for o in bpy.context.evaluated_depsgraph_get().object_instances
        if o.is_instance and o.object.type == "MESH"
    ]
    assert len(found) == len(frame.buckets.order)
    list(make_levels(tolerant))
    assert stored_groups.groups_of(settings) == groups
    saved_once(MADE, lambda: None)


@pytest.fixture
def made(saved_once, request):
    """That crowd with its LODs, as the test before saved it."""
    return saved_once(MADE, lambda: list(make_levels(request.getfixturevalue("tolerant"))))


@pytest.mark.once
def test_at_the_switch_distance_the_bound_spans_the_tolerance_in_blender_s_own_camera(made):
    settings = made.crowd_lod
    settings.tolerance = 2.0
    camera = made.camera
    render = made.render
    camera.location = (0, 0, 0)
    camera.rotation_euler = (0, 0, 0)
    for lens, width in ((35, 640), (120, 640), (35, 1920)):
        camera.data.lens = lens
        render.resolution_x = width
        render.resolution_y = width * 9 // 16
        bpy.context.view_layer.update()
        frame = frame_now(made, bpy.context.evaluated_depsgraph_get())
        for group, thresholds in zip(
            stored_groups.groups_of(settings), frame.thresholds, strict=True
        ):
            for meters, threshold in zip(
                group.bounds[1:], thresholds[np.isfinite(thresholds)], strict=False
            ):
                depth = -(threshold - group.radius)  # of the sphere's nearest point
                ends = [
                    world_to_camera_view(made, camera, Vector((x, 0, depth))) for x in (0, meters)
                ]
                assert (ends[1].x - ends[0].x) * width == pytest.approx(2.0, rel=1e-4)


@pytest.mark.once
def test_tolerance_reaches_the_frame_and_a_wrong_one_is_refused(made):
    settings = made.crowd_lod
    depsgraph = bpy.context.evaluated_depsgraph_get()
    one = frame_now(made, depsgraph)
    settings.tolerance = 4
    four = frame_now(made, depsgraph)
    assert (four.levels >= one.levels).all() and four.triangles < one.triangles
    assert (np.diff(one.thresholds, axis=1) >= 0).all()
    for wrong in (0, float("nan")):
        settings.tolerance = wrong
        with pytest.raises(CrowdError, match="tolerance"):
            frame_now(made, depsgraph)
    settings.choice = "BY_DISTANCE"
    assert scene_crowd.policy_of(settings).thresholds == (0.2, 0.5)


def test_a_tolerance_of_nothing_is_refused_before_anything_is_made(tolerant):
    tolerant.crowd_lod.tolerance = 0
    before = set(bpy.data.user_map())
    with pytest.raises(CrowdError, match="tolerance is 0"):
        list(make_levels(tolerant))
    tolerant.crowd_lod.tolerance = 1
    tolerant.camera = None
    with pytest.raises(CrowdError, match="no active camera"):
        list(make_levels(tolerant))
    assert set(bpy.data.user_map()) == before and tolerant.crowd_lod.levels is None


@pytest.mark.once
def test_a_lod_that_serves_a_longer_length_is_found_again(made):
    """As where the search for that length found none that saves enough."""
    levels = made.crowd_lod.levels.children
    finest, coarsest = (level.children[0] for level in (levels[0], levels[-1]))
    measured = finest[MEASURED].to_dict()
    row = measured[CANDIDATE].index(coarsest[CANDIDATE])
    coarsest[CANDIDATE] *= 0.9
    for name in COLUMNS:
        measured[name] = [*measured[name], measured[name][row]]
    measured[CANDIDATE] = [*measured[CANDIDATE], coarsest[CANDIDATE]]
    finest[MEASURED] = measured
    before = set(made.crowd_lod.levels.all_objects)
    outcome = finished(make_levels(made))
    assert outcome.new == () and set(made.crowd_lod.levels.all_objects) == before
