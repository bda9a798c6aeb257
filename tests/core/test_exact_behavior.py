"""The slow judge of behavior by hand and by closed forms, and the steps by the judge."""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.exact_walk import walk
from crowd_lod_extension.crowd_lod.behavior.plain_step import advance
from crowd_lod_extension.crowd_lod.validation import exact_behavior
from crowd_lod_extension.crowd_lod.validation.exact_behavior import follow_exactly
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap

from ..support.crowds import crowd_at
from ..support.machines import (
    LIVELY,
    TO_AND_FRO,
    machine_of,
    mirrored,
    random_machine,
    random_world,
)
from ..support.shots import chapter


def test_the_judge_knows_the_chapters_walk_in_closed_form():
    machine, world = chapter(Area(0, 0, 64, 1))
    crowd = populate(20, 3, 1, machine, world)
    for seconds in (0.3, 40.0, 1234.5):
        truth = follow_exactly(crowd, machine, world, seconds)
        offset = np.mod(
            crowd.x - 1 + 1.25 * seconds, 124
        )  # to and fro between the borders at 1 m and 63 m
        np.testing.assert_allclose(truth.x, 1 + np.minimum(offset, 124 - offset), atol=1e-10)
        assert (
            (truth.state == (offset > 62)).all()
            and not truth.chatters.any()
            and not truth.unknown.any()
        )


@pytest.mark.parametrize("edge", ["clamp", "wrap", "reflect", "stop"])
def test_the_judge_knows_the_edges_in_closed_form(edge):
    world = LabelMap(np.zeros((3, 4), np.uint8), Area(-4, 1, 8, 10))
    machine = machine_of({"go": {"on": {"*": {"move": [25, -15.5]}}}}, edge, ("ground",))
    crowd = populate(20, 1, 1, machine, world)
    truth = follow_exactly(crowd, machine, world, 1.0, steps=2)
    x = crowd.x + 50
    y = crowd.y - 31
    if edge == "clamp":
        x = x.clip(-4, 8)
        y = y.clip(1, 10)
    elif edge == "wrap":
        x = (x + 4) % 12 - 4
        y = (y - 1) % 9 + 1
    elif edge == "reflect":
        x = mirrored(x, -4, 8)[0]
        y = mirrored(y, 1, 10)[0]
    else:
        time = np.minimum((8 - crowd.x) / 25, (crowd.y - 1) / 15.5)
        x = crowd.x + 25 * time
        y = crowd.y - 15.5 * time
    np.testing.assert_allclose([truth.x, truth.y], [x, y], atol=1e-10)


def test_the_judge_sees_who_chatters_and_gives_up_in_the_end(monkeypatch):
    world = LabelMap(np.array([[0, 1]], np.uint8), Area(0, 0, 2, 1))
    crowd = crowd_at([(0.5, 0.5, 0), (0.1, 0.5, 0)])
    truth = follow_exactly(crowd, machine_of(TO_AND_FRO), world, 0.75)
    assert truth.chatters.tolist() == [True, False] and truth.x.tolist() == [1.0, 0.85]
    monkeypatch.setattr(exact_behavior, "MOST_PIECES", 1)
    assert follow_exactly(crowd, machine_of(TO_AND_FRO), world, 0.75).unknown.all()


@pytest.mark.parametrize("edge", ["clamp", "wrap", "reflect", "stop"])
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("kind", ["any", "lively"])
def test_steps_and_the_exact_walk_are_the_judges_on_random_maps(kind, seed, edge):
    """Any table, up to 60 cells a step; and one with timers and random draws."""
    random = np.random.default_rng(seed)
    lively = kind == "lively"
    machine = machine_of(LIVELY, edge) if lively else random_machine(random, edge=edge)
    world = random_world(random, 2 if lively else 3)
    crowd = populate(60, seed, 1, machine, world)
    if edge == "reflect":
        crowd = replace(crowd, mirror=random.integers(4, size=60).astype(np.uint8))

    moved = crowd
    for _ in range(4):
        moved, tally = advance(moved, machine, world, 0.25)
    assert_same(moved, tally.stuck, follow_exactly(crowd, machine, world, 0.25, steps=4))
    assert_same(
        *walk(crowd, machine, world, 2.0), follow_exactly(crowd, machine, world, 2.0, limit=True)
    )


def assert_same(moved, held, truth):
    assert not truth.unknown.any() and (held == truth.chatters).all()
    goes_on = ~held
    assert goes_on.sum() > 5
    assert (moved.state == truth.state)[goes_on].all()
    np.testing.assert_allclose(
        [moved.x[goes_on], moved.y[goes_on]], [truth.x[goes_on], truth.y[goes_on]], atol=1e-11
    )
