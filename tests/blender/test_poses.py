"""Each instance shows the pose of its own phase."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.poses import MOST
from crowd_lod_extension.crowd_lod.steps import finished
from crowd_lod_extension.operators import build as builder
from crowd_lod_extension.operators import scene as io
from crowd_lod_extension.operators.levels import make_levels
from crowd_lod_extension.operators.populate import action_range, characters_of, frame_of
from crowd_lod_extension.operators.poses import make_poses


def vertices(mesh):
    points = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    return points


def shown(scene):
    """(agent, LOD, world vertices) of each instance that the depsgraph holds."""
    for each in bpy.context.evaluated_depsgraph_get().object_instances:
        if each.is_instance and builder.LEVEL in each.parent.original and each.object.type == "MESH":
            matrix = np.array(each.matrix_world)
            points = vertices(each.object.data)
            yield each.persistent_id[1], each.parent.original[builder.LEVEL], points @ matrix[:3, :3].T + matrix[:3, 3]


def test_an_instance_stands_as_its_character_does_at_its_phase(built):
    """The oracle is the rig itself, at the agent's own phase: half a pose's time from what is shown, at most."""
    built.frame_set(9)
    crowd = frame_of(built, bpy.context.evaluated_depsgraph_get()).crowd
    points = [builder.points_of(built.crowd_lod.build)[f"LOD {k}"] for k in range(3)]
    ids = np.empty(len(points[0].data.vertices), np.int32)
    points[0].data.attributes["id"].data.foreach_get("value", ids)
    found = [(agent, where) for agent, level, where in shown(built) if level == 0]
    assert len(found) == len(ids) > 5
    characters = characters_of(built)
    lone = bpy.data.scenes.new("lone")
    for item in bpy.data.objects:
        if item.type == "ARMATURE" or item.name in ("adult", "child"):
            lone.collection.objects.link(item)
    apart = []
    for agent, where in found[:12]:
        assert agent in ids
        _, objects, origin = characters[crowd.group[agent]]
        first, last = action_range(objects)
        best = []
        for phase in (crowd.phase[agent], (crowd.phase[agent] + 0.5) % 1):
            time = first + (last - first) * phase
            lone.frame_set(int(time), subframe=float(time % 1))
            own = np.concatenate([io.world_points(o.evaluated_get(lone.view_layers[0].depsgraph)) for o in objects]) - origin
            c, s = np.cos(crowd.heading[agent]), np.sin(crowd.heading[agent])
            stands = own @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + (crowd.x[agent], crowd.y[agent], crowd.z[agent])
            best.append(np.abs(stands - where).max())
        assert best[0] < 0.05 < 0.1 < best[1]  # half a step of 64, and the other foot
        apart.append(crowd.phase[agent])
    assert np.ptp(apart) > 0.3  # neighbours are not in step


def test_poses_are_held_while_the_shutter_is_open(built):
    """Cycles blurs an instance by its matrices at several times: it must be the same one at them all."""
    built.render.use_motion_blur = True
    held = []
    for time in (10.75, 11.0, 11.25, 12.0):
        built.frame_set(int(time), subframe=time % 1)
        mesh = built.crowd_lod.build.objects[0].data
        values = np.empty(len(mesh.vertices), np.int32)
        mesh.attributes["pose"].data.foreach_get("value", values)
        held.append(values.tobytes())
    assert held[0] == held[1] == held[2] != held[3]


def test_posed_objects_keep_what_materials_need_and_share_what_does_not_deform(scene):
    top = bpy.data.collections.new("Props")
    scene.collection.children.link(top)
    scene.crowd_lod.characters = top
    bpy.ops.mesh.primitive_uv_sphere_add()
    ball = bpy.context.object
    ball.name = "ball"
    own, other = bpy.data.materials.new("own"), bpy.data.materials.new("other")
    ball.data.materials.append(own)
    ball.material_slots[0].link, ball.material_slots[0].material = "OBJECT", other
    ball.parent = bpy.data.objects.new("pivot", None)
    ball.parent.scale = (1, 3, 1)  # the ball turns under it: a shear
    ball.parent.location = (3, -2, 0.7)  # where a character stands in the scene is no matter
    for frame, turn in ((1, 0.0), (25, 3.0)):
        ball.rotation_euler.z = turn
        ball.keyframe_insert("rotation_euler", frame=frame)
    for home in ball.users_collection:
        home.objects.unlink(ball)
    top.objects.link(ball)
    bpy.ops.mesh.primitive_cube_add()
    box = bpy.context.object
    box.name = "box"
    for home in box.users_collection:
        home.objects.unlink(box)
    top.objects.link(box)
    from crowd_lod_extension.operators.populate import measure_groups, store_groups

    store_groups(scene.crowd_lod, measure_groups(scene))
    scene.crowd_lod.level_count = 1
    list(make_levels(scene))
    list(builder.build(scene))
    shelf = next(c for c in scene.crowd_lod.build.children_recursive if c.get(builder.LIBRARY) == 0)
    assert not any(any(pose.instance_offset) for pose in shelf.children)  # geometry nodes would not heed it
    poses = [item for pose in shelf.children for item in pose.objects]
    assert len(poses) == MOST + 1 and sum(item.name.startswith("box") for item in poses) == 1
    balls = [item for item in poses if item.name.startswith("ball")]
    assert all(item.material_slots[0].material == item.data.materials[0] == other for item in balls)
    assert ball.data.materials[0] == own
    assert all(item.data.uv_layers for item in balls) and all(item.parent is None and not item.modifiers for item in balls)
    for j in (0, 13, 40):
        scene.frame_set(1 + int(24 * j / MOST), subframe=24 * j / MOST % 1)
        wanted = io.world_points(ball.evaluated_get(bpy.context.evaluated_depsgraph_get())) - (
            3,
            -2,
            0.7 - 1,
        )  # it stands on its lowest point
        matrix = np.array(balls[j].matrix_basis)
        np.testing.assert_allclose(vertices(balls[j].data) @ matrix[:3, :3].T + matrix[:3, 3], wanted, atol=1e-5)


def test_a_text_is_posed_as_a_mesh_that_shows_as_it_does_and_hair_keeps_its_shape(scene):
    top = bpy.data.collections.new("Props")
    scene.collection.children.link(top)
    scene.crowd_lod.characters = top
    words = bpy.data.curves.new("words", "FONT")
    words.body, words.extrude = "Hi", 0.1
    sign = bpy.data.objects.new("sign", words)
    words.materials.append(bpy.data.materials.new("shared"))
    sign.material_slots[0].link, sign.material_slots[0].material = "OBJECT", bpy.data.materials.new("own")
    sign.visible_shadow, sign["looks"] = False, 3
    hair = bpy.data.objects.new("hair", bpy.data.hair_curves.new("hair"))
    hair.data.add_curves([4, 4])
    group = bpy.data.collections.new("someone")
    top.children.link(group)
    for item in (sign, hair):
        group.objects.link(item)
    for frame, x in ((1, 0.0), (25, 3.0)):
        sign.location.x = x
        sign.keyframe_insert("location", frame=frame)
    hair.parent = sign
    scene.crowd_lod.level_count = 2
    list(make_levels(scene))
    posed = finished(make_poses(scene))
    for k in range(2):
        signs, hairs = (
            [item for _, items in posed.collections[k] for item in items if kind in item.name] for kind in ("sign", "hair")
        )
        assert len(signs) == len(hairs) == posed.counts[0, k] > 8
        assert {item.type for item in signs} == {"MESH"} and {item.type for item in hairs} == {"CURVES"}
        assert all(
            item.material_slots[0].material.name == "own" and not item.visible_shadow and item["looks"] == 3 for item in signs
        )
        for items in (signs, hairs):
            x = [item.matrix_world.translation.x for item in items]
            assert x[0] == pytest.approx(0) and max(x) > 2.5


def test_a_group_that_stands_still_has_one_pose(scene):
    for rig in [o for o in scene.crowd_lod.characters.all_objects if o.type == "ARMATURE"]:
        rig.animation_data_clear()
    list(make_levels(scene))
    list(builder.build(scene))
    assert [list(item[builder.POSES]) for item in scene.crowd_lod.build.objects] == [[1, 1]] * 9
    meshes = {item.data for c in scene.crowd_lod.build.children_recursive for item in c.objects}
    assert len(meshes) == 6


def test_making_poses_leaves_nothing_when_it_is_stopped(levelled):
    before = set(bpy.data.user_map())
    for steps in (1, 30, 150):
        making = make_poses(levelled)
        for _ in range(steps):
            next(making)
        making.close()
        assert set(bpy.data.user_map()) == before


@pytest.mark.parametrize("engine", ["CYCLES", "BLENDER_WORKBENCH"])
def test_neighbours_are_drawn_in_different_poses(built, tmp_path, engine):
    """Two agents side by side, of one group: with the same phase their silhouettes are the same, with others not."""
    settings = built.crowd_lod
    settings.count, settings.size, settings.centre = 2, (3, 3), (0, 0, 0)
    settings.characters.children.unlink(settings.characters.children["child"])
    list(make_levels(built))
    list(builder.build(built))
    built.camera.animation_data_clear()
    built.camera.data.type, built.camera.data.ortho_scale = "ORTHO", 6
    built.camera.location, built.camera.rotation_euler = (0, -10, 1), (np.pi / 2, 0, 0)
    built.render.engine, built.render.film_transparent = engine, True
    built.render.resolution_x, built.render.resolution_y = 300, 150
    built.render.image_settings.color_mode = "RGBA"
    built.cycles.samples, built.cycles.use_denoising = 1, False
    built.frame_set(1)
    (points,) = [item.data for item in settings.build.objects if len(item.data.vertices)]

    def silhouettes(phases, name):
        """Of both agents, cut out of a picture where they stand 3 m apart, at these poses."""
        for vertex, x in zip(points.vertices, (-1.5, 1.5), strict=True):
            vertex.co = (x, 0, 0)
        points.attributes["heading"].data.foreach_set("value", np.zeros(2, np.float32))
        points.attributes["pose"].data.foreach_set("value", np.array(phases, np.int32))
        points.update_tag()
        settings.build = None  # else the render would write the points anew
        built.render.filepath = str(tmp_path / f"{name}.png")
        bpy.ops.render.render(write_still=True)
        alpha = io.load_pixels(tmp_path / f"{name}.png")[..., 3] > 127
        return alpha[:, :150], alpha[:, 150:]

    same = np.logical_xor(*silhouettes((5, 5), "same")).sum()
    left, right = silhouettes((5, 21), "apart")
    assert left.sum() > 1000 and same < 0.02 * left.sum() and np.logical_xor(left, right).sum() > 0.15 * left.sum()
