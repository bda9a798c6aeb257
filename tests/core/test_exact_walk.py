from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.exact_walk import trouble, walk
from crowd_lod_extension.crowd_lod.behavior.plain_step import advance
from crowd_lod_extension.crowd_lod.behavior.step import step
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset
from crowd_lod_extension.crowd_lod.message_words import lines_of
from crowd_lod_extension.crowd_lod.validation.behavior_errors import step_by_listing
from crowd_lod_extension.crowd_lod.validation.exact_behavior import follow_exactly
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap, edge_map
from crowd_lod_extension.sample_scenes import plaza_map

from ..support.convergence import measure_convergence
from ..support.crowds import crowd_at
from ..support.machines import TO_AND_FRO, machine_of, random_machine, random_world
from ..support.shots import chapter

pytestmark = pytest.mark.once


def sentence_of(found):
    (line,) = lines_of([found.message], str)
    return line.sentence


def test_exact_walk_of_the_chapter_has_a_closed_form():
    machine, world = chapter(Area(0, 0, 64, 1))
    crowd = populate(1000, 3, 1, machine, world)
    for seconds in (0.3, 40.0, 1234.5):
        moved, chatters = walk(crowd, machine, world, seconds)
        offset = np.mod(
            crowd.x - 1 + 1.25 * seconds, 124
        )  # to and fro between the borders at 1 m and 63 m
        np.testing.assert_allclose(moved.x, 1 + np.minimum(offset, 124 - offset), atol=1e-10)
        assert (moved.state == (offset > 62)).all() and not chatters.any()


def test_exact_walk_in_two_parts_is_the_walk_in_one():
    random = np.random.default_rng(8)
    machine = random_machine(random, speeds=(0.1, 5))
    world = random_world(random)
    crowd = populate(300, 8, 1, machine, world)
    once, chatters = walk(crowd, machine, world, 3.0)
    half, _ = walk(crowd, machine, world, 1.3)
    twice, _ = walk(half, machine, world, 1.7)
    np.testing.assert_allclose(once.x[~chatters], twice.x[~chatters], atol=1e-10)
    np.testing.assert_allclose(once.y[~chatters], twice.y[~chatters], atol=1e-10)


def against_the_judge(crowd, machine, world, seconds, steps, method=step):
    limit = follow_exactly(crowd, machine, world, seconds, limit=True)
    return measure_convergence(crowd, machine, world, limit, steps, method)


def late_turn():
    """The chapter's walk, but who comes to an edge stands for a step before the new state walks
    back.
    """
    states = {
        "right": {"start": 1, "on": {"*": {"move": [1.25, 0.1]}, "right edge": {"next": "left"}}},
        "left": {"on": {"*": {"move": [-1.25, -0.1]}, "left edge": {"next": "right"}}},
    }
    machine = machine_of(states, labels=("ground", "left edge", "right edge"))
    world = edge_map(Area(0, 0, 16, 64), machine.labels, 16)
    return populate(500, 1, 1, machine, world), machine, world


@pytest.mark.parametrize("method", [step, step_by_listing])
def test_stepping_converges_with_order_one(method):
    found = against_the_judge(*late_turn(), 20.0, (32, 64, 128, 256, 512, 1024), method)
    assert found.order == pytest.approx(1, abs=0.15)
    assert (np.diff(found.mean) < 0).all() and found.agents == 500
    # three turns fit into 20 s; at each, up to two steps' way is lost, and by the letter two more
    # are walked beyond
    assert (found.worst <= 3 * (2 if method is step else 4) * 1.26 * found.dt).all()
    assert (found.median > 0).all() and (found.apart == 0).all()
    assert found.dt == pytest.approx(20 / 2.0 ** np.arange(5, 11))


def test_steps_are_exact_where_rules_move_as_the_state_they_lead_to():
    machine = load_preset("chapter")
    world = edge_map(Area(0, 0, 16, 4), machine.labels, 16)
    crowd = populate(200, 2, 1, machine, world)
    cut = against_the_judge(crowd, machine, world, 40.0, (64, 512))
    letter = against_the_judge(crowd, machine, world, 40.0, (64, 512), step_by_listing)
    assert cut.worst.max() < 1e-11 and np.isnan(cut.order)
    assert letter.mean.min() > 1e-3


def test_agents_sent_to_and_fro_over_a_border_are_found_with_their_place():
    machine = machine_of(TO_AND_FRO)
    world = LabelMap(np.array([[0, 0, 1], [0, 0, 0]], np.uint8), Area(10, 0, 16, 2))
    crowd = crowd_at([(10.5, 0.5, 0), (11, 0.2, 0), (12.5, 1.5, 0), (15, 0.9, 0)])
    found, edge = trouble(crowd, machine, world, 4.6)
    assert (
        edge.kind == "stuck" and edge.agents.tolist() == [2] and edge.x[0] == 15
    )  # at the map's right edge
    assert found.kind == "chatters" and found.agents.tolist() == [0, 1, 3]
    assert found.counts.sum() == 3 and set(found.column) <= {1, 2} and set(found.row) == {0}
    assert abs(found.x[0] - 14) == 1 and found.y[0] == 0.5
    assert "3 agents switch states endlessly in place" in sentence_of(found)


def test_a_cycle_of_states_on_one_label_is_found():
    machine = machine_of({
        "a": {"start": 1, "on": {"ground": {"move": [1, 0]}, "wall": {"next": "b", "move": [1, 0]}}},
        "b": {"on": {"*": {"next": "c"}}},
        "c": {"on": {"*": {"next": "a", "move": [1, 0]}}},
    })  # fmt: skip
    world = LabelMap(np.array([[0, 1]], np.uint8), Area(0, 0, 2, 1))
    (found,) = trouble(crowd_at([(0.5, 0.5, 0)]), machine, world, 2.0)
    assert found.kind == "chatters" and found.agents.tolist() == [0]


def test_agents_stuck_at_the_edge_or_on_a_label_are_found_and_those_at_rest_are_not():
    machine = machine_of({
        "walk": {"start": 1, "on": {"ground": {"move": [1, 0]}, "wall": {}, "seat": {"next": "sit"}}},
        "sit": {"on": {"*": {}}},
        "wait": {"after": 500, "then": "walk", "on": {"*": {}}},
    }, labels=("ground", "wall", "seat"))  # fmt: skip
    labels = np.array([[0, 0, 1, 0], [0, 0, 0, 0], [0, 2, 0, 0], [0, 0, 0, 0]], np.uint8)
    world = LabelMap(labels, Area(0, 0, 4, 4))
    crowd = crowd_at([(0.5, 0.5, 0), (0.2, 0.7, 0), (0.5, 1.5, 0), (0.5, 2.5, 0), (0.5, 3.5, 0)])
    waits = np.array([np.inf] * 4 + [500.0])
    crowd = replace(crowd, state=np.array([0, 0, 0, 0, 2], np.uint8), wait=waits)
    (found,) = trouble(crowd, machine, world)
    assert found.kind == "stuck" and found.agents.tolist() == [0, 1, 2]
    assert (
        found.counts.tolist() == [2, 1]
        and found.column.tolist() == [2, 3]
        and found.row.tolist() == [0, 1]
    )
    assert (
        "3 agents are stuck, most of them (2) at x 2.50 m, y 0.50 m (map column 2, row 0"
        in sentence_of(found)
    )


def test_a_crowd_that_walks_is_in_no_trouble():
    machine, world = chapter(Area(0, 0, 30, 30))
    assert trouble(populate(500, 1, 1, machine, world), machine, world) == ()


def test_a_table_that_turns_at_each_read_has_no_limit_and_convergence_says_so():
    """In one read the agent turns further in, in the next out again: how many it meets hangs on the
    step's phase.
    """
    names = [f"{i}" for i in range(9)]
    states = {
        n: {"start": int(i == 1), "on": {"ground": {"speed": 1, "heading": 180 - 22.5 * i},
            "wall": {"next": names[min(i + 1, 8)], "speed": 1, "heading": 180 - 22.5 * min(i + 1, 8)}}}
        for i, n in enumerate(names)
    }  # fmt: skip
    machine = machine_of(states)
    world = LabelMap(
        np.repeat([[1] * 2 + [0] * 18], 20, axis=0).astype(np.uint8), Area(0, 0, 20, 20)
    )
    x, y = np.random.default_rng(0).uniform((3, 2), (5, 6), (300, 2)).T
    crowd = replace(crowd_at(np.stack([x, y, 0 * x], axis=1)), state=np.ones(300, np.uint8))
    found = against_the_judge(crowd, machine, world, 10.0, (50, 200, 800))
    assert (found.apart > 0.2).all()


def test_on_the_plaza_s_large_map_nobody_misses_a_border():
    machine = load_preset("plaza")
    world = plaza_map.plan(machine)
    crowd = populate(500, 1, 3, machine, world)
    moved, chatters = walk(crowd, machine, world, 20.0)
    truth = follow_exactly(crowd, machine, world, 20.0, limit=True)
    assert not truth.unknown.any() and (chatters == truth.chatters).all()
    np.testing.assert_allclose(moved.x, truth.x, atol=1e-10)
    np.testing.assert_allclose(moved.y, truth.y, atol=1e-10)


@pytest.mark.parametrize("shape", [(1, 1), (1, 8), (8, 8)])
@pytest.mark.parametrize("velocity", [(1.0, 0.0), (1.0, 1.0), (0.0, -1.0), (-1.0, 0.3)])
@pytest.mark.parametrize("seconds", [1 / 24, 1.0, 10.0])
@pytest.mark.parametrize("steps", ["exact", "plain"])
def test_whoever_stands_on_a_border_or_corner_wraps_around(shape, velocity, seconds, steps):
    machine = load_preset("chapter")
    machine = replace(
        machine, edge="wrap", velocity=np.broadcast_to(velocity, machine.velocity.shape)
    )
    world = LabelMap(np.zeros(shape, np.uint8), Area(0.1, 0.3, 1.7, 1.1))
    crowd = populate(81, 1, 3, machine, world)
    row, column = np.divmod(np.arange(81), 9)
    crowd = replace(crowd, x=0.1 + column / 8 * 1.6, y=0.3 + row / 8 * 0.8)
    moved, tally = advance(crowd, machine, world, seconds, exact=steps == "exact")
    truth = follow_exactly(crowd, machine, world, seconds, limit=steps == "exact")
    assert not tally.stuck.any() and not truth.chatters.any()
    for now, place, size in ((moved.x, truth.x, 1.6), (moved.y, truth.y, 0.8)):
        apart = np.abs(now - place)  # to and fro over the map's border by rounding
        assert np.minimum(apart, size - apart).max() < 1e-12
