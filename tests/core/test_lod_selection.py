"""LODs by tolerance: which candidates are kept, and why the others are not."""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.culling.camera import Window
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.levels.assignment import (
    LevelPolicy,
    assign,
    deviations,
    threshold_distances,
)
from crowd_lod_extension.crowd_lod.levels.selection import (
    APART,
    BETWEEN,
    LEAST_SAVED,
    MOST_LENGTHS,
    View,
    allowed_lengths,
    choose,
    read_curve,
)
from crowd_lod_extension.crowd_lod.message_words import lines_of
from hypothesis import given, settings
from hypothesis import strategies as st

from ..support.cameras import straight


def said(dropped):
    """Of each dropped candidate, why it is, without whose it is."""
    return {
        k: line.sentence.removeprefix(f"{message.subject}: ")
        for k, message in dropped.items()
        for line in lines_of([message], str)
    }


# 50 pixels a unit slope, so that at 1 pixel a LOD begins 50 times its deviation away, and the
# radius
LODS = Group(
    "one",
    1,
    1.0,
    0,
    1,
    triangles=(1000, 900, 500, 450, 200, 190, 40),
    deviations=(0, 0.05, 0.1, 0.15, 0.4, 0.3, 1.5),
)


def test_candidates_that_do_not_pay_are_dropped_with_the_reason():
    kept, dropped = choose(LODS, 1.0, [View(straight(), 2.0, 40.0)])
    assert kept == [
        0,
        2,
        5,
    ]  # of 900, 450 too little is saved, 190 deviate less than 200, 40 begin at 76 m
    assert said(dropped) == {
        1: "a LOD of 900 triangles would save less than a fifth of the 1,000 of the next finer LOD.",
        3: "a LOD of 450 triangles would save less than a fifth of the 500 of the next finer LOD.",
        4: "a LOD of 200 triangles would deviate as much as one of 190, or more.",
        6: "a LOD of 40 triangles would begin 76 m away, and the farthest agent is 40 m away.",
    }
    assert choose(LODS, 1.0, [View(straight(), 2.0, 400.0)])[0] == [0, 2, 5, 6]
    kept, dropped = choose(LODS, 1.0, [View(straight(), 30.0, 40.0)])
    assert (
        kept == [0, 5]
        and said(dropped)[2]
        == "a LOD of 500 triangles would end 16 m away, and the nearest agent is 30 m away."
    )


def test_lods_that_artists_gave_go_before_those_that_are_about_as_coarse():
    view = View(straight(), 2.0, 400.0)
    kept, dropped = choose(LODS, 1.0, [view], given=[4])
    assert kept == [0, 2, 4, 6]  # without it 190 triangles deviate less than its 200
    assert (
        said(dropped)[3]
        == "a LOD of 450 triangles would save less than a fifth of the 500 of the next finer LOD."
    )
    kept, dropped = choose(LODS, 1.0, [view], given=[3])
    assert kept == [0, 3, 5, 6]
    assert (
        said(dropped)[2]
        == "a LOD of 500 triangles would save too little beside a given LOD of 450."
    )
    beaten = replace(LODS, triangles=(1000, 500, 100), deviations=(0, 0.4, 0.3))
    kept, dropped = choose(beaten, 1.0, [view], given=[1])
    assert kept == [0, 2]
    assert (
        said(dropped)[1] == "a LOD of 500 triangles would deviate as much as one of 100, or more."
    )


def test_a_zoom_and_the_tolerance_change_what_pays():
    near = View(straight(), 2.0, 12.0)
    assert choose(LODS, 1.0, [near])[0] == [0, 2]
    assert choose(LODS, 4.0, [near])[0] == [0, 2, 5]
    tele = replace(straight(), window=Window(-0.1, 0.1, -0.1, 0.1))
    assert choose(LODS, 1.0, [View(tele, 2.0, 12.0)])[0] == [0]
    assert choose(LODS, 1.0, [View(tele, 2.0, 12.0), near])[0] == [
        0,
        2,
    ]  # one frame of the shot is enough
    flat = straight(kind="ORTHO")  # 10 pixels a meter, at any distance
    assert choose(LODS, 1.0, [View(flat, 2.0, 12.0)])[0] == [0, 2]
    assert choose(LODS, 3.0, [View(flat, 2.0, 12.0)])[0] == [0, 5]


def test_agents_may_come_a_quarter_nearer_between_the_frames_that_were_looked_at():
    """A LOD that the next one relieves 6 m away is kept for agents that were seen from 6.5 m on."""
    group = replace(LODS, triangles=(1000, 500, 200), deviations=(0, 0.02, 0.1))
    assert choose(group, 1.0, [View(straight(), 6.5, 60.0)])[0] == [0, 1, 2]
    assert choose(group, 1.0, [View(straight(), 8.0, 60.0)])[0] == [0, 2]


def test_the_reason_holds_in_every_frame_and_in_an_orthographic_view():
    group = replace(
        LODS, triangles=(1000, 500, 190, 40), deviations=(0, 0.1, 0.3, 1.5)
    )  # from 6, 16 and 76 m on
    one = View(straight(), 2.0, 4.0)
    other = View(straight(), 300.0, 400.0)
    few = "be too coarse for all agents in 1 of the 2 frames checked"
    many = "and finer than needed in the others."
    kept, dropped = choose(group, 1.0, [one, other])
    assert kept == [0, 3]
    assert said(dropped) == {
        k: f"a LOD of {n} triangles would {few}, {many}" for k, n in ((1, 500), (2, 190))
    }
    tele = replace(straight(), window=Window(-0.1, 0.1, -0.1, 0.1))  # from 51 m on
    _, dropped = choose(group, 1.0, [one, View(tele, 2.0, 40.0)])
    assert (
        said(dropped)[1]
        == "a LOD of 500 triangles would begin 51 m away, and the farthest agent is 40 m away."
    )
    flat = View(straight(kind="ORTHO"), 2.0, 12.0)  # 1, 3 and 15 pixels
    kept, dropped = choose(group, 3.0, [flat])
    assert kept == [0, 2]
    assert said(dropped) == {
        1: "a LOD of 500 triangles would be finer than the tolerance needs at any distance, for "
        "the camera is orthographic.",
        3: "a LOD of 40 triangles would show more than the tolerance at any distance, for the "
        "camera is orthographic.",
    }


candidates = st.lists(st.tuples(st.integers(4, 5000), st.floats(0, 2)), min_size=8, max_size=8)
views = st.lists(
    st.builds(
        lambda near, times: View(straight(far=500), near, near * times),
        st.floats(1, 60),
        st.floats(1, 9),
    ),
    min_size=1,
    max_size=3,
)


@settings(max_examples=30)
@given(candidates, views)
def test_every_kept_candidate_is_used_and_none_that_is_used_saves_too_little(candidates, views):
    triangles, deviations = zip(*candidates, strict=True)
    group = replace(
        LODS, triangles=tuple(sorted(triangles, reverse=True)), deviations=(0, *deviations[1:])
    )
    kept, dropped = choose(group, 1.0, views)
    assert kept[0] == 0 and kept == sorted(kept) and len(kept) + len(dropped) == 8
    own = [group.triangles[k] for k in kept]
    assert all(b <= (1 - LEAST_SAVED) * a for a, b in zip(own, own[1:], strict=False))
    deviation = np.array([[group.deviations[k] for k in kept]])
    assert (np.diff(deviation[0, 1:]) > 0).all()  # LOD 0 is kept in any case
    thresholds = threshold_distances(
        LevelPolicy((0.0,) * (len(kept) - 1), tolerance=1.0),
        straight(far=500),
        np.array([1.0]),
        deviation,
    )
    # where each LOD begins, or the nearest agent that shows it stands
    edges = np.append(-np.inf, thresholds[0])
    reach = np.concatenate(
        [np.clip(edges, view.nearest / BETWEEN, view.farthest * BETWEEN) for view in views]
    )
    assert set(assign(reach, thresholds[0]).tolist()) | {0} == set(range(len(kept)))


def test_a_tolerance_that_means_nothing_is_refused():
    with pytest.raises(CrowdError, match="tolerance"):
        choose(LODS, float("nan"), [View(straight(), 2.0, 40.0)])


def test_a_curve_goes_through_what_is_known():
    assert read_curve([0.01, 0.02, 0.08], [(0.02, 100)], -1.0) == pytest.approx(
        [200, 100, 25]
    )  # as 1 / length
    assert read_curve([0.01, 0.02, 0.08], [(0.02, 100), (0.08, 400)], 1.0) == pytest.approx(
        [50, 100, 400]
    )
    assert read_curve([0.03, 0.18], [(0.01, 900), (0.09, 100)], -1.0) == pytest.approx([300, 50])
    # a LOD of fewer triangles that deviates less than another stands for it
    assert read_curve([0.02, 0.04], [(0.01, 300), (0.04, 800)], -1.0) == pytest.approx([300, 300])
    assert read_curve([0.02], [(0.02, 300), (0.02, 200)], -1.0) == pytest.approx([200])


def test_lengths_go_from_what_the_nearest_agent_allows_to_what_the_farthest_does():
    views = [View(straight(), 6.0, 40.0), View(straight(), 20.0, 50.0)]  # 0.02 m a pixel and meter
    lengths = allowed_lengths(views, 1.0, 0.2, 1e-4)
    assert lengths[0] == pytest.approx(0.2 * 5 / 50, rel=1e-3) and lengths[-1] == pytest.approx(
        0.2 * 49 / 50, rel=1e-3
    )
    assert (
        lengths[0] <= 0.2 * 5 / 50 and lengths[-1] <= 0.2 * 49 / 50 and len(lengths) == MOST_LENGTHS
    )
    near = allowed_lengths([View(straight(), 20.0, 21.0)], 1.0, 0.2, 1e-4)
    assert len(near) == 1  # farther ones would save next to nothing
    few = allowed_lengths([View(straight(), 20.0, 21.0 * APART**2)], 1.0, 0.2, 1e-4)
    assert len(few) == 3
    assert allowed_lengths(views, 1.0, 0.2, 0.05)[0] == 0.05  # finer ones save nothing
    assert (
        allowed_lengths([View(straight(), 1.0, 900.0)], 1.0, 9.0, 1e-4)[-1] == 0.25
    )  # a few triangles
    assert allowed_lengths(views, 1.0, 0.2, 1e-4, higher=True)[-1] == 0.25
    assert allowed_lengths([View(straight(kind="ORTHO"), 2.0, 40.0)], 1.0, 1.0, 1e-4) == [0.1]


def test_a_lod_that_repeats_the_group_s_last_never_begins():
    """Groups have as many LODs as the one with most: without any of its own a group shows LOD 0."""
    counts = ((900, 900, 900), (900, 90, 90), (900, 90, 9))
    bounds = ((0.0,) * 3, (0.0, 0.1, 0.1), (0.0, 0.1, 0.3))
    groups = [
        Group(str(k), 1, 1.0, 0, 1, triangles=own, deviations=off, bounds=off)
        for k, (own, off) in enumerate(zip(counts, bounds, strict=True))
    ]
    policy = LevelPolicy((0.0, 0.0), tolerance=1.0)
    for camera in (straight(), straight(kind="ORTHO")):
        thresholds = threshold_distances(policy, camera, np.ones(3), deviations(groups, policy))
        coarsest = assign(np.full(3, 1e6), thresholds, np.arange(3))
        assert coarsest.tolist() == ([0, 1, 2] if camera.kind == "PERSP" else [0, *coarsest[1:]])
        assert np.isinf(thresholds[0]).all() and (thresholds[0] > 0).all()
