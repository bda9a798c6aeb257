"""Times of ways that take turns."""

import time

from crowd_lod_extension.crowd_lod.validation.timing import FEWEST, Times, time_in_turn


def test_ways_take_turns_after_a_run_that_does_not_count():
    told = []
    taken = time_in_turn({"one": lambda: told.append(1), "two": lambda: told.append(2)}, 3)
    assert told == [1, 2, *[1, 2] * 3]
    assert [len(each.wall) for each in taken.values()] == [3, 3]


def test_processor_time_is_not_that_of_the_clock():
    row = time_in_turn({"sleeps": lambda: time.sleep(0.02)}, 2)["sleeps"].row()
    assert row["wall_ms"] >= 20 > 2 * row["cpu_ms"]
    assert row["wall_ms_least"] <= row["wall_ms"] <= row["wall_ms_most"]


def test_a_median_is_steady_by_its_runs_not_by_their_number_alone():
    assert Times([10.0] * FEWEST, [1.0] * FEWEST).is_steady
    assert not Times([10.0] * (FEWEST - 1), []).is_steady
    assert not Times([1.0, 40.0] * 4, []).is_steady
    # quartiles a fifth of the median apart: known to a tenth from nine runs of ten on
    assert Times([9.0, 10.0, 11.0] * 9, []).is_steady


def test_runs_go_on_until_all_are_steady():
    calls = iter([0.0, 0.0, 0.03, 0.0, 0.03, *[0.0] * 100])
    rows = time_in_turn(
        {"restless": lambda: time.sleep(next(calls)), "calm": lambda: time.sleep(0.01)}
    )
    assert len(rows["calm"].wall) == len(rows["restless"].wall) >= FEWEST
