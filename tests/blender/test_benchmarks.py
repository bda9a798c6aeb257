"""The benchmarks' peers do the same work as the core.

`measure_stages` itself refuses a peer that finds other agents.
"""

import sys
from pathlib import Path

import bpy
import numpy as np
import pytest

from ..support.scene_frames import frame_now

pytestmark = pytest.mark.once
FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    import chapter_tests

    yield chapter_tests
    for name in (
        "bench",
        "chapter_tests",
        "peers",
        "loop",
        "walkers",
        "drawn",
        "jobs",
        "worth",
        "ways",
    ):
        sys.modules.pop(name, None)


@pytest.mark.parametrize("agents", [700, 45_000])
def test_peers_find_what_the_core_finds_and_leave_the_file_as_it_was(bench, agents):
    before = set(bpy.data.user_map())
    row = bench.measure_stages(agents, 2, 1)
    assert row["agents"] == agents and {
        "behavior",
        "core",
        "naive",
        "six_planes",
        "geometry_nodes",
    } <= set(row)
    assert ("c_loop" in row) == (bench.loop.library() is not None)
    assert set(bpy.data.user_map()) == before


def test_nodes_that_walk_find_what_the_core_finds_and_leave_the_file_as_it_was(bench):
    before = set(bpy.data.user_map())
    scene = bpy.context.window.scene
    row = bench.measure_whole_frame(700, 4, 1)
    assert row["agents"] == 700 and 0 < row["visible"] < 700
    assert set(bpy.data.user_map()) == before and bpy.context.window.scene == scene


def test_nodes_that_stand_still_are_noticed(bench, monkeypatch):
    monkeypatch.setattr(bench.walkers.Walkers, "prepare", lambda self, tree: None)
    with pytest.raises(AssertionError):
        bench.measure_whole_frame(20_000, 60, 1)


def test_a_peer_that_is_wrong_is_noticed(bench, monkeypatch):
    right = bench.peers.naive
    monkeypatch.setattr(bench.peers, "naive", lambda *a: right(*a)[::-1])
    with pytest.raises(AssertionError, match="naive"):
        bench.measure_stages(700, 1, 1)


def test_perspectives_see_nearly_all_and_nearly_none(bench):
    for which, least, most in (("A", 90, 100), ("B", 0, 10)):
        row = bench.measure_perspective(8192, which, 1, 1)
        assert least <= row["visible_percent"] <= most and row["visible_percent"] + row[
            "culled_percent"
        ] == pytest.approx(100)
        drawn = np.dot([row[f"lod{k}"] for k in range(3)], bench.SIZES)
        assert row["vertices_millions"] == pytest.approx(drawn / 1e6, abs=1e-3)
    assert all(row[f"lod{k}"] >= 0 for k in range(3))


def test_a_compiler_that_fails_is_as_none(bench, monkeypatch):
    monkeypatch.setenv("CC", sys.executable)
    assert bench.loop.library() is None


def test_the_c_loop_steps_as_the_core_within_cells(bench):
    if bench.loop.library() is None:
        pytest.skip("no C compiler")
    trajectory, _ = bench.crowd_of(5000, 1)
    stepper = bench.loop.Step(trajectory.start, trajectory.machine, trajectory.world, 1 / 24)
    stepper()
    after = trajectory.at(2)
    x, y, heading, state = stepper.columns
    cells = [np.stack(trajectory.world.cells(c.x, c.y)) for c in (trajectory.start, after)]
    stay = (cells[0] == cells[1]).all(axis=0)  # the core cuts the others' steps at the border
    edge = np.isin(
        trajectory.world.at(*[0.1 * np.sign(v) + v for v in (after.x, after.y)]), 0, invert=True
    )  # some turn back there
    assert (stay & ~edge).mean() > 0.8
    for mine, theirs, off in (
        (x, after.x, 1e-12),
        (y, after.y, 1e-12),
        (heading, after.heading, 0),
    ):
        assert np.allclose(mine[stay & ~edge], theirs[stay & ~edge], rtol=0, atol=off)
    assert (state == after.state)[stay & ~edge].all()


def agents_by_lod(scene):
    """Of each LOD the ids of the agents whose instances the depsgraph holds."""
    found = [set(), set(), set()]
    for each in bpy.context.evaluated_depsgraph_get().object_instances:
        if each.is_instance and each.object.type == "MESH":
            found[each.parent.original["crowd_lod_level"]].add(each.persistent_id[1])
    return found


@pytest.mark.skipif(bpy.app.version < (5, 0, 0), reason="bench --worth needs Blender 5")
@pytest.mark.parametrize("way", ["everyone", "camera cull", "geometry nodes"])
def test_a_way_to_render_shows_whom_it_says_and_its_cost_is_measured(bench, built, tmp_path, way):
    import jobs
    import ways

    number = ways.FRAMES[-1]  # at which the nodes are aimed
    built.frame_set(number)
    frame = frame_now(built, bpy.context.evaluated_depsgraph_get())
    ways.dress_scene(built, way)
    built.frame_set(number)
    found = agents_by_lod(built)
    if way == "geometry nodes":
        assert (
            len(set(np.flatnonzero(frame.visible)) - set.union(*found)) <= 2
        )  # whom the plan's margin keeps, and nodes do not
        assert sum(map(len, found)) <= frame.visible.sum() + 12
        for level in range(3):
            assert (
                len(found[level] & set(frame.buckets[level].tolist()))
                >= 0.95 * frame.buckets.counts[level]
                > 0
            )
    else:
        assert list(map(len, found)) == [len(frame.crowd), 0, 0]
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "way.blend"))
    picture = tmp_path / "way.exr"
    asked = {
        "job": "render",
        "picture": str(picture),
        "engine": "CYCLES",
        "frame": number,
        "width": 32,
        "samples": 1,
    }
    row = jobs.job(120, file=str(tmp_path / "way.blend"), **asked)
    assert 0 < row["export_s"] <= row["render_s"] and row["cpu_s"] > 0 and row["peak_mb"] > 100
    assert picture.exists()


def test_a_render_that_fails_or_takes_too_long_says_so(bench, tmp_path):
    import jobs

    assert (
        "exit status 1"
        in jobs.job(
            60,
            job="render",
            file=str(tmp_path / "no.blend"),
            picture="",
            engine="CYCLES",
            frame=1,
            width=8,
            samples=1,
        )["ended"]
    )
    assert jobs.job(0.01, job="render")["ended"] == "not done in 0.01 s"


def test_goals_name_the_rows_that_miss_them(bench):
    import worth

    row = {
        "engine": "CYCLES",
        "crowd": worth.name_of(worth.FAR),
        "agents": 1000,
        "way": worth.BAKED,
    }
    good = {**row, "time": 0.5, "memory": 0.3, "file": 1.0}
    assert [goal["met"] for goal in worth.judged([good])] == ["met", "met"]
    assert [goal["missed"] for goal in worth.judged([good, {**good, "file": 1.1}])] == [
        f"file 1.1 (CYCLES, {row['crowd']}, 1,000 agents)",
        "",
    ]
    assert worth.judged([{**good, "way": "by distance", "file": 9.0}, {**good, "time": None}]) == []
