import numpy as np
from crowd_lod_extension.crowd_lod.agents import populate
from crowd_lod_extension.crowd_lod.behaviour import Trajectory
from crowd_lod_extension.crowd_lod.frame import plan
from crowd_lod_extension.crowd_lod.levels import LevelPolicy
from crowd_lod_extension.crowd_lod.machine import load_preset
from crowd_lod_extension.crowd_lod.maps import Area, edge_map

from .crowds import walker
from .test_culling import straight


def shot():
    machine = load_preset("chapter")
    world = edge_map(Area(-40, 0, 40, 100), machine.labels)
    groups = (walker(), walker(sizes=(500, 50, 5)))
    return Trajectory(populate(3000, 2, 2, machine, world), machine, world, groups, 1 / 24)


def test_costs_are_those_of_the_agents_counted_one_by_one():
    trajectory = shot()
    frame = plan(trajectory, straight(), LevelPolicy((0.3, 0.6)), 40)
    seen = np.flatnonzero(frame.visible)
    assert 0 < len(seen) < 3000
    group, level = frame.crowd.group, frame.levels
    assert frame.vertices == sum(trajectory.groups[group[i]].vertices[level[i]] for i in seen)
    assert frame.full_triangles == sum(trajectory.groups[g].triangles[0] for g in group)
    assert set(frame.milliseconds) == {"behaviour", "culling", "levels", "sorting"}


def test_a_plan_does_not_depend_on_what_was_asked_before():
    warm = shot()
    for time in (90, 5, 33.5):
        plan(warm, straight(), LevelPolicy((0.3, 0.6)), time)
    a, b = (plan(t, straight(), LevelPolicy((0.3, 0.6)), 33.5) for t in (warm, shot()))
    assert a.buckets.order.tobytes() == b.buckets.order.tobytes() and a.crowd.x.tobytes() == b.crowd.x.tobytes()
