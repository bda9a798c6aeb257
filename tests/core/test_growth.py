"""Memory an agent, its peaks included."""

import gc
import tracemalloc
import weakref

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior import walk as walk_file
from crowd_lod_extension.crowd_lod.crowd import leave_outs
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.index_cache import blocks_at
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.world.height_map import HeightMap

from ..support.cameras import straight
from ..support.crowds import walker
from ..support.shots import AREA, raw, shot, walking

COUNT = 500_000


def peak(job) -> float:
    """Bytes an agent that the job took at most."""
    tracemalloc.start()
    job()
    taken = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return taken / COUNT


HILLS = HeightMap(np.random.default_rng(1).uniform(0, 5, (9, 9)).astype(np.float32), AREA)


@pytest.mark.once
@pytest.mark.parametrize(
    "groups, edge, heights",
    [(1, "clamp", None), (3, "clamp", None), (3, "wrap", None), (1, "clamp", HILLS)],
)
def test_state_blocks_and_results_stay_within_their_bytes(groups, edge, heights):
    trajectory = shot(walking(edge), groups=(walker(),) * groups, count=COUNT, heights=heights)
    assert sum(column.nbytes for column in trajectory.start.columns.values()) <= 51 * COUNT
    camera = straight(offset=(0, -30, 0))
    policy = LevelPolicy((0.3, 0.6))
    plan(trajectory, camera, policy, 63)
    trajectory.at(65)
    most = 16 if heights is None else 30  # with the heights of all agents
    assert peak(lambda: blocks_at(trajectory, 65)) <= most  # in a new order
    trajectory.at(81)
    assert peak(lambda: blocks_at(trajectory, 81)) <= most  # in the same order
    frames = []
    assert peak(lambda: frames.append(plan(trajectory, camera, policy, 81))) <= 16
    frame = frames[0]
    assert leave_outs.BLOCKS in frame.left_out and len(frame.buckets.order) > 0.3 * COUNT
    assert peak(lambda: (frame.visible, frame.levels)) <= 16
    assert np.count_nonzero(frame.visible) == len(frame.buckets.order)


@pytest.mark.once
def test_a_long_shot_keeps_few_crowds_and_stays_a_function_of_the_frame(in_blocks, monkeypatch):
    camera = straight(offset=(0, -30, 0))
    policy = LevelPolicy((0.3, 0.6))
    times = 700, 130, 500, 65, 64.5, 300, 129, 1, 499.25, 700
    free = shot(walking("wrap"), count=300)
    right = [raw(plan(free, camera, policy, time)) for time in times]
    monkeypatch.setattr(walk_file, "MOST_KEPT", 300 * 26 * 10)
    tight = shot(walking("wrap"), count=300)
    for time, expected in zip(times, right, strict=True):
        assert raw(plan(tight, camera, policy, time)) == expected
    assert count_kept(tight) <= 20 < 40 < count_kept(free)


def count_kept(trajectory) -> int:
    """Count the crowds that the trajectory keeps, in a shot of 700 frames."""
    crowds = [weakref.ref(trajectory.at(frame)) for frame in range(1, 701, trajectory.every)]
    gc.collect()
    return sum(crowd() is not None for crowd in crowds)
