"""Ways to step a crowd beside closed forms, and rounding that a table amplifies."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.validation.behavior_errors import (
    CUT,
    FRAMES,
    LISTING,
    RATES,
    compare_behavior,
    sensitivity,
)
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap

from ..support.crowds import crowd_at, walker
from ..support.machines import machine_of
from ..support.shots import ONE, chapter, shot


def people(count):
    return shot(*chapter(Area(-20, -20, 20, 20)), ONE, count, 1)


@pytest.mark.once
def test_frames_are_exact_in_the_chapters_scene_and_the_listing_is_of_first_order():
    rows = {
        (row["way"], row["steps_a_second"]): row for row in compare_behavior([people(300)], 48, 1)
    }
    assert {name for name, _ in rows} == {FRAMES, LISTING, CUT}
    assert rows[FRAMES, 24]["worst_m"] < 1e-11 and rows[FRAMES, 24]["apart"] == 0
    assert all(rows[CUT, rate]["worst_m"] < 1e-11 for rate in RATES)
    errors = [rows[LISTING, rate]["worst_m"] for rate in RATES]
    assert errors[0] > 0.02 and errors[-1] == pytest.approx(errors[0] / 8, rel=0.3)
    assert rows[LISTING, 24]["apart"] > 0
    assert [key for key, row in rows.items() if row["default"]] == [(FRAMES, 24)]
    assert all(row["cpu_ms"] > 0 and row["judged"] == 300 for row in rows.values())


def test_rounding_is_not_amplified_where_all_walk_straight():
    found = sensitivity([people(100)], 60)
    assert found.until is None and found.apart == 0 and found.farthest < 1e-11


@pytest.mark.once
def test_all_crowds_are_judged():
    rows = list(compare_behavior([people(60), people(1200)], 24, 1, (24,)))
    assert {row["agents"] for row in rows} == {1260}
    assert {row["judged"] for row in rows} == {560}  # all of the small one, JUDGED / 2 of the other
    assert sensitivity([people(60), people(1200)], 5).judged == 560


def test_rounding_is_amplified_where_ways_part_at_a_corner():
    """Who walks into the corner of a pillar passes it on this side or on that one."""
    states = {
        "go": {"start": 1, "on": {"ground": {"move": [1, 1]}, "pillar": {"next": "aside", "move": [0, 0]}}},
        "aside": {"on": {"*": {"move": [-1, 0]}}},
    }  # fmt: skip
    machine = machine_of(states, labels=("ground", "pillar"))
    labels = np.zeros((8, 8), np.uint8)
    labels[4, 3] = 1  # left of the way, which leads through its corner
    crowd = crowd_at([(0.1 * k, 0.1 * k, 0) for k in range(1, 11)])
    walk = Walk(crowd, machine, LabelMap(labels, Area(0, 0, 8, 8)), (walker(),), 0.1)
    found = sensitivity([walk], 60)
    # the first comes to the corner (4, 4) after 30 frames
    assert 0 < found.apart < 10 and 29 <= found.until <= 40 and found.farthest > 0.5
