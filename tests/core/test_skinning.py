"""Joint frames, skinning, stances, cross-fades and reasons, against sums written out and against
geometry.
"""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.animation.skinning import (
    SkinnedMesh,
    axes,
    closed,
    merge,
    pose,
    skin,
    strongest,
)
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.reasons import Reason, reasons
from crowd_lod_extension.crowd_lod.levels.assignment import Bias, LevelPolicy
from crowd_lod_extension.crowd_lod.world.height_map import HeightMap
from crowd_lod_extension.crowd_lod.world.maps import Area

from ..support.cameras import narrow
from ..support.crowds import crowd_at
from ..support.rotations import stance
from ..support.shots import chapter

RANDOM = np.random.default_rng(3)
TETRAHEDRON = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], np.float32)
OUTWARDS = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)], np.uint32)


def mesh(points, joints, weights):
    n = len(points)
    column = np.zeros(n, np.float32)
    whole = np.zeros((n, 3), np.float32)
    return SkinnedMesh(points, OUTWARDS, whole, joints, weights, whole[:, :2], whole, column, True)


def test_skinning_is_the_weighted_sum_of_two_mixed_frames():
    frames = RANDOM.normal(size=(5, 6, 3, 4)).astype(np.float32)
    joints, weights = strongest(RANDOM.random((4, 6)))
    one = mesh(TETRAHEDRON, joints, weights)
    for phase in (0.0, 0.1, 0.25, 0.6, 0.999):
        at = phase * 4
        k = min(int(at), 3)
        expected = np.zeros((4, 3))
        for v in range(4):
            for j, w in zip(joints[v], weights[v], strict=True):
                matrix = (1 - at + k) * frames[k, j].astype(float) + (at - k) * frames[k + 1, j]
                expected[v] += w * (matrix @ [*TETRAHEDRON[v], 1.0])
        found = skin(one, pose(frames, np.array([phase], np.float32)))[0]
        assert found == pytest.approx(expected, abs=1e-5)


def test_a_single_frame_is_held_and_the_cycle_ends_on_its_last():
    frames = RANDOM.normal(size=(3, 2, 3, 4)).astype(np.float32)
    ends = pose(
        frames, np.array([0.0, 0.5, np.nextafter(np.float32(1), np.float32(0))], np.float32)
    )
    assert ends == pytest.approx(frames, abs=1e-5)
    assert (pose(frames[:1], np.array([0.0, 0.7], np.float32)) == frames[0]).all()


def test_the_strongest_weights_stay_and_sum_to_one():
    weights = np.array([[0.1, 0.4, 0, 0.2, 0.3, 0.05], [0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 7]])
    columns, kept = strongest(weights)
    assert columns[0].tolist() == [1, 4, 3, 0] and kept[0] == pytest.approx([0.4, 0.3, 0.2, 0.1])
    assert (
        (kept[1] == 0).all()
        and columns[2].tolist() == [5, 0, 0, 0]
        and kept[2].tolist() == [1, 0, 0, 0]
    )
    assert strongest(np.empty((2, 0)))[1].shape == (2, 4)


def test_merged_meshes_keep_their_triangles():
    joints, weights = strongest(np.ones((4, 1)))
    parts = [mesh(TETRAHEDRON + shift, joints, weights) for shift in (0, 5, 9)]
    whole = merge(parts)
    corners = np.concatenate([part.points[part.triangles] for part in parts])
    assert (whole.points[whole.triangles] == corners).all() and whole.closed


def test_only_surfaces_without_border_that_face_outwards_are_closed():
    assert closed(TETRAHEDRON, OUTWARDS) and closed(TETRAHEDRON + 100, OUTWARDS)
    assert not closed(TETRAHEDRON, OUTWARDS[:3])
    assert not closed(TETRAHEDRON, OUTWARDS[:, ::-1])
    two = np.concatenate([TETRAHEDRON, TETRAHEDRON * 0.3 + 4])
    assert closed(two, np.concatenate([OUTWARDS, OUTWARDS + 4]))
    assert not closed(two, np.concatenate([OUTWARDS, OUTWARDS[:, ::-1] + 4]))


def test_agents_stand_square_on_the_slope():
    x = np.array([3.0, -2.0, 5.0])
    y = np.array([1.0, 4.0, -6.0])
    rows, columns = np.mgrid[:20, :20]
    heights = HeightMap((0.7 * columns - 0.4 * rows).astype(np.float32), Area(-10, -10, 10, 10))
    heading = np.array([0.3, 2.0, -1.2], np.float32)
    pitch, roll = heights.tilt(x, y, heading)
    turned = stance(heading, pitch, roll, 0.0)
    normal = np.array([-0.7, 0.4, 1.0]) / np.linalg.norm([-0.7, 0.4, 1.0])
    assert turned[:, :, 2] == pytest.approx(np.tile(normal, (3, 1)), abs=1e-5)
    ahead = turned[:, :2, 0]
    assert np.arctan2(ahead[:, 1], ahead[:, 0]) == pytest.approx(heading, abs=1e-5)
    level = stance(heading, 0 * pitch, 0 * roll, np.pi / 2)
    assert level[:, :, 1] == pytest.approx(
        np.stack([-np.cos(heading), -np.sin(heading), 0 * heading], 1), abs=1e-6
    )


@pytest.mark.parametrize("tilted", [0.0, 1.0])
def test_axes_are_those_of_the_stance(tilted):
    heading, pitch, roll = (RANDOM.uniform(-3, 3, (3, 40)) * ((1,), (tilted,), (tilted,))).astype(
        np.float32
    )
    turned = stance(heading, pitch, roll, -np.pi / 2)
    for axis, found in enumerate(axes(heading, pitch, roll, -np.pi / 2)):
        assert found.dtype == np.float32 and found == pytest.approx(turned[:, :, axis], abs=1e-6)


PLAIN = LevelPolicy((0.25, 0.5))


def planned(bias=None, policy=PLAIN):
    crowd = crowd_at([(0, 5, 0), (0, 25, 0), (0, 80, 0), (30, 10, 0), (0, -3, 0), (0, 8, 0)])
    groups = (Group("one", 0.9, 1.0, 0.0, 1.0),)
    walk = Walk(crowd, *chapter(Area(-100, -100, 100, 100)), groups, 1 / 24)
    return plan(walk, narrow(), policy, 1, (), bias)


def test_each_agent_has_its_reason():
    assert reasons(planned()).tolist() == [
        Reason.NEAR_ENOUGH,
        Reason.DISTANCE,
        Reason.FAR,
        Reason.BESIDE,
        Reason.NEAR,
        Reason.NEAR_ENOUGH,
    ]
    dark = Bias(np.zeros((2, 2)), Area(-100, -100, 100, 100))
    frame = planned(dark)
    assert frame.levels[5] == 2 and reasons(frame)[[0, 1, 5]].tolist() == [
        Reason.DETAIL_MAP,
        Reason.DISTANCE,
        Reason.DETAIL_MAP,
    ]


def test_who_lacks_finer_lods_is_told_so_and_who_asks_for_none_is_not():
    limited = replace(PLAIN, finest=(1,))
    frame = planned(None, limited)
    assert frame.levels[[0, 1, 5]].tolist() == [1, 2, 1]
    assert reasons(frame).tolist() == [
        Reason.LEFT_OUT,
        Reason.DISTANCE,
        Reason.FAR,
        Reason.BESIDE,
        Reason.NEAR,
        Reason.LEFT_OUT,
    ]
    frame = planned(None, replace(limited, thresholds=(0.15, 0.5)))  # LOD 1 begins at 6 m
    assert reasons(frame)[[0, 1, 5]].tolist() == [Reason.LEFT_OUT, Reason.DISTANCE, Reason.DISTANCE]
    dark = Bias(np.full((2, 2), 0.1), Area(-100, -100, 100, 100))
    frame = planned(dark, limited)  # 5 m counts as 15 m, and 8 m as 24 m
    assert frame.levels[[0, 5]].tolist() == [1, 2] and reasons(frame)[[0, 5]].tolist() == [
        Reason.DETAIL_MAP,
        Reason.DETAIL_MAP,
    ]
    old = frame.levels.copy()
    old[0] = 2
    frame = planned(None, limited)
    by_plan = replace(frame, known_levels=old, plan_row=old)
    assert reasons(by_plan)[0] == Reason.SHOT_PLAN
