"""Overrides of the shot plan: whom they mean, what the plan does with them, and what is said of
wrong ones.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.frame.planned import HIDDEN, LEVEL, PINNED
from crowd_lod_extension.crowd_lod.shot import plan_file
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd, trajectory_of
from crowd_lod_extension.operators.scene.shot_overrides import overrides_of
from crowd_lod_extension.operators.scene.shot_reference import frame_by_policy

from ..support.objects import lamp, placed
from ..support.overrides import FRAMES, add, cube, frame_at, inside, planned, seen_at
from ..support.scene_frames import frame_now


def chosen_agents(scene, frames=FRAMES):
    return [each.agents.tolist() for each in overrides_of(read_crowd(scene), frames)]


@pytest.mark.once
def test_the_plan_keeps_to_overrides_and_its_users_show_them(levelled, tmp_path):
    settings = levelled.crowd_lod
    (finer, hidden, *_) = seen_at(levelled, 2)
    (pinned, *_) = seen_at(levelled, 0)
    add(levelled, "Detail", agents=finer, type="NEVER_COARSER", level=1)
    add(levelled, "Pin", agents=pinned, type="ALWAYS", level=2, frames=(4, 6))
    add(levelled, "Gone", agents=hidden, type="HIDE", frames=(6, 9))
    levels, told = planned(levelled, tmp_path)
    assert (levels[:, finer] & LEVEL <= 1).all() and not (levels[:, finer] & PINNED).any()
    assert [f + 1 for f in range(12) if levels[f, pinned] & PINNED] == [4, 5, 6]
    assert [f + 1 for f in range(12) if levels[f, hidden] & HIDDEN] == [6, 7, 8, 9]
    assert not (np.delete(levels, [pinned, hidden], axis=1) & (PINNED | HIDDEN)).any()
    keys = "name", "type", "lod", "chosen", "agents", "first", "last"
    assert [tuple(each[key] for key in keys) for each in told["shot"]["overrides"]] == [
        ("Detail", "NEVER_COARSER", 1, f"agents {finer}", 1, None, None),
        ("Pin", "ALWAYS", 2, f"agents {pinned}", 1, 4, 6),
        ("Gone", "HIDE", None, f"agents {hidden}", 1, 6, 9),
    ]
    phases = plan_file.read(tmp_path / "plan" / "plan.npz").phases
    trajectory = trajectory_of(levelled)
    for number in FRAMES:
        frame = frame_at(levelled, number)
        crowd = phases.applied(trajectory.at(number), trajectory.gaits)
        assert (frame.crowd.phase_class == crowd.phase_class).all()
        assert frame.planned and frame.levels[finer] <= 1
        assert frame.levels[pinned] == (2 if 4 <= number <= 6 else 0)
        assert frame.visible[hidden] == (not 6 <= number <= 9)
    # they can be switched off, and planning again keeps the others
    settings.overrides["Pin"].use = False
    frame = frame_at(levelled, 5)
    assert not frame.planned and "for the overrides changed since it was made" in frame.unplanned
    levels, told = planned(levelled, tmp_path)
    assert not (levels & PINNED).any() and [each["name"] for each in told["shot"]["overrides"]] == [
        "Detail",
        "Gone",
    ]
    assert frame_at(levelled, 5).planned


def test_who_is_hidden_casts_no_shadow(levelled, tmp_path):
    from crowd_lod_extension.operators.blender import evaluation
    from crowd_lod_extension.operators.scene import lights

    lamp("SUN", turn=(1.2, 0, 0.4))
    with evaluation.step_frames(levelled) as at:
        moment = lights.read_moment(levelled, 3, at)
    plain = frame_by_policy(read_crowd(levelled), moment)
    add(levelled, agents=f"0-{levelled.crowd_lod.count - 1}", type="HIDE")
    planned(levelled, tmp_path)
    levelled.frame_set(3)
    frame = frame_now(levelled, bpy.context.evaluated_depsgraph_get(), around=moment.around)
    assert len(plain.buckets.order) > 0 == len(frame.buckets.order)
    assert len(frame.shadow.order) == len(frame.mirrored.order) == 0


def test_a_region_means_those_inside_its_box_when_it_begins(levelled):
    region = cube()
    add(levelled, select_by="REGION", region=region)
    add(levelled, select_by="REGION", region=region, frames=(8, 90))

    first, second, eighth = (inside(trajectory_of(levelled).at(time)) for time in (1, 2, 8))
    assert chosen_agents(levelled) == [first, eighth] and first != eighth
    assert chosen_agents(levelled, range(2, 7)) == [second, []]
    # turned by a quarter about its middle, its box is the other way round; flat, it counts at every
    # height
    region.rotation_euler.z = np.pi / 2
    region.scale.z = 1
    region.location.z = 40
    for vertex in region.data.vertices:
        vertex.co.z = 0
    bpy.context.view_layer.update()
    crowd = trajectory_of(levelled).at(1)
    assert chosen_agents(levelled)[0] == inside(crowd, (-2, -11), (6, 3))
    # an empty's box is as wide as it is drawn
    empty = placed("Empty", empty_display_size=6, location=(1, 2, 0))
    bpy.context.view_layer.update()
    levelled.crowd_lod.overrides[0].region = empty
    assert chosen_agents(levelled)[0] == inside(crowd, (-5, -4), (7, 8))


def test_a_region_that_moves_is_taken_where_it_is_when_the_override_begins(levelled):
    region = cube()
    for number, y in ((1, -4), (11, 6)):
        region.location.y = y
        region.keyframe_insert("location", index=1, frame=number)
    levelled.frame_set(1)
    add(levelled, select_by="REGION", region=region, frames=(11, 12))
    there = inside(trajectory_of(levelled).at(11), (-5, 2), (9, 10))
    assert chosen_agents(levelled) == [there] and levelled.frame_current == 1


@pytest.mark.parametrize("change", ["moved", "renumbered", "frames", "order"])
def test_the_plan_says_when_an_override_has_changed(levelled, tmp_path, change):
    region = cube((-20, -20, -1), (20, 20, 1))
    add(levelled, "A", agents="1", type="ALWAYS", level=1, all_frames=False)
    add(levelled, "B", select_by="REGION", region=region)
    planned(levelled, tmp_path)
    assert frame_at(levelled, 2).planned
    settings = levelled.crowd_lod
    settings.overrides["A"].name = "another name"
    assert frame_at(levelled, 2).planned
    if change == "moved":
        region.location.x += 1
    elif change == "renumbered":
        settings.overrides[0].agents = "2"
    elif change == "frames":
        settings.overrides[0].last_frame = 11
    else:
        settings.overrides.move(0, 1)
    bpy.context.view_layer.update()
    assert "for the overrides changed since" in frame_at(levelled, 2).unplanned


WRONG = [
    (dict(agents=""), "names no agents"),
    (dict(agents="300"), "names agent 300: the crowd has 300"),
    (dict(agents="9-3"), "write 3-9"),
    (dict(agents="1", level=3), "asks for LOD 3: the crowd has LODs 0 to 2"),
    (dict(agents="1", frames=(9, 3)), "runs backwards, from frame 9 to 3"),
    (dict(select_by="REGION"), "has no region"),
    (dict(select_by="REGION", region="far"), "none stand in its region far at frame 1"),
    (dict(select_by="REGION", region="bare"), "The region bare of the override Hero has no area"),
    (
        dict(select_by="REGION", region="shrunk"),
        "The region shrunk of the override Hero has no area",
    ),
]


@pytest.mark.parametrize(("settings", "says"), WRONG, ids=[says for _, says in WRONG])
def test_wrong_overrides_are_named_in_one_sentence_and_change_nothing(
    levelled, tmp_path, settings, says
):
    cube((500, 500, -1), (501, 501, 1), "far")
    cube((-20, -20, -1), (20, 20, 1), "shrunk").scale = (0, 0, 0)
    levelled.collection.objects.link(bpy.data.objects.new("bare", bpy.data.meshes.new("bare")))
    bpy.context.view_layer.update()
    region = settings.get("region")
    add(levelled, **settings | ({"region": bpy.data.objects[region]} if region else {}))
    levelled.crowd_lod.frames = "1:3"
    levelled.crowd_lod.output_folder = str(tmp_path)
    with pytest.raises(RuntimeError) as told:
        bpy.ops.crowd_lod.plan_shot()
    assert says in str(told.value) and "Hero" in str(told.value)
    assert not (tmp_path / "plan").exists() and not levelled.crowd_lod.shot_plan
    levelled.crowd_lod.overrides[0].use = False
    assert bpy.ops.crowd_lod.plan_shot() == {"FINISHED"}


def test_an_override_outside_of_the_plan_has_nobody(levelled):
    add(levelled, select_by="REGION", region=cube((500, 500, -1), (501, 501, 1)), frames=(90, 99))
    assert chosen_agents(levelled) == [[]]


def test_the_list_is_edited_by_its_buttons(levelled):
    settings = levelled.crowd_lod
    for operator in (bpy.ops.crowd_lod.remove_row, bpy.ops.crowd_lod.move_row):
        with pytest.raises(RuntimeError, match="There is no override"):
            operator(kind="overrides")
    bpy.ops.crowd_lod.add_row(kind="overrides")
    settings.agent = 17
    bpy.ops.crowd_lod.override_agent(type="NEVER_COARSER")
    bpy.ops.crowd_lod.add_row(kind="overrides")
    names = lambda: [each.name for each in settings.overrides]  # noqa: E731
    assert names() == ["Override", "Never Coarser 17", "Override"] and settings.override_index == 2
    assert settings.overrides[1].agents == "17" and settings.overrides[1].use
    settings.override_index = 1
    bpy.ops.crowd_lod.move_row(kind="overrides", by=-1)
    assert names()[0] == "Never Coarser 17" and settings.override_index == 0
    bpy.ops.crowd_lod.move_row(kind="overrides", by=-1)
    assert names()[0] == "Never Coarser 17"
    bpy.ops.crowd_lod.move_row(kind="overrides", by=1)
    bpy.ops.crowd_lod.remove_row(kind="overrides")
    assert names() == ["Override", "Override"] and settings.override_index == 0
