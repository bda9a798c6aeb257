"""Work that takes long because a frame is far away or agents are fast: it goes on by steps, and Esc
ends it between them.
"""

import time
from types import SimpleNamespace

import bpy
import pytest
from crowd_lod_extension.crowd_lod.progress import TimeLeft, Workload, unsure
from crowd_lod_extension.operators.blender import scene_cache
from crowd_lod_extension.operators.build.bake import bake
from crowd_lod_extension.operators.build.buttons import prepared
from crowd_lod_extension.operators.cli import scene_files
from crowd_lod_extension.operators.deliver.accuracy.accuracy import measure
from crowd_lod_extension.operators.deliver.preview.preview import Preview, preview
from crowd_lod_extension.operators.deliver.proof.verify import Verify, verify
from crowd_lod_extension.operators.scene.populate import CROWDLOD_OT_populate
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of

FAR = 10**6
PATIENCE = 30.0  # seconds on a machine with much else to do; the way to FAR takes ten minutes
FAST = (
    '{"version": 1, "edge": "reflect", "labels": {"ground": {"color": "#808080"}},'
    ' "states": {"go": {"on": {"*": {"move": [400000, 3]}}}}}'
)


def previewed(scene, folder):
    return preview(scene, Preview([FAR], folder / "out", 160), [])


def verified(scene, folder):
    return verify(scene, Verify([FAR], folder / "out", 64), [])


def baked(scene, folder):
    return prepared(scene, lambda _: bake(scene, [FAR]))


def reported(scene, folder):
    scene.crowd_lod.frames = f"{FAR}"
    return measure(scene, folder / "out", is_quick=True)


def build(scene, folder):
    scene.frame_set(FAR)
    return baked(scene, folder)


WORKS = previewed, verified, baked, reported, build


@pytest.mark.parametrize("work", WORKS, ids=lambda work: work.__name__)
def test_a_frame_far_away_is_approached_by_steps_that_end_at_once(levelled, tmp_path, work):
    steps = work(levelled, tmp_path)
    before = set(bpy.data.user_map())
    levelled.crowd_lod.estimate = "known"
    scene_cache.forget()
    while not 1000 < trajectory_of(levelled).reached < FAR:
        next(steps)  # it is not on its way yet
    longest = 0.0
    for _ in range(10):
        begun = time.perf_counter()
        next(steps)
        longest = max(longest, time.perf_counter() - begun)
    levelled.crowd_lod.width = 99  # by the user, meanwhile
    begun = time.perf_counter()
    steps.close()
    assert max(longest, time.perf_counter() - begun) < PATIENCE
    assert set(bpy.data.user_map()) == before and list(tmp_path.iterdir()) == []
    assert work is reported or levelled.crowd_lod.estimate == "known"
    assert levelled.crowd_lod.width == 99


def test_populate_looks_ahead_by_steps(levelled):
    levelled.crowd_lod.count = 100_000
    levelled.crowd_lod.machine = bpy.data.texts.new("fast")
    levelled.crowd_lod.machine.from_string(FAST)
    steps = CROWDLOD_OT_populate.work(SimpleNamespace(report=print), levelled)
    told = [next(steps)]
    while told[-1] < 1 or len(told) < 2 or told[-2] < 1:
        told.append(next(steps))
    begun = time.perf_counter()
    steps.close()
    assert time.perf_counter() - begun < PATIENCE


def test_how_long_the_rest_takes():
    left = TimeLeft()
    assert left.words(0.0, 0) == left.words(0.05, 3) == ""  # too early to tell
    assert left.words(0.2, 12) == ""
    assert left.words(0.25, 15) == ", about 45 s left"
    assert left.words(0.5, 30) == ", about 30 s left"
    assert left.words(0.75, 46) == ", about 15 s left"


@pytest.mark.parametrize(("seconds", "words"), [(60, "3 min"), (36_000, "30 h")])
def test_long_times_are_told_in_minutes_and_hours(seconds, words):
    left = TimeLeft()
    left.words(0.0, 0)
    assert left.words(0.25, seconds) == f", about {words} left"


def test_a_time_left_that_the_progress_contradicts_is_not_said():
    left = TimeLeft()
    left.words(0.0, 0)
    assert left.words(0.5, 40) == ", about 40 s left"
    assert left.words(0.51, 60) == ""  # a whole of 80 or of 118 s


def test_what_takes_another_time_on_each_machine_tells_nothing_of_the_rest():
    left = TimeLeft()
    making = Workload(4)
    told = [*making.take(unsure(part for part in (0.0, 0.5)), 2)]
    assert told == [0.0, 0.25] and left.words(told[0], 0) == left.words(told[1], 100) == ""
    assert left.words(0.5, 200) == ""
    assert left.words(0.75, 210) == ", about 10 s left"


@pytest.mark.once
def test_a_pipe_gets_lines_and_no_more_than_one_in_ten_seconds(monkeypatch, capfd):
    def steps():
        yield from (0.1, 0.5, 0.9)
        return "made"

    assert scene_files.finish(steps(), "plan of plaza", quiet=False) == "made"
    assert capfd.readouterr().err == ""
    monkeypatch.setattr(scene_files, "LINE", 0.0)
    assert scene_files.finish(steps(), "plan of plaza", quiet=False) == "made"
    lines = ["plan of plaza: 10%", "plan of plaza: 50%", "plan of plaza: 90%"]
    assert capfd.readouterr().err.splitlines() == lines
    assert scene_files.finish(steps(), "plan of plaza", quiet=True) == "made"
    assert capfd.readouterr().err == ""
