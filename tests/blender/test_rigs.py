"""What the build's agents show, against the characters themselves as Blender evaluates them at the
agents' phases.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.agents import CLASSES
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import image_data, named_actions
from crowd_lod_extension.operators.blender.animation import action_range
from crowd_lod_extension.operators.blender.evaluation import as_rendered
from crowd_lod_extension.operators.build import render_setup, rigs, shelves
from crowd_lod_extension.operators.build.phase_characters import make_characters
from crowd_lod_extension.operators.build.shelves import RIGS, SHELF
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.scene_crowd import characters_of, read_crowd, trajectory_of

from ..support.built import bodies, off, standing
from ..support.rigs import itself
from ..support.scene_frames import frame_now


def worst(scene, frame, agents=4):
    """Meters by which LOD 0 of the first `agents` that the camera sees is off the character itself,
    at most.
    """
    trajectory = trajectory_of(scene)
    plan = frame_now(scene, bpy.context.evaluated_depsgraph_get())
    crowd = plan.crowd
    nearest_agents = plan.buckets[0][:agents]
    assert len(nearest_agents)
    shown = bodies(scene)
    farthest = 0.0
    for agent in nearest_agents:
        rate = trajectory.gaits.rates[crowd.group[agent], crowd.pace[agent]]
        seconds = frame * scene.render.fps_base / scene.render.fps
        phase = (crowd.phase_class[agent] / trajectory.gaits.classes + rate * seconds) % 1.0
        points = standing(scene, crowd, agent, itself(scene, crowd.group[agent], phase))
        farthest = max(farthest, off(points, shown))
    return farthest


def test_agents_show_the_character_at_their_phase(built):
    posed = built.crowd_lod.build[render_setup.POSED]
    assert list(posed) == [0, 0]  # rigs show both
    for time in (1, 7, 40.5, 200):
        built.frame_set(int(time), subframe=time % 1)
        assert worst(built, time) < 3e-4, time


def test_a_quick_swing_between_even_looks_gets_its_keys(scene):
    (_, objects, origin), *_ = characters_of(scene)
    rig = objects[0].parent
    first, last = action_range(objects)
    for frame, angle in ((10, 0.0), (11, 0.3), (12, 0.0)):  # the even looks are 6 frames apart
        rig.pose.bones["forearm.L"].rotation_mode = "XYZ"
        rig.pose.bones["forearm.L"].rotation_euler.x = angle
        rig.pose.bones["forearm.L"].keyframe_insert("rotation_euler", frame=frame)
    home = bpy.data.collections.new("home")
    home.instance_offset = origin
    home.objects.link(objects[0])
    with as_rendered(home.objects) as (stage, actors):
        act = named_actions.own_performance(objects)
        model, why = finished(
            rigs.make_model(rigs.Acting("adult", [home], stage, actors, 1.9), act, {})
        )
        (begin, end) = act.spans[0]
        off = 0.0
        played = rigs.perform(
            model, "trial", 1 / (end - begin), -begin / (end - begin), (begin, end)
        )
        copies = {item: rigs.dress(item, model, played, actor) for item, actor in actors.items()}
        for block in (*played.values(), *copies.values()):
            stage.collection.objects.link(block)
        for moment in np.linspace(first, last, 200):
            act.go_to(stage, moment)
            off = max(off, rigs.measure_copies(copies, actors, stage, np.array(origin)))
        bpy.data.batch_remove([*played.values(), *copies.values()])
    assert not why and off < 2e-4 * 1.9  # 1.5e-3 where only even looks are taken
    # as many as the swing needs are 417 everywhere
    ((_, action),) = model.rigs.values()
    curves = action.layers[0].strips[0].channelbags[0].fcurves
    assert max(len(curve.keyframe_points) for curve in curves) < 200


def test_rigs_play_before_the_first_frame_and_after_hours(built):
    built.crowd_lod.build = None  # without agents, whose 250,000 steps take a minute
    for time in (-400, 250_001):
        rigs = {
            o.name: o
            for o in bpy.data.objects
            if o.type == "ARMATURE" and o.animation_data and o.animation_data.nla_tracks
        }
        built.frame_set(time)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        trajectory = trajectory_of(built)
        assert len(rigs) == 2 * trajectory.gaits.classes * len(trajectory.gaits.distinct[0])
        for name, rig in rigs.items():
            strip = rig.animation_data.nla_tracks[0].strips[0]
            phase = strip.fcurves.find("strip_time").evaluate(time)
            number = int(name.split()[1])
            g, own = divmod(number, trajectory.gaits.classes)
            wanted = (
                own / trajectory.gaits.classes + trajectory.gaits.distinct[g][0] * time / 24
            ) % 1.0
            first, last = action_range(characters_of(built)[g][1])
            apart = ((phase - first) / (last - first) - wanted + 0.5) % 1 - 0.5
            assert abs(apart) < 2e-3, (name, time)
            assert rig.evaluated_get(depsgraph)


def test_poses_are_held_while_the_shutter_is_open(built):
    """Cycles blurs an instance by its matrices at several times: it must be the same one at them
    all.
    """
    built.render.use_motion_blur = True
    held = []
    for time in (10.75, 11.0, 11.25):
        built.frame_set(int(time), subframe=time % 1)
        mesh = built.crowd_lod.build.objects[0].data
        values = np.empty(len(mesh.vertices), np.int32)
        mesh.attributes["pose"].data.foreach_get("value", values)
        held.append(values.tobytes())
    assert held[0] == held[1] == held[2]


def test_rigs_share_the_meshes_of_the_lods(built):
    shown = {
        item.data
        for c in built.crowd_lod.build.children_recursive
        for item in c.objects
        if item.type == "MESH"
    }
    assert shown == {
        item.data for home in built.crowd_lod.levels.children_recursive for item in home.objects
    }


def test_a_bake_holds_what_its_frames_show_and_nothing_else(built):
    from crowd_lod_extension.operators.build.bake import bake

    whole = sum(
        len(c.children) for c in built.crowd_lod.build.children_recursive if c.get(SHELF, -1) >= 0
    )
    list(bake(built, [3, 4]))
    top = built.crowd_lod.build
    used = 0
    shelf_of = {c[SHELF]: c for c in top.children_recursive if c.get(SHELF, -1) >= 0}
    for level, shelf in shelf_of.items():
        shown = set()
        for points in shelves.points_of(top).values():
            if points[shelves.LEVEL] == level and "pose" in points.data.attributes:
                values = np.empty(len(points.data.vertices), np.int32)
                points.data.attributes["pose"].data.foreach_get("value", values)
                shown |= set(values.tolist())
        assert shown == set(range(len(shelf.children)))
        used += len(shown)
    assert 0 < used < whole
    built.frame_set(3)
    assert worst(built, 3) < 3e-4


def test_a_bake_of_frames_that_show_nobody_leaves_no_motion(built):
    from crowd_lod_extension.operators.build.bake import bake

    built.camera.animation_data_clear()
    built.camera.rotation_euler = (3.14, 0, 0)  # up
    list(bake(built, [3, 4]))
    library = [c for c in built.crowd_lod.build.children_recursive if RIGS in c]
    assert not any(c.objects for c in library) and not [
        a for a in bpy.data.actions if a.get(render_setup.OWNED)
    ]


def test_making_a_cast_leaves_nothing_when_it_is_stopped(levelled):
    before = set(bpy.data.user_map())
    for part in (0.0, 0.2, 0.5, 0.9):
        making = make_characters(read_crowd(levelled))
        assert any(progress >= part for progress in making)
        making.close()
        assert set(bpy.data.user_map()) == before


def test_a_window_may_be_drawn_while_rigs_are_made(levelled):
    """Animation editors look through the poses of all armatures, and crash where there is none."""
    for _ in make_characters(read_crowd(levelled)):
        armatures = [item for item in bpy.data.objects if item.type == "ARMATURE"]
        assert all(armature.pose for armature in armatures)
    assert len(armatures) > CLASSES


def test_another_frame_rate_asks_for_another_build(built, capfd):
    built.render.fps = 30
    built.frame_set(5)
    assert "press Build again" in capfd.readouterr().err
    assert not any(
        len(item.data.vertices) for item in shelves.points_of(built.crowd_lod.build).values()
    )


@pytest.mark.parametrize("engine", ["CYCLES", "BLENDER_WORKBENCH"])
def test_neighbors_are_drawn_in_different_poses(built, tmp_path, engine):
    """Two agents side by side, of one group: with the same phase their silhouettes are the same,
    with others not.
    """
    settings = built.crowd_lod
    settings.count = 2
    settings.size = (3, 3)
    settings.center = (0, 0, 0)
    settings.characters.children.unlink(settings.characters.children["child"])
    list(make_levels(built))
    list(render_setup.build(read_crowd(built)))
    built.camera.animation_data_clear()
    built.camera.data.type = "ORTHO"
    built.camera.data.ortho_scale = 6
    built.camera.location = (0, -10, 1)
    built.camera.rotation_euler = (np.pi / 2, 0, 0)
    built.render.engine = engine
    built.render.film_transparent = True
    built.render.resolution_x = 300
    built.render.resolution_y = 150
    built.render.image_settings.color_mode = "RGBA"
    built.cycles.samples = 1
    built.cycles.use_denoising = False
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
        alpha = image_data.load_pixels(tmp_path / f"{name}.png")[..., 3] > 127
        return alpha[:, :150], alpha[:, 150:]

    same = np.logical_xor(*silhouettes((5, 5), "same")).sum()
    left, right = silhouettes((5, 9), "apart")  # half a walk apart they would mirror each other
    assert (
        left.sum() > 1000
        and same < 0.02 * left.sum()
        and np.logical_xor(left, right).sum() > 0.15 * left.sum()
    )
