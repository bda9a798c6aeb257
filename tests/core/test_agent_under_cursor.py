"""The agent under the cursor against a plain loop over all, and what is told of an agent against
first principles.
"""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.culling.camera import Window
from crowd_lod_extension.crowd_lod.culling.radar import BLOCK
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.planned import HIDDEN, OVERRIDDEN, PINNED, with_row
from crowd_lod_extension.crowd_lod.frame.reasons import account, nearest
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.sorting.buckets import Buckets
from crowd_lod_extension.crowd_lod.world.maps import Area

from ..support.cameras import straight
from ..support.crowds import crowd_at
from ..support.shots import chapter

SIZE = 640, 480
NOBODY = Buckets(np.zeros(0, np.int32), np.zeros(4, np.intp))
# 90 degrees wide, clipped at 1 and 100 m, from the origin along -z
PERSPECTIVE = np.array(
    [[1.0, 0, 0, 0], [0, 4 / 3, 0, 0], [0, 0, -101 / 99, -200 / 99], [0, 0, -1, 0]]
)


def pixel(place, matrix=PERSPECTIVE):
    """Where the place is in the picture, or None if it is clipped."""
    x, y, z, w = matrix @ (*place, 1.0)
    return None if w <= 0 or abs(z) > w else ((x / w + 1) * SIZE[0] / 2, (y / w + 1) * SIZE[1] / 2)


@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_nearest_of_all(seed):
    random = np.random.default_rng(seed)
    places = random.uniform(-120, 120, (3, 2 * BLOCK + 77))
    cursor = random.uniform((0, 0), SIZE)
    away = np.full(places.shape[1], np.inf)
    for agent, place in enumerate(places.T):
        at = pixel(place)
        if at is not None:
            away[agent] = np.hypot(at[0] - cursor[0], at[1] - cursor[1])
    expected = int(away.argmin())
    assert np.isfinite(away[expected])
    assert nearest(places, PERSPECTIVE, SIZE, cursor, 1e4) == expected
    assert nearest(places, PERSPECTIVE, SIZE, cursor, 1.001 * away[expected]) == expected
    assert nearest(places, PERSPECTIVE, SIZE, cursor, 0.999 * away[expected]) is None
    others = np.arange(len(away)) != expected
    assert nearest(places, PERSPECTIVE, SIZE, cursor, 1e4, others) == int(
        np.where(others, away, np.inf).argmin()
    )


def test_behind_the_viewer_at_nan_and_in_an_empty_crowd_there_is_none():
    middle = SIZE[0] / 2, SIZE[1] / 2
    for place in (
        (0, 0, 10),
        (0, 0, 0),
        (0, 0, -0.5),
        (0, 0, -101),
        (np.nan, 0, -10),
        (0, np.inf, -10),
    ):
        assert nearest(np.array([place]).T, PERSPECTIVE, SIZE, middle, 1e4) is None
    assert nearest(np.empty((3, 0)), PERSPECTIVE, SIZE, middle, 1e4) is None
    assert nearest(np.array([[0.0], [0.0], [-10.0]]), PERSPECTIVE, SIZE, middle, 1e4) == 0


GROUPS = (
    Group("adult", 1.0, 1.0, 0.0, 1.0, deviations=(0.0, 0.02, 0.1)),
    Group("child", 0.5, 0.5, 0.0, 1.0, deviations=(0.0, 0.01, 0.05)),
)
# x, y, group of agents on the ground before a camera at (0, 0, 1) that looks along +y and is 2
# units wide, from 1 to 40 m
AGENTS = ((0, 5, 0), (1, 20, 0), (0, 30, 1), (0, 39.9, 0), (-30, 10, 0), (0, -10, 1), (0, 50, 0))


def accounts(kind="PERSP", groups=GROUPS, row=None):
    crowd = crowd_at([(x, y, 0) for x, y, _ in AGENTS], [group for _, _, group in AGENTS])
    edge = 1.0 if kind == "PERSP" else 20.0
    window = Window(-edge, edge, -edge, edge)
    camera = replace(straight(40.0, kind, (0, 0, 1)), window=window, pixels=(1000, 1000))
    walk = Walk(crowd, *chapter(Area(-60, -60, 60, 60)), groups, 1 / 24)
    frame = plan(walk, camera, LevelPolicy((0.25, 0.6)), 1)
    frame = frame if row is None else with_row(frame, np.array(row, np.uint8))
    return [account(frame, agent) for agent in range(len(AGENTS))], frame


def test_an_account_says_what_the_plan_made_of_an_agent():
    found, frame = accounts()
    assert [each.level for each in found] == frame.levels.tolist()
    assert [each.agent for each in found] == list(range(len(AGENTS)))
    assert [each.depth for each in found] == pytest.approx([y for _, y, _ in AGENTS])
    assert [each.visible for each in found] == [True, True, True, True, False, False, False]
    assert [each.reason for each in found] == [
        "near enough",
        "far away",
        "far away",
        "far away",
        "left of the frame",
        "clipped before the near plane",
        "clipped beyond the far plane",
    ]


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize(
    ("place", "side"),
    [
        ((-50, 10, 0), "left of the frame"),
        ((50, 10, 0), "right of the frame"),
        ((0, 10, 60), "above the frame"),
        ((0, 10, -60), "below the frame"),
    ],
)
def test_an_agent_beside_the_frame_is_told_by_the_side(kind, place, side):
    _, frame = accounts(kind)
    x, y, z = (np.full(len(AGENTS), float(value)) for value in place)
    away = replace(frame, crowd=replace(frame.crowd, x=x, y=y, z=z), buckets=NOBODY)
    assert account(away, 0).reason == side


def test_errors_are_in_pixels_of_the_picture():
    found, _ = accounts()
    # 1000 pixels for 2 units: 500 pixels a meter at 1 m; the sphere's nearest point errs most
    assert found[0].error == 0
    assert found[1].error == pytest.approx(0.02 * 500 / 19)
    assert found[2].error == pytest.approx(0.05 * 500 / 29.5)
    assert found[5].error is None
    flat, _ = accounts("ORTHO")
    assert flat[1].error == pytest.approx(0.02 * 1000 / 40)


def test_an_account_tells_that_the_shot_plan_has_another_lod_or_hides_the_agent():
    found, frame = accounts(
        row=[1 | OVERRIDDEN | PINNED, 0, 2 | HIDDEN, 1 | PINNED, 2 | OVERRIDDEN | PINNED, HIDDEN, 1]
    )
    assert frame.planned
    assert [each.level for each in found[:2]] == [1, 0] and [
        each.visible for each in found[:4]
    ] == [True, True, False, True]
    assert [each.reason for each in found] == [
        "override",
        "near enough",
        "override",
        "shot plan",
        "left of the frame",
        "override",
        "clipped beyond the far plane",
    ]


def test_without_measured_lods_there_is_no_error():
    found, _ = accounts(
        groups=(Group("adult", 1.0, 1.0, 0.0, 1.0), Group("child", 0.5, 0.5, 0.0, 1.0))
    )
    assert found[1].error is None


def test_an_agent_that_is_not_there_is_named():
    _, frame = accounts()
    for agent in (-1, len(AGENTS)):
        with pytest.raises(CrowdError, match=f"no agent {agent}: the crowd has 7"):
            account(frame, agent)
