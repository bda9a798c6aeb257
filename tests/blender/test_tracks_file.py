"""A crowd that follows a file: populated, planned, built and told as any other; bad files are
named.
"""

import os
from dataclasses import replace

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.sources.recorded import Recorded
from crowd_lod_extension.crowd_lod.tracks import reading
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of

from ..support.scene_frames import frame_at, frame_now
from ..support.tracks import wanderers

ROWS = replace(wanderers(80, z=False), rate=24.0)


@pytest.fixture
def followed(levelled, tmp_path):
    """The scene, saved, with its crowd following the file tracks.txt beside it."""
    order = np.lexsort((ROWS.frame, ROWS.id))
    rows = np.column_stack([ROWS.id, ROWS.frame, ROWS.x * 100, ROWS.y * 100])[order]
    np.savetxt(
        tmp_path / "tracks.txt",
        rows,
        "%d %d %.6f %.6f",
        header="framerate: 24 fps\nid frame x/cm y/cm",
    )
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    settings = levelled.crowd_lod
    settings.source = "FILE"
    settings.tracks_file = "//tracks.txt"
    return levelled


def test_populate_tells_of_the_file_and_the_plan_shows_who_is_there(followed, capfd):
    bpy.ops.crowd_lod.populate()
    said = capfd.readouterr().out
    assert (
        "80 agents in frames" in said
        and "at 24 a second, in cm" in said
        and "1 gap of more than 2 seconds hides the agent" in said
    )
    trajectory = trajectory_of(followed)
    assert isinstance(trajectory, Recorded) and trajectory_of(followed) is trajectory
    frame = frame_at(followed, bpy.context.evaluated_depsgraph_get(), 60)
    assert 0 < frame.crowd.there < 80 and not frame.visible[~frame.crowd.present].any()


def test_settings_of_the_source_count(followed):
    bpy.ops.crowd_lod.populate()
    settings = followed.crowd_lod
    before = trajectory_of(followed)
    settings.center = (1, 2, 3)
    moved = trajectory_of(followed)
    assert np.array_equal(moved.at(9).x, before.at(9).x + 1) and (moved.at(9).z == 3).all()
    settings.center = (0, 0, 0)
    settings.tracks_rate = 48
    assert np.allclose(trajectory_of(followed).at(9).x, before.at(17).x)
    settings.tracks_rate = 0
    settings.group_names = "child"
    assert {
        trajectory_of(followed).groups[g].name for g in trajectory_of(followed).start.group
    } == {"child"}
    settings.group_names = ""
    assert trajectory_of(followed).digests() == before.digests()


def test_a_file_that_changes_is_read_again(followed, tmp_path):
    bpy.ops.crowd_lod.populate()
    path = tmp_path / "tracks.txt"
    kept = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in kept if not line.startswith("3 ")))
    os.utime(path, (1, 1))
    assert len(trajectory_of(followed).start) == 79


def test_build_holds_who_is_there_and_follows_the_frames(followed):
    bpy.ops.crowd_lod.populate()
    bpy.ops.crowd_lod.make_levels()
    bpy.ops.crowd_lod.build()
    seen = set()
    for number in (20, 60, 120):
        followed.frame_set(number)
        frame = frame_now(followed, bpy.context.evaluated_depsgraph_get())
        shown = []
        for item in followed.crowd_lod.build.all_objects:
            if item.name.startswith("Crowd LOD") and item.name.endswith("points"):
                shown += [each.value for each in item.data.attributes["id"].data]
        assert sorted(shown) == sorted(frame.buckets.order.tolist())
        seen |= set(shown)
    assert seen


def test_the_files_groups_are_the_scenes(followed, tmp_path):
    named = np.where(ROWS.id % 2 == 0, "child", "adult")
    reading.write_npz(tmp_path / "named.npz", replace(ROWS, group=named))
    followed.crowd_lod.tracks_file = "//named.npz"
    bpy.ops.crowd_lod.populate()
    trajectory = trajectory_of(followed)
    names = [trajectory.groups[g].name for g in trajectory.start.group]
    assert names == ["child" if each % 2 == 0 else "adult" for each in trajectory.ids]


BAD = {
    "none chosen": ("", "none is chosen"),
    "missing": ("//gone.csv", "gone.csv cannot be read"),
    "a folder": ("//", "is a folder of 2 files"),
}


@pytest.mark.parametrize("fault", BAD)
def test_a_bad_file_is_one_sentence_and_the_scene_stays(followed, fault):
    bpy.ops.crowd_lod.populate()
    before = [group.name for group in followed.crowd_lod.groups]
    followed.crowd_lod.tracks_file, said = BAD[fault]
    with pytest.raises(RuntimeError, match=said):
        bpy.ops.crowd_lod.populate()
    with pytest.raises(CrowdError, match=said):
        trajectory_of(followed)
    assert [group.name for group in followed.crowd_lod.groups] == before
