"""Overrides that change the crowd of a scene: every button, every user of the crowd, and what is
said of wrong ones.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.sources.changed import Overridden
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of

from ..support.built import instances
from ..support.freshness import changed_since_build
from ..support.overrides import add, cube, frame_at, inside, planned, press, seen_at
from ..support.scatter import scatter


def test_each_button_edits_the_picked_agent_and_its_entry_can_be_switched_off(levelled):
    settings = levelled.crowd_lod
    own = trajectory_of(levelled)
    before = own.at(7)
    press(levelled, 12, "NUDGE", "NUDGE", "GROUP", "HIDE", "ALWAYS")
    assert [entry.type for entry in settings.overrides] == ["NUDGE", "GROUP", "HIDE", "ALWAYS"]
    assert {entry.agents for entry in settings.overrides} == {"12"}
    crowd = trajectory_of(levelled).at(7)
    assert crowd.x[12] - before.x[12] == pytest.approx(1.0) and crowd.y[12] == before.y[12]
    assert crowd.group[12] == (before.group[12] + 1) % len(own.groups)
    assert not crowd.present[12] and crowd.there == len(crowd) - 1
    for entry in settings.overrides:
        entry.use = False
    assert trajectory_of(levelled) is own


def test_a_pin_and_a_hide_hold_without_a_shot_plan(levelled):
    (hidden, finer, *_) = seen_at(levelled, 2)
    (pinned, *_) = seen_at(levelled, 0)
    add(levelled, "Pin", agents=pinned, type="ALWAYS", level=2)
    add(levelled, "Detail", agents=finer, type="NEVER_COARSER", level=1)
    add(levelled, "Gone", agents=hidden, type="HIDE", frames=(6, 9))
    for number in (1, 5, 6, 9, 10):
        frame = frame_at(levelled, number)
        assert not frame.planned and not frame.unplanned
        assert frame.levels[pinned] == 2 and frame.levels[finer] <= 1
        assert frame.visible[hidden] == (not 6 <= number <= 9)
    levelled.crowd_lod.overrides["Gone"].all_frames = True
    assert not frame_at(levelled, 2).crowd.present[hidden]


def shown(scene):
    """(x, y, z, cos, sin of the heading, whether of the first group) of all instances."""
    first = trajectory_of(scene).groups[0].name
    return np.array(
        [
            (*matrix[:3, 3], *matrix[:2, 0], item.name.startswith(first))
            for _, item, matrix in instances(scene)
        ]
    )


@pytest.mark.parametrize("make", ["build", "bake"])
def test_the_build_shows_edited_agents_where_they_are_put(built, make, at_once):
    built.frame_start = 1
    built.frame_end = 3
    frame = frame_at(built, 2)
    moved, swapped, hidden = np.flatnonzero(
        frame.visible & (frame.crowd.group == frame.crowd.group.max())
    )[:3].tolist()
    crowd = frame.crowd
    add(built, "a", type="NUDGE", agents=moved, move=(0.25, 0.5, 1.5))
    add(built, "b", type="GROUP", agents=swapped, group_name=trajectory_of(built).groups[0].name)
    add(built, "c", type="HIDE", agents=hidden)
    getattr(bpy.ops.crowd_lod, make)()
    assert changed_since_build(built) == []
    built.frame_set(2)
    found = shown(built)

    def at(agent, away=(0, 0, 0)):
        place = np.array([crowd.x[agent], crowd.y[agent], crowd.z[agent]]) + away
        heading = crowd.heading[agent]
        row = np.array([*place, np.cos(heading), np.sin(heading)])
        return found[np.abs(found[:, :5] - row).max(axis=1) < 1e-4]

    assert len(at(moved, (0.25, 0.5, 1.5))) == 1 and len(at(moved)) == 0
    assert at(swapped)[:, 5].tolist() == [1] and at(moved, (0.25, 0.5, 1.5))[:, 5].tolist() == [0]
    assert len(at(hidden)) == 0
    assert len(found) == len(frame_at(built, 2).buckets.order)
    built.crowd_lod.overrides["a"].use = False
    assert changed_since_build(built) == ["the overrides"]


@pytest.mark.parametrize("frames", [(), (2, 3)])
def test_who_is_hidden_is_not_missed_by_the_proof(levelled, frames):
    from crowd_lod_extension.operators.deliver.proof.frame_proof import everyone_there

    (agent, *_) = seen_at(levelled, 1)
    add(levelled, type="HIDE", agents=agent, frames=frames)
    everyone = everyone_there(frame_at(levelled, 2))
    assert len(everyone) == levelled.crowd_lod.count - 1 and agent not in everyone


def test_edits_survive_populate_and_saving(levelled, tmp_path):
    press(levelled, 12, "NUDGE", "GROUP")
    press(levelled, 40, "HIDE")
    before = trajectory_of(levelled).at(9)
    bpy.ops.crowd_lod.populate()
    after = trajectory_of(levelled).at(9)
    for name, column in before.columns.items():
        assert np.array_equal(column, getattr(after, name)), name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "overridden.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "overridden.blend"))
    again = trajectory_of(bpy.context.scene).at(9)
    for name, column in before.columns.items():
        assert np.array_equal(column, getattr(again, name)), name


def test_the_plan_knows_of_edits_and_says_when_they_change(levelled, tmp_path):
    (agent, *_) = seen_at(levelled, 2)
    press(levelled, agent, "HIDE")
    press(levelled, agent + 1, "NUDGE")
    levels, told = planned(levelled, tmp_path)
    assert frame_at(levelled, 2).planned and not frame_at(levelled, 2).visible[agent]
    assert [each["type"] for each in told["shot"]["overrides"]] == ["HIDE"]
    levelled.crowd_lod.overrides[1].move[1] = 3
    assert "for the overrides changed since" in frame_at(levelled, 2).unplanned


def test_erasing_keeps_numbers_of_who_stands_in_the_box(levelled):
    own = trajectory_of(levelled)
    region = cube(name="Fountain")
    levelled.frame_set(6)
    bpy.context.view_layer.objects.active = region
    crowd = own.at(6)
    erased = inside(crowd)
    assert len(erased) > 20 and bpy.ops.crowd_lod.erase() == {"FINISHED"}
    gone = lambda: np.flatnonzero(~trajectory_of(levelled).at(1).present).tolist()  # noqa: E731
    assert gone() == erased
    region.location.x += 30
    assert gone() == erased
    # found anew, they are those where the region is now
    levelled.crowd_lod.overrides[0].select_by = "REGION"
    region.location.x -= 34
    bpy.context.view_layer.update()
    bpy.ops.crowd_lod.find_agents()
    assert gone() == inside(crowd, (-9, -8), (5, 0))


def test_who_is_nudged_is_found_where_he_walks_without_edits(levelled):
    own = trajectory_of(levelled).at(1)
    add(levelled, type="NUDGE", agents=f"0-{len(own) - 1}", move=(500, 0, 0))
    region = cube()
    add(levelled, type="HIDE", select_by="REGION", region=region)
    levelled.crowd_lod.override_index = 1
    levelled.frame_set(1)
    bpy.ops.crowd_lod.find_agents()
    hidden = np.flatnonzero(~trajectory_of(levelled).at(1).present)
    assert hidden.tolist() == inside(own)


WRONG = [
    (
        dict(type="NUDGE", agents="300", move=(1, 0, 0)),
        "The override Hero names agent 300: the crowd has 300",
    ),
    (dict(type="NUDGE", agents=""), "The override Hero names no agents"),
    (
        dict(type="GROUP", agents="3", group_name="nobody"),
        "The override Hero names the character group nobody",
    ),
    (
        dict(type="HIDE", agents="#7"),
        "The override Hero names #7: no agent has that number in its file or object",
    ),
    (
        dict(type="NUDGE", select_by="REGION"),
        "The override Hero has no agents yet: press Find Agents",
    ),
    (
        dict(type="NUDGE", agents="1", move=(float("nan"), 0, 0)),
        "The setting Nudge of Scene is nan",
    ),
    (
        dict(type="ALWAYS", agents="1", level=3),
        "The override Hero asks for LOD 3: the crowd has LODs 0 to 2",
    ),
]


@pytest.mark.parametrize(("settings", "says"), WRONG, ids=[says for _, says in WRONG])
def test_wrong_edits_are_told_in_one_sentence_and_the_crowd_still_works(
    levelled, tmp_path, settings, says
):
    before = frame_at(levelled, 4)
    add(levelled, "Good", type="NUDGE", agents="5", move=(0.25, 0, 0))
    add(levelled, **settings)
    frame = frame_at(levelled, 4)
    assert says in frame.unplanned and frame.unplanned.count("Hero") <= 1
    assert np.array_equal(frame.visible, before.visible)
    assert frame.crowd.x[5] == pytest.approx(before.crowd.x[5] + 0.25)
    levelled.crowd_lod.frames = "1:3"
    levelled.crowd_lod.output_folder = str(tmp_path)
    with pytest.raises(RuntimeError) as told:
        bpy.ops.crowd_lod.plan_shot()
    assert says in str(told.value)
    levelled.crowd_lod.overrides["Hero"].use = False
    assert not frame_at(levelled, 4).unplanned


def test_buttons_say_what_they_lack(levelled):
    settings = levelled.crowd_lod
    assert not bpy.ops.crowd_lod.find_agents.poll()
    with pytest.raises(RuntimeError, match="Pick an agent"):
        bpy.ops.crowd_lod.override_agent(type="HIDE")
    settings.agent = 300
    for press_, says in (
        (
            lambda: bpy.ops.crowd_lod.override_agent(type="HIDE"),
            "There is no agent 300: the crowd has 300",
        ),
        (bpy.ops.crowd_lod.erase, "No mesh or empty is active"),
    ):
        bpy.context.view_layer.objects.active = levelled.camera
        with pytest.raises(RuntimeError, match=says):
            press_()
    bpy.context.view_layer.objects.active = cube((500, 500, 0), (501, 501, 1), "far")
    with pytest.raises(RuntimeError, match="selects no agents: none stand in far"):
        bpy.ops.crowd_lod.erase()
    assert not len(settings.overrides)


def test_files_of_before_there_were_edits_mean_the_same(scene):
    """Blender stores a choice by its number."""
    known = scene.crowd_lod.overrides.add().bl_rna.properties
    stored = {
        name: {item.identifier: item.value for item in known[name].enum_items}
        for name in ("type", "select_by")
    }
    assert stored["type"] | {"NEVER_COARSER": 0, "ALWAYS": 1, "HIDE": 2} == stored["type"]
    assert stored["select_by"] == {"NUMBERS": 0, "REGION": 1}


def test_numbers_of_several_crowds_are_those_of_all_together(levelled):
    settings = levelled.crowd_lod
    bpy.ops.crowd_lod.add_row(kind="crowds")
    settings.crowds[1].count = 20
    own = trajectory_of(levelled).at(3)
    press(levelled, 305, "NUDGE", "GROUP")
    overridden = trajectory_of(levelled)
    assert isinstance(overridden, Overridden) and len(overridden.at(3)) == 320
    assert np.flatnonzero(overridden.at(3).x != own.x).tolist() == [305]
    assert np.flatnonzero(overridden.at(3).group != own.group).tolist() == [305]


def test_edits_follow_the_points_of_an_object_by_their_ids(levelled):
    ids = np.arange(60) * 7 + 100
    settings = levelled.crowd_lod
    item = scatter(attributes=[("id", "INT", ids)])
    settings.source = "POINTS"
    settings.points = item
    bpy.ops.crowd_lod.populate()
    before = trajectory_of(levelled)
    press(levelled, 5, "NUDGE", "GROUP")
    press(levelled, 9, "HIDE")
    assert [entry.agents for entry in settings.overrides] == ["#135", "#135", "#163"]
    levelled.frame_set(25)
    item.data.attributes["id"].data.foreach_set("value", ids[::-1].copy())
    item.data.update()
    bpy.context.view_layer.update()
    crowd = trajectory_of(levelled).start
    assert crowd.x[54] == pytest.approx(trajectory_of(levelled).base.start.x[54] + 0.5)
    assert crowd.group[54] != before.start.group[5] and np.flatnonzero(~crowd.present).tolist() == [
        50
    ]


def test_edits_follow_the_agents_of_a_file_that_grows(levelled, tmp_path):
    settings = levelled.crowd_lod
    path = tmp_path / "tracks.csv"

    def write_tracks(ids):
        rows = [
            f"{a},{frame},{a + frame * 0.05:.3f},{a * 0.5:.3f}"
            for a in ids
            for frame in range(1, 40)
        ]
        path.write_text("\n".join(["id,frame,x,y", *rows]))

    write_tracks(range(20, 30))
    settings.source = "FILE"
    settings.tracks_file = str(path)
    settings.tracks_rate = 24
    settings.tracks_unit = "M"
    bpy.ops.crowd_lod.populate()
    press(levelled, 4, "NUDGE")
    press(levelled, 5, "HIDE")
    assert [entry.agents for entry in settings.overrides] == ["#24", "#25"]
    write_tracks(range(3, 30))
    overridden = trajectory_of(levelled)
    crowd = overridden.at(9)
    own = overridden.base.at(9)
    assert len(crowd) == 27 and np.flatnonzero(crowd.x != own.x).tolist() == [21]
    assert overridden.ids[21] == 24 and np.flatnonzero(~crowd.present).tolist() == [22]
    # who is gone is told, the other is still overridden
    write_tracks(range(3, 25))
    frame = frame_at(levelled, 9)
    assert "names #25: no agent has that number in its file or object" in frame.unplanned
    assert frame.crowd.x[21] == pytest.approx(frame.trajectory.base.at(9).x[21] + 0.5)
