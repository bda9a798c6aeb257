"""What a simulation's positions tell."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.tracks.simulated import FASTEST_TURN, Facing, nearest_distance


def test_nearest_distance_is_that_of_all_pairs_of_a_frame():
    random = np.random.default_rng(3)
    for count in (2, 5, 300):
        frames = random.integers(0, 1 + count // 100, count)
        places = random.uniform(-20, 20, (count, 2)).round(1)
        apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
        apart[frames[:, None] != frames[None]] = np.inf
        least = apart[~np.eye(count, dtype=bool)].min()
        assert nearest_distance(frames, places) == pytest.approx(least, abs=1e-12)
    assert nearest_distance(np.arange(300), places) == np.inf
    assert nearest_distance(frames[:0], places[:0]) == np.inf
    in_a_column = np.stack([np.zeros(50), np.arange(50.0)], axis=1)
    assert nearest_distance(np.zeros(50), in_a_column) == 1


def test_who_turns_back_turns_over_some_rows_and_who_stands_keeps_facing():
    facing = Facing(np.array([0.0, 1.0]))
    people = np.array([0, 1])
    headings = [facing.heading.copy()]
    for _ in range(30):
        facing.follow(people, np.array([[-0.13, 0.001], [0.002, 0.0]]), 0.1)
        headings.append(facing.heading.copy())
    headings = np.array(headings)
    assert abs(np.diff(headings[:, 0])).max() <= FASTEST_TURN * 0.1 + 1e-9
    assert abs(np.cos(headings[-1, 0]) + 1) < 1e-3
    assert (headings[:, 1] == 1).all()
