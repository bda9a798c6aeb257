"""The sample scenes: the same every time, complete, true to their maps, and alone in the file."""

import hashlib
from dataclasses import replace

import bpy
import numpy as np
import pytest
from crowd_lod_extension import sample_scenes
from crowd_lod_extension.crowd_lod.crowd import leave_outs
from crowd_lod_extension.crowd_lod.crowd.agents import Action
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.messages import from_json
from crowd_lod_extension.crowd_lod.output import tables
from crowd_lod_extension.operators.blender import cameras, image_data
from crowd_lod_extension.operators.blender.named_actions import find_action
from crowd_lod_extension.operators.plan import scene_json
from crowd_lod_extension.operators.scene import scene_crowd
from crowd_lod_extension.operators.scene.characters import group_measuring
from crowd_lod_extension.operators.scene.machine import scene_world
from crowd_lod_extension.sample_scenes import stand, station_plan
from mathutils.bvhtree import BVHTree

from ..support.crowds import walker
from ..support.objects import placed

FRAMES = (1, *range(10, 121, 10))


def make_scene(name):
    scene = bpy.data.scenes.new(name)
    sample_scenes.make(name, scene)
    return scene


@pytest.fixture
def made(saved_once):
    """(name) -> the sample scene in a file of its own; each is made once."""

    def opened(name):
        scene = saved_once(f"sample {name}", lambda: show(make_scene(name)))
        assert scene.name == name
        return scene

    return opened


def show(scene):
    bpy.context.window.scene = scene


def values(points, attribute, count):
    out = np.empty(len(points) * count, np.float32)
    points.foreach_get(attribute, out)
    return out.tobytes()


def keys(block):
    """Every keyframe of a data-block's action."""
    if block is None or block.animation_data is None or block.animation_data.action is None:
        return []
    bag = block.animation_data.action.layers[0].strips[0].channelbags[0]
    return [
        (
            curve.data_path,
            curve.array_index,
            *key.co,
            *key.handle_left,
            *key.handle_right,
            key.interpolation,
        )
        for curve in bag.fcurves
        for key in curve.keyframe_points
    ]


def digest(scene):
    """All that the scene is made of, but for names, which the file's other scenes may change."""
    out = hashlib.sha256()
    for item in scene.objects[:] + list(scene.crowd_lod.characters.all_objects):
        out.update(
            repr(
                (item.type, [tuple(row) for row in item.matrix_basis], keys(item), keys(item.data))
            ).encode()
        )
        if item.type == "MESH":
            out.update(values(item.data.vertices, "co", 3))
            out.update(
                repr([(tuple(p.vertices), p.material_index) for p in item.data.polygons]).encode()
            )
            out.update(
                repr([(tuple(m.diffuse_color), m.roughness) for m in item.data.materials]).encode()
            )
    for crowd in scene.crowd_lod.crowds:
        if crowd.source == "MACHINE":
            out.update(image_data.read_pixels(crowd.map_image).tobytes())
            out.update(crowd.machine.as_string().encode())
    for settings in (scene.crowd_lod, *scene.crowd_lod.crowds):
        for setting in settings.bl_rna.properties:
            if setting.type not in ("POINTER", "COLLECTION"):
                value = getattr(settings, setting.identifier)
                out.update(
                    repr(tuple(value) if getattr(setting, "is_array", False) else value).encode()
                )
    return out.hexdigest()


def frames_of(scene):
    """The plan at each of FRAMES."""
    trajectory = scene_crowd.trajectory_of(scene, group_measuring.measure_groups(scene))
    policy = scene_crowd.policy_of(scene.crowd_lod)
    for frame in FRAMES:
        scene.frame_set(frame)
        depsgraph = scene.view_layers[0].depsgraph
        yield plan(
            trajectory, cameras.camera_from(scene.camera, scene.render, depsgraph), policy, frame
        )


@pytest.mark.once
@pytest.mark.parametrize("name", sample_scenes.NAMES)
def test_two_makes_give_the_same_scene(name):
    first = make_scene(name)
    second = make_scene(name)
    assert digest(first) == digest(second)
    second.camera.location.x += 1e-3
    assert digest(first) != digest(second)


@pytest.mark.once
@pytest.mark.parametrize("name", ["chapter", "plaza"])
def test_everything_is_set_and_every_lod_is_populated(name, made):
    scene = made(name)
    settings = scene.crowd_lod
    assert settings.count == {"chapter": 4096, "plaza": 10_000}[name]
    assert settings.map_image.packed_file and scene.world and scene.camera
    assert (scene.render.fps, scene.frame_start, scene.frame_end) == (24, 1, 120)
    assert (scene.render.resolution_x, scene.render.resolution_y) == (960, 540)
    machine = scene_world.machine_of(settings)
    world = scene_world.world_of(settings, machine)  # fails on a color that is no label
    assert set(np.unique(world.labels)) == set(range(len(machine.labels)))
    groups = group_measuring.measure_groups(scene)
    assert [group.stride > 0 for group in groups] == [True] * 3
    # the characters themselves do not stand in the picture
    shown = {item.name for item in scene.view_layers[0].objects}
    assert shown and not shown & {item.name for item in settings.characters.all_objects}
    frames = [*frames_of(scene)]
    counts = np.array([frame.buckets.counts for frame in frames])
    least = {"chapter": counts.min(axis=0), "plaza": counts.max(axis=0)}[name]
    assert (least >= 100).all()
    share = [frame.visible.mean() for frame in frames]
    if name == "chapter":
        assert all(0.3 < part < 0.8 for part in share)
    else:  # nearly all and nearly none
        assert max(share) > 0.9 and min(share) < 0.05
        assert any(0.1 < part < 0.5 for part in share)


def test_the_chapters_auxiliary_camera_sees_all(made):
    scene = made("chapter")
    scene.camera = scene.objects["Auxiliary camera"]
    assert all(frame.visible.all() for frame in frames_of(scene))


def test_the_plaza_map_agrees_with_its_geometry(made):
    """Rays from above meet an obstacle in every wall and water cell, and in no other."""
    scene = made("plaza")
    obstacles = next(c for c in scene.collection.children if c.name.startswith("Obstacles"))
    trees = []
    for item in obstacles.objects:
        item.data.transform(item.matrix_basis)
        faces = [tuple(polygon.vertices) for polygon in item.data.polygons]
        trees.append(BVHTree.FromPolygons([vertex.co for vertex in item.data.vertices], faces))
    machine = scene_world.machine_of(scene.crowd_lod)
    world = scene_world.world_of(scene.crowd_lod, machine)
    solid = np.isin(world.labels, [machine.labels.index("wall"), machine.labels.index("water")])
    # every other cell of the plaza itself, and every ninth of the ring of houses about it
    rows, columns = np.indices(solid.shape)
    x = world.area.x_min + (columns + 0.5) * world.cell[0]
    y = world.area.y_min + (rows + 0.5) * world.cell[1]
    inner = np.maximum(abs(x), abs(y)) < 61
    wanted = (inner & ((rows + columns) % 2 == 0)) | ((rows % 3 == 0) & (columns % 3 == 0))
    hit = np.zeros_like(solid)
    for row, column in np.argwhere(wanted):
        origin = (x[row, column], y[row, column], 100.0)
        hit[row, column] = any(tree.ray_cast(origin, (0, 0, -1))[0] is not None for tree in trees)
    differ = np.argwhere(wanted & (hit != solid))
    assert len(differ) == 0, differ[:5]
    assert solid[wanted].sum() > 2000 and (~solid[wanted]).sum() > 10_000


@pytest.mark.once
def test_people_of_the_station_stand_on_its_floors_and_keep_out_of_what_is_in_the_way(made):
    """Rays from the knees down meet the floor under each foot."""
    scene = made("station")
    settings = scene.crowd_lod
    floors = scene.crowd_lod.terrain.objects
    trees = []
    for item in floors:
        faces = [tuple(polygon.vertices) for polygon in item.data.polygons]
        trees.append(BVHTree.FromPolygons([vertex.co for vertex in item.data.vertices], faces))
    trajectory = scene_crowd.trajectory_of(scene, group_measuring.measure_groups(scene))
    seen = set()
    for time in (1, 82.5, 240):
        crowd = trajectory.at(time)
        there = np.flatnonzero(crowd.present)
        for x, y, z in np.stack([crowd.x, crowd.y, crowd.z], axis=1)[there].tolist():
            ways = [tree.ray_cast((x, y, z + 0.4), (0, 0, -1))[0] for tree in trees]
            assert max(way.z for way in ways if way is not None) == pytest.approx(z, abs=1e-3), (
                time,
                x,
                y,
                z,
            )
            seen.add("above" if z > 4.4 else "stairs" if z > 0.1 else "below")
        walkers = there[there < len(trajectory.start) - settings.crowds[1].count]
        assert 200 < len(walkers) < 300
        x, y, z = (column[walkers] for column in (crowd.x, crowd.y, crowd.z))
        for x0, y0, x1, y1 in (station_plan.KIOSK, *station_plan.WAITING, *station_plan.COLUMNS):
            assert not ((x > x0) & (x < x1) & (y > y0) & (y < y1) & (z < 1)).any()
    assert seen == {"above", "stairs", "below"}
    assert (scene.render.fps, scene.frame_start, scene.frame_end) == (24, 1, 240)


@pytest.mark.once
def test_who_waits_in_the_station_plays_another_action_of_the_three_groups(made):
    scene = made("station")
    groups = group_measuring.measure_groups(scene)
    assert len(groups) == 3 and all(
        [action.name for action in group.actions] == ["idle"] for group in groups
    )
    trajectory = scene_crowd.trajectory_of(scene, groups)
    assert '"idle"' in tables.to_json(
        scene_json.crowd_json(scene_crowd.read_crowd(scene, groups=groups))
    )
    crowd = trajectory.at(50)
    assert set(crowd.group) == {0, 1, 2}
    waiting = slice(-scene.crowd_lod.crowds[1].count, None)
    assert not set(crowd.pace[waiting]) & set(crowd.pace[: waiting.start])


@pytest.mark.once
def test_the_audience_of_the_stand_sits_on_its_steps_faces_the_ball_and_is_planned_once_a_camera(
    made,
):
    scene = made("stand")
    groups = []  # measuring them would take ten seconds
    for item in scene.crowd_lod.characters.children:
        assert find_action(item.name, "cheer") and find_action(item.name, "sit")
        names = scene_world.actions_named(scene, item.name)
        actions = tuple(Action(name, 0.0, 1.0) for name in names)
        groups.append(replace(walker(stride=0.0), name=item.name, actions=actions))
    trajectory = scene_crowd.trajectory_of(scene, tuple(groups))
    start = trajectory.start
    assert len(start) == 3000 and trajectory.stays
    item = next(item for item in scene.objects if item.name.startswith("Stand"))
    faces = [tuple(polygon.vertices) for polygon in item.data.polygons]
    tree = BVHTree.FromPolygons([vertex.co for vertex in item.data.vertices], faces)
    # before the bench, where the feet are
    feet = np.stack([start.x, start.y], 1) * (1 - 0.4 / np.hypot(start.x, start.y))[:, None]
    for (x, y), z in zip(feet.tolist(), start.z.tolist(), strict=True):
        assert tree.ray_cast((x, y, z + 0.3), (0, 0, -1))[0].z == pytest.approx(z, abs=1e-5)
    ball = np.arctan2(stand.FOCUS[1] - start.y, stand.FOCUS[0] - start.x)
    assert np.allclose(np.exp(1j * start.heading), np.exp(1j * ball), atol=1e-6)

    policy = scene_crowd.policy_of(scene.crowd_lod)
    held = []
    for frame in (1, 2, 40, 41, 80, 81, 120):
        scene.frame_set(frame)
        view = cameras.camera_from(scene.camera, scene.render, scene.view_layers[0].depsgraph)
        held.append(leave_outs.STATIC in plan(trajectory, view, policy, frame).left_out)
    assert held == [False, True, True, False, True, False, True]
    crowd = trajectory.at(120)
    angle = np.arctan2(crowd.x, crowd.y)
    cheers = crowd.state == trajectory.machine.states.index("cheer")
    assert not cheers[angle > 0.9].any() and cheers[np.abs(angle) < 0.3].mean() > 0.5


@pytest.mark.once
def test_people_who_sit_on_benches_are_not_taken_for_sunk(made):
    scene = made("stand")
    scene.crowd_lod.count = 60
    bpy.ops.crowd_lod.populate()
    assert from_json(scene.crowd_lod.trouble) == ()


@pytest.mark.once
def test_other_scenes_stay_as_they_are():
    context = bpy.context
    mine = context.scene
    cube = placed("Cube", bpy.data.meshes.new("Cube"), mine.collection)
    cube.select_set(True)
    context.view_layer.objects.active = cube
    mine.frame_set(37)
    before = set(bpy.data.user_map())
    for name in sample_scenes.NAMES:
        scene = make_scene(name)
        belongs = set(scene.collection.children_recursive) | set(scene.objects) | {scene}
        belongs |= set(scene.crowd_lod.characters.all_objects)
        kinds = bpy.types.Object, bpy.types.Collection, bpy.types.Scene
        assert {
            block for block in bpy.data.user_map() if isinstance(block, kinds)
        } - before == belongs
        before |= set(bpy.data.user_map())
    assert context.scene == mine and mine.frame_current == 37
    assert (
        context.mode == "OBJECT" and context.view_layer.objects.active == cube and cube.select_get()
    )
    assert list(mine.objects) == [cube] and not mine.collection.children
    assert mine.crowd_lod.characters is None and mine.world is None and mine.camera is None
