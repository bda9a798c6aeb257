from math import pi

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd import leave_outs
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators.blender.materials import switch_nodes_on
from crowd_lod_extension.operators.build import render_setup, shelves
from crowd_lod_extension.operators.build.bake import bake
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.characters.stored_groups import store_groups
from crowd_lod_extension.operators.scene.lights import read_surroundings
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd
from crowd_lod_extension.sample_scenes.scenery import add, box, material, tile

from ..support.objects import collection, ground, lamp, placed
from ..support.scene_frames import frame_now


@pytest.fixture
def lit(levelled):
    """The small crowd on a ground, in Cycles."""
    levelled.render.engine = "CYCLES"
    ground(-30, -40, 30, 50)
    return levelled


def read(scene, time=None):
    scene.view_layers[0].update()
    return read_surroundings(
        scene, scene.view_layers[0].depsgraph, scene.frame_current if time is None else time
    )


def test_lights_are_read_with_their_size_cone_and_range(lit):
    lamp("SUN", turn=(0, pi / 2, 0), angle=0.1)
    lamp("POINT", (1, 2, 3), shadow_soft_size=0.25).scale = (4, 1, 1)
    spot = lamp("SPOT", (0, 0, 9), spot_size=pi / 2, shadow_soft_size=0.5)
    lamp("AREA", (5, 0, 4), (pi, 0, 0), shape="RECTANGLE", size=3, size_y=4)
    spot.data.use_custom_distance = True
    spot.data.cutoff_distance = 12
    sun, point, cone, area = read(lit).lights
    assert sun.origin is None and sun.angle == pytest.approx(0.05)
    np.testing.assert_allclose(sun.direction, (-1, 0, 0), atol=1e-6)
    assert (*point.origin, point.size, point.angle) == pytest.approx((1, 2, 3, 1.0, pi))
    assert (
        cone.angle == pytest.approx(pi / 4) and cone.size == 0.5 and np.isinf(cone.reach)
    )  # Cycles has no range
    np.testing.assert_allclose(area.direction, (0, 0, 1), atol=1e-6)
    assert area.size == pytest.approx(2.5) and area.angle == pytest.approx(pi / 2)
    spot.scale = (2, 1, 1)  # the cone's slope doubles in one direction
    assert read(lit).lights[2].angle == pytest.approx(np.arctan(2))
    lit.render.engine = "BLENDER_EEVEE" if bpy.app.version >= (5, 0, 0) else "BLENDER_EEVEE_NEXT"
    assert read(lit).lights[2].reach == 12


def test_what_casts_no_shadow_is_no_light(lit):
    dark = lamp("SUN", energy=0)
    unshadowed = lamp("POINT", use_shadow=False)
    hidden = lamp("AREA")
    hidden.hide_render = True
    black = lamp("SPOT", color=(0, 0, 0))
    home = collection("Home")
    inside = lamp("POINT")
    lit.collection.objects.unlink(inside)
    home.objects.link(inside)
    home.hide_render = True
    assert read(lit).lights == () and leave_outs.NO_SHADOWS in read(lit).left_out
    home.hide_render = False
    lit.view_layers[0].layer_collection.children["Home"].exclude = True
    assert read(lit).lights == ()
    lit.view_layers[0].layer_collection.children["Home"].exclude = False
    dark.data.energy = 1
    unshadowed.data.use_shadow = True
    hidden.hide_render = False
    black.data.color = (1, 0, 0)
    assert len(read(lit).lights) == 5 and leave_outs.NO_SHADOWS not in read(lit).left_out
    nodes = switch_nodes_on(inside.data).nodes
    next(node for node in nodes if node.type == "EMISSION").inputs["Strength"].default_value = 0
    assert len(read(lit).lights) == 4


def test_objects_that_glow_and_lamps_in_instanced_collections_are_lights(lit):
    glow = material("Glow", (1, 1, 1))
    add(lit.collection, "Cube", [(box(4, 4, 6, 6, 0, 2), glow)])
    assert read(lit).lights == ()
    next(node for node in glow.node_tree.nodes if node.type == "BSDF_PRINCIPLED").inputs[
        "Emission Strength"
    ].default_value = 2
    (cube,) = read(lit).lights
    assert (*cube.origin, cube.size) == pytest.approx((5, 5, 1, 3**0.5))
    home = bpy.data.collections.new("Lamps")
    inside = lamp("POINT", (1, 0, 0))
    lit.collection.objects.unlink(inside)
    home.objects.link(inside)
    home.instance_offset = (0, 0, -2)
    for x in (10, 20):
        instancer = placed("Instancer", location=(x, 0, 0), rotation_euler=(0, 0, pi / 2))
        instancer.instance_type = "COLLECTION"
        instancer.instance_collection = home
    places = sorted(tuple(light.origin.round(5)) for light in read(lit).lights if light.size < 1)
    np.testing.assert_allclose(places, [(10, 1, 2), (20, 1, 2)], atol=1e-5)


def test_what_is_not_looked_at_is_named_with_its_reason(lit):
    lamp("SUN")
    assert read(lit).left_out == (leave_outs.NO_MIRRORS, leave_outs.NO_SKY)
    lit.crowd_lod.shadows = False
    assert (read(lit).left_out, read(lit).lights) == ((leave_outs.NOT_WANTED,), ())
    lit.crowd_lod.shadows = True
    lit.render.engine = "BLENDER_WORKBENCH"
    assert (read(lit).left_out, read(lit).lights) == ((leave_outs.WORKBENCH,), ())


def test_the_box_of_what_shadows_fall_on_leaves_out_lights_hidden_things_and_the_build(lit):
    store_groups(lit.crowd_lod, measure_groups(lit))
    lamp("POINT", (0, 0, 90))
    np.testing.assert_allclose(read(lit).box, [(-30, -40, 0), (30, 50, 0)], atol=1e-5)
    tower = add(lit.collection, "Tower", [(box(-1, -1, 1, 1, 0, 12), material("Stone", (1, 1, 1)))])
    tower.location.x = 40
    list(render_setup.build(read_crowd(lit)))
    lit.frame_set(5)
    np.testing.assert_allclose(read(lit).box, [(-30, -40, 0), (41, 50, 12)], atol=1e-5)
    tower.hide_render = True
    assert read(lit).box[1, 0] == pytest.approx(30)
    lit.objects["Ground"].modifiers.new("Anything", "NODES")  # it may make instances anywhere
    assert read(lit).box is None


def test_mirrors_are_the_flat_sides_of_the_marked_objects(lit):
    home = collection("Mirrors")
    two = (
        [(0, 0, 0), (2, 0, 0), (2, 0, 3), (0, 0, 3), (5, 0, 0), (5, 0, 3)],
        [(0, 1, 2, 3), (1, 4, 5, 2)],
    )
    pane = add(home, "Pane", [(two, material("Glass", (1, 1, 1)))])
    pane.location = (10, 0, 1)
    pane.rotation_euler.z = pi / 2
    lit.crowd_lod.mirrors = home
    (mirror,) = read(lit).mirrors
    np.testing.assert_allclose(np.abs(mirror.normal), (1, 0, 0), atol=1e-6)
    np.testing.assert_allclose(
        [mirror.corners.min(axis=0), mirror.corners.max(axis=0)],
        [(10, 0, 1), (10, 5, 4)],
        atol=1e-5,
    )
    add(home, "Block", [(box(0, 0, 1, 2, 0, 3), material("Steel", (1, 1, 1)))])
    assert len(read(lit).mirrors) == 7 and leave_outs.NO_MIRRORS not in read(lit).left_out
    bpy.ops.mesh.primitive_uv_sphere_add()
    ball = lit.objects[bpy.context.object.name]
    ball.name = "Ball"
    home.objects.link(ball)
    with pytest.raises(CrowdError, match="The mirror Ball has .* flat mesh"):
        read(lit)


def test_with_an_open_shutter_a_light_holds_itself_at_all_its_times(lit):
    sun = lamp("SUN", angle=0.02)
    point = lamp("POINT", (0, 0, 5), shadow_soft_size=0.5)
    for frame, turn, x in ((1, 0.0, 0.0), (11, 1.0, 20.0)):
        sun.rotation_euler.y = turn
        point.location.x = x
        sun.keyframe_insert("rotation_euler", frame=frame)
        point.keyframe_insert("location", frame=frame)
    lit.render.use_motion_blur = True
    lit.render.motion_blur_shutter = 1.0
    found = read(lit, 6.0)
    assert found.box is None
    wide_sun, wide_point = found.lights
    lit.render.use_motion_blur = False
    for time in (5.5, 5.75, 6.25, 6.5):
        lit.frame_set(int(time), subframe=time % 1)
        at_sun, at_point = read(lit).lights
        assert (
            np.arccos(at_sun.direction @ wide_sun.direction) + at_sun.angle <= wide_sun.angle + 1e-6
        )
        assert (
            np.linalg.norm(at_point.origin - wide_point.origin) + at_point.size
            <= wide_point.size + 1e-6
        )
    assert wide_sun.angle < 0.5 and wide_point.size < 4


def unseen(scene):
    """(positions as bytes, number) of the points of the build's objects that the camera does not
    see.
    """
    found = {}
    for bucket, item in shelves.points_of(scene.crowd_lod.build).items():
        assert item.visible_camera == (bucket.kind == "LOD") and item.visible_shadow
        if not item.visible_camera:
            values = np.empty((len(item.data.vertices), 3), np.float32)
            item.data.vertices.foreach_get("co", values.ravel())
            found[bucket] = values.tobytes()
    return found


@pytest.mark.once
@pytest.mark.parametrize("blur", [False, True])
def test_the_build_holds_them_apart_at_the_coarsest_lod_as_a_pure_function_of_the_frame(
    lit, blur, rendered
):
    sun = lamp("SUN", angle=0.05)
    for frame, turn in ((1, (0, 1.2, 0)), (40, (0, 1.2, 1.5))):
        sun.rotation_euler = turn
        sun.keyframe_insert("rotation_euler", frame=frame)
    lit.render.use_motion_blur = blur
    list(render_setup.build(read_crowd(lit)))
    first = {}
    for time in (30.0, 2.0, 11.25, 11.0, 10.75, 11.25, 2.0, 10.75, 30.0):
        lit.frame_set(int(time), subframe=time % 1)
        now = unseen(lit)
        assert first.setdefault(time, now) == now, time
    shown = [rendered(lit, number, unseen) for number in (11, 30, 11)]
    assert shown[0] == shown[2] and len(shown[0]) == (3 if blur else 1)
    found = shown[0][11]
    frame = frame_now(lit, bpy.context.evaluated_depsgraph_get(), around=read(lit))
    assert (
        len(found["Shadow", 2]) // 12 == len(frame.shadow.order) > 0
        and frame.shadow.counts[:2].sum() == 0
    )
    assert not found["Shadow", 0] and not found["Mirror", 2]
    lit.crowd_lod.shadows = False
    lit.frame_set(11)
    assert not any(unseen(lit).values())


@pytest.mark.once
@pytest.mark.parametrize("blur", [False, True])
def test_a_bake_keeps_for_their_shadows_whom_each_frame_keeps(lit, blur, rendered):
    """A sun that moves, and a wall that the shadows' way ends at."""
    sun = lamp("SUN", angle=0.05)
    wall = add(lit.collection, "Wall", [(tile(-30, 0, 30, 3), material("Wall", (0.5, 0.5, 0.5)))])
    for frame, turn, y in ((1, (0, 1.2, 0), 50), (40, (0, 1.2, 1.5), 10)):
        sun.rotation_euler = turn
        wall.location.y = y
        sun.keyframe_insert("rotation_euler", frame=frame)
        wall.keyframe_insert("location", frame=frame)
    lit.render.use_motion_blur = blur
    list(render_setup.build(read_crowd(lit)))

    def ids(mesh, name):
        values = np.empty(len(mesh.vertices), np.int32)
        mesh.attributes[name].data.foreach_get("value", values)
        return values

    def ids_of_points(scene):
        return {
            name: ids(item.data, "id").tolist()
            for name, item in shelves.points_of(scene.crowd_lod.build).items()
        }

    live = {}
    for number in (12, 3, 30):
        live |= {
            (number, name): kept
            for name, kept in rendered(lit, number, ids_of_points)[number].items()
        }
    list(bake(lit, [3, 12, 30]))
    for (number, name), kept in live.items():
        mesh = shelves.points_of(lit.crowd_lod.build)[name].data
        assert ids(mesh, "id")[ids(mesh, "frame") == number].tolist() == kept, (number, name)
    assert all(live[number, ("Shadow", 2)] for number in (3, 12))
