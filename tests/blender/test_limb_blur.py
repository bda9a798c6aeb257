"""Limbs are blurred as Cycles blurs the rig itself."""

import json

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.poses import played
from crowd_lod_extension.operators import build as builder
from crowd_lod_extension.operators import scene as io
from crowd_lod_extension.operators.bake import bake
from crowd_lod_extension.operators.follow import held_by
from crowd_lod_extension.operators.levels import make_levels
from crowd_lod_extension.operators.populate import action_range, measure_groups, store_groups, trajectory_of

from .characters import character, new, rig, skin, tube


@pytest.fixture
def bender(scene):
    """One agent that walks and bends forward, of a tube and of a box at the end of a bone, seen from its side."""
    scene.crowd_lod.characters.hide_viewport = True
    scene.crowd_lod.characters = None
    bpy.data.collections.remove(bpy.data.collections["People"])
    armature = rig()
    body = new("tube", tube("tube"))
    skin(body, armature)
    bpy.ops.mesh.primitive_cube_add(size=0.6)
    box = bpy.context.object
    bpy.context.scene.collection.objects.unlink(box)
    box.parent, box.parent_type, box.parent_bone, box.scale.x = armature, "BONE", "upper", 0.5
    group = character(armature, body, box)
    settings = scene.crowd_lod
    settings.characters.hide_render = True
    settings.forward, settings.count, settings.size, settings.level_count = "Y", 1, (30, 30), 1
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 4
    scene.camera.rotation_euler = (np.pi / 2, 0, 0)
    render = scene.render
    render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 32, False
    render.film_transparent, render.image_settings.color_mode = True, "RGBA"
    render.resolution_x = render.resolution_y = 200
    store_groups(settings, measure_groups(scene))
    list(make_levels(scene))
    return group


def picture(scene, path, number):
    """How much of each pixel the crowd covers, 0 to 255."""
    scene.frame_set(number)
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return io.load_pixels(path)[..., 3].astype(int)


def amid_the_action(scene, between):
    """(frame, phase): one in whose shutter the agent shows what is in the middle of the action, and that phase: a pose's, or
    one well between two poses."""
    trajectory, (poses,) = trajectory_of(scene), builder.points_of(scene.crowd_lod.build)["LOD 0"][builder.POSES]
    for number in range(10, 40):
        held = held_by(scene, trajectory, number, trajectory.at(io.remapped(scene.render, number)), ())
        at = float(played(*(crowd.phase for _, crowd in held.ends))[0][0]) * poses
        if 0.4 * poses < at < 0.6 * poses and (not between or abs(at - round(at)) > 0.3):
            return number, (at if between else round(at)) / poses


def curves(owner):
    return [c for layer in owner.animation_data.action.layers for s in layer.strips for bag in s.channelbags for c in bag.fcurves]


def live_again(scene, group, number, phase):
    """In place of the build the characters themselves, keyed to walk about the frame `number` as the agent does, and to play
    their action so that its `phase` falls in the middle of the shutter."""
    trajectory, now = trajectory_of(scene), io.remapped(scene.render, number)
    crowd = trajectory.at(now)
    (armature,) = [item for item in group.objects if item.type == "ARMATURE"]
    first, last = action_range(list(group.objects))
    render = scene.render
    off = {"START": 0.5, "CENTER": 0, "END": -0.5}[render.motion_blur_position] * render.motion_blur_shutter
    middle = io.remapped(render, number + off)
    for curve in curves(armature):
        for key in curve.keyframe_points:
            for point in (key.co, key.handle_left, key.handle_right):
                point.x += middle - first - (last - first) * phase
        curve.update()
    walker = bpy.data.objects.new("walker", None)
    scene.collection.objects.link(walker)
    walker.rotation_euler.z = crowd.heading[0] + io.rotation(scene.crowd_lod.forward)
    for when in (now - 2, now + 2):
        other = trajectory.at(when)
        walker.location = other.x[0], other.y[0], other.z[0]
        walker.keyframe_insert("location", frame=when)
    for curve in curves(walker):
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
    armature.parent = walker
    scene.crowd_lod.characters.hide_render = False
    builder.remove_build(scene.crowd_lod)


@pytest.mark.parametrize(
    "position, shutter, stretch, between",
    [
        ("CENTER", 0.8, 100, False),
        ("START", 0.9, 100, False),
        ("END", 0.9, 150, True),
    ],
)
def test_cycles_blurs_an_agent_as_it_blurs_the_rig_itself(bender, tmp_path, position, shutter, stretch, between):
    scene = bpy.context.scene
    render = scene.render
    render.use_motion_blur, render.motion_blur_position, render.motion_blur_shutter = True, position, shutter
    render.frame_map_new = stretch
    if between:  # so little is allowed that the nearest of the poses will not do
        scene.crowd_lod.choice, scene.crowd_lod.tolerance = "BY_TOLERANCE", 0.05
        list(make_levels(scene))
    list(builder.build(scene))
    number, phase = amid_the_action(scene, between)
    crowd = trajectory_of(scene).at(io.remapped(render, number))
    scene.camera.location = (crowd.x[0], crowd.y[0] - 10, 1)
    live = picture(scene, tmp_path / "live.png", number)
    assert between == ("blend" in builder.points_of(scene.crowd_lod.build)["LOD 0"].data.attributes)
    list(bake(scene, [number]))
    baked = picture(scene, tmp_path / "baked.png", number)
    for mesh in bpy.data.meshes:
        for name in {"velocity", "blend_rate"} & set(mesh.attributes.keys()):
            mesh.attributes.remove(mesh.attributes[name])
    stiff = picture(scene, tmp_path / "stiff.png", number)
    live_again(scene, bender, number, phase)
    real = picture(scene, tmp_path / "real.png", number)
    apart = lambda one: np.abs(one - real).mean()  # noqa: E731
    assert apart(live) < 0.2 * apart(stiff) and apart(stiff) > 0.2
    assert np.abs(baked - live).mean() < 0.02 * apart(stiff)


def test_limbs_are_blurred_as_fast_as_their_agent_walks_and_not_where_it_stands(bender):
    scene = bpy.context.scene
    settings = scene.crowd_lod
    bender["stride"], settings.count = 1.5, 40
    store_groups(settings, measure_groups(scene))
    speeds = {"stand": 0.0, "walk": 1.2, "run": 3.0}
    states = {state: {"start": 1, "on": {"*": {"speed": speed, "heading": 0}}} for state, speed in speeds.items()}
    settings.machine = bpy.data.texts.new("paces")
    settings.machine.from_string(json.dumps({"version": 1, "labels": {"ground": {"color": "#808080"}}, "states": states}))
    scene.camera.data.ortho_scale, scene.camera.location = 30, (0, -20, 1)
    assert not any("velocity" in mesh.attributes for mesh in bpy.data.meshes)
    list(builder.build(scene))
    assert not any("velocity" in mesh.attributes for mesh in bpy.data.meshes)
    scene.frame_set(2)
    plain = [len(item.data.vertices) for item in settings.build.objects]
    scene.render.use_motion_blur = True
    list(builder.build(scene))
    scene.frame_set(2)
    assert plain[0] == 40 and [len(item.data.vertices) for item in settings.build.objects] == plain
    state = trajectory_of(scene).at(2).state
    fastest = {"stand": set(), "walk": set(), "run": set()}
    for each in bpy.context.evaluated_depsgraph_get().object_instances:
        if not (each.is_instance and builder.LEVEL in each.parent.original and each.object.name.startswith("tube")):
            continue
        velocity = each.object.data.attributes.get("velocity")
        values = np.zeros(3, np.float32)
        if velocity is not None:
            values = np.empty(3 * len(velocity.data), np.float32)
            velocity.data.foreach_get("vector", values)
        fastest[list(speeds)[state[each.persistent_id[1]]]].add(float(np.linalg.norm(values.reshape(-1, 3), axis=1).max()))
    assert fastest["stand"] == {0.0} and len(fastest["walk"]) > 2 and len(fastest["run"]) > 2
    # a radian in a cycle, of 0.8 s at 1.25 cycles and of 2 a second, at most 1 m from the joint, eased in and out
    assert 0.3 < max(fastest["walk"]) < 2 and max(fastest["run"]) == pytest.approx(2.5 * max(fastest["walk"]), rel=0.3)
