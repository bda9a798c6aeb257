"""Work in parts: the progress rises with what is done, part by part, to 1."""

import pytest
from crowd_lod_extension.crowd_lod.progress import Workload


def steps(count):
    work = Workload(count)
    for _ in range(count):
        yield work.did(1)
    return count


def test_parts_count_by_what_they_cost():
    def whole():
        work = Workload(3)
        made = yield from work.take(steps(2), 1)
        made += yield from work.take(steps(4), 2)
        return made

    told = []
    doing = whole()
    with pytest.raises(StopIteration) as end:
        while True:
            told.append(next(doing))
    assert end.value.value == 6
    assert told == pytest.approx([1 / 6, 1 / 3, 1 / 2, 2 / 3, 5 / 6, 1])


def test_the_progress_stands_during_a_part_without_cost():
    work = Workload(2)
    work.did(1)
    assert list(work.take(bare_steps(3))) == [0.5] * 3


def bare_steps(count):
    for _ in range(count):
        yield


def test_work_that_is_announced_later_sets_the_progress_back_and_less_moves_it_on():
    work = Workload(2)
    assert work.did(1) == 0.5
    work.announce(3)
    assert work.did(0) == 0.25
    work.announce(1)
    assert work.did(0) == 0.5


def test_more_than_was_announced_ends_at_1():
    work = Workload(1)
    assert [work.did(1), work.did(1)] == [1, 1]


def test_a_part_that_is_closed_early_cleans_up_at_once():
    cleaned = []

    def part():
        try:
            yield 0.5
        finally:
            cleaned.append(True)

    taking = Workload(1).take(part(), 1)
    next(taking)
    taking.close()
    assert cleaned
