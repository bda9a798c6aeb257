"""Long ways to a frame: known by their progress, ended at any time, the same crowd in the end."""

import threading
import time

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.state_machine import parse
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.progress import finished, run_in_thread
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap

from ..support.shots import ONE, chapter, shot

AREA = Area(-50, -50, 50, 50)
FAR = 10**6  # frames, minutes away
PATIENCE = 30.0  # seconds on a machine with much else to do
FAST = """{"version": 1, "edge": "wrap", "labels": {"a": {"color": "#000000"}, "b": {"color": "#ffffff"}},
    "states": {"go": {"on": {"*": {"move": [1000000, 0]}}}}}"""


def trajectory(count=2000):
    return shot(*chapter(AREA), ONE, count, 1)


def fast():
    """Agents that enter a cell of another label 41,667 times in a step, which takes seconds."""
    world = LabelMap(np.arange(100, dtype=np.uint8)[None].repeat(2, 0) % 2, AREA)
    return shot(parse(FAST, "fast"), world, ONE, 1000, 1)


@pytest.mark.once
def test_the_crowd_is_the_same_and_then_known():
    straight = trajectory(count=500)
    slowly = trajectory(count=500)
    told = list(slowly.approach(2001))
    assert told == sorted(told) and 0 <= told[0] < told[-1] <= 1 and len(set(told)) > 3
    assert slowly.reached >= 2000 > straight.reached
    crowd = slowly.at(2001)
    for name, column in straight.at(2001).columns.items():
        assert np.array_equal(column, getattr(crowd, name)), name


@pytest.mark.parametrize("make, frame", [(trajectory, FAR), (fast, 3)])
def test_it_ends_at_any_time_and_leaves_the_crowd_as_it_was(make, frame):
    crowds = make()
    threads = threading.active_count()
    first = crowds.at(1).x
    steps = crowds.approach(frame)
    for _ in range(4):
        next(steps)
    begun = time.perf_counter()
    steps.close()
    assert time.perf_counter() - begun < PATIENCE and threading.active_count() == threads
    assert np.array_equal(crowds.at(1).x, first)


@pytest.mark.once
def test_others_have_their_turn_meanwhile_and_do_not_throw_it_back():
    crowds = trajectory()
    told = []
    waited = []
    steps = crowds.approach(FAR)
    for _ in range(20):
        told.append(next(steps))
        begun = time.perf_counter()
        crowds.at(7)
        waited.append(time.perf_counter() - begun)
    steps.close()
    assert max(waited) < PATIENCE
    assert told[-1] > told[4]  # it went on


def test_what_is_wrong_with_the_work_is_told_where_it_is_waited_for():
    def work():
        raise CrowdError("No way.")

    with pytest.raises(CrowdError, match="No way"):
        finished(run_in_thread(work))
