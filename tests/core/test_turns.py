"""Steps with very many turns or cells: no longer than others, and where they should end."""

import dataclasses
from fractions import Fraction

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior import step
from crowd_lod_extension.crowd_lod.behavior.exact_walk import trouble, walk
from crowd_lod_extension.crowd_lod.behavior.plain_step import PIECES, PIECES_A_CELL, advance
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.validation.exact_behavior import follow_exactly
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap

from ..support.crowds import crowd_at, walker
from ..support.machines import machine_of, mirrored, random_machine, same
from ..support.shots import every_step

pytestmark = pytest.mark.once

FRAME = 1 / 24


def turning(way, edge="clamp", back=None, **more):
    """Who comes to a wall turns back."""
    way, back = list(way), list(back or (-way[0], -way[1]))
    return machine_of(
        {
            "out": {
                "start": 1,
                **more,
                "on": {"ground": {"move": way}, "wall": {"next": "back", "move": back}},
            },
            "back": {
                **more,
                "on": {"ground": {"move": back}, "wall": {"next": "out", "move": way}},
            },
        },
        edge,
    )


def corner(x=0.0, y=0.0):
    """Two walls that touch at a corner, 1 m from x, y."""
    return LabelMap(np.array([[1, 0], [0, 1]], np.uint8), Area(x, y, x + 2, y + 2))


def to_and_fro(place, way, seconds, at):
    """Where an agent is that turns at the walls below left and right of the corner `at` (2,),
    exactly.
    """
    place, way, at = ([Fraction(float(value)) for value in pair] for pair in (place, way, at))
    ahead = (at[0] - place[0]) / way[0]
    behind = (place[1] - at[1]) / way[1]
    turn, offset = divmod(Fraction(seconds) + behind, ahead + behind)
    time = (ahead + behind - offset if turn % 2 else offset) - behind
    return [float(p + v * time) for p, v in zip(place, way, strict=True)], int(turn % 2)


@pytest.mark.parametrize("offset", [0.0, -5e4 / 3])
def test_between_walls_that_touch_at_a_corner_agents_go_to_and_fro_or_stand(offset):
    """Who stands is off by no more than the room that the walls leave it."""
    random = np.random.default_rng(1)
    world = corner(offset, -offset)
    at = [world.area.x_min + world.cell[0], world.area.y_min + world.cell[1]]
    for away in 10.0 ** -np.arange(1, 9):
        way = random.uniform(0.2, 2, 2)
        crowd = crowd_at(
            np.append(
                at + random.uniform(0.1, 1, (20, 2)) * (-away, away), np.zeros((20, 1)), axis=1
            )
        )
        moved, tally = advance(crowd, turning(way), world, FRAME)
        assert tally.pieces <= PIECES + PIECES_A_CELL
        expected = [
            to_and_fro(place, way, FRAME, at) for place in zip(crowd.x, crowd.y, strict=True)
        ]
        off = np.abs(
            np.array([place for place, _ in expected]) - np.array([moved.x, moved.y]).T
        ).max(axis=1)
        assert off.max() <= 2 * away * way.max() / way.min()
        # float64 knows places to a few units in the last place: that much a turn, more where the
        # way is aslant
        unsure = (
            8 * way.max() / way.min() * (np.spacing(abs(offset) + 2) + np.spacing(FRAME)) * PIECES
        )
        assert off[~tally.stuck].max(initial=0) <= unsure
        assert tally.stuck.all() or away > 1e-5
        assert not tally.stuck.any() or away < 5e-3


@pytest.mark.once
@pytest.mark.parametrize("edge", ["clamp", "wrap"])
@pytest.mark.parametrize(
    "back, more",
    [
        (None, {"after": 50, "then": "out"}),
        ((-1, -0.7001), {}),
        ((-1, -0.69), {}),
        ((-1, -0.71), {}),
    ],
)
def test_who_does_not_come_back_to_where_it_was_stands_after_so_many_turns(edge, back, more):
    machine = turning((1, 0.7), edge, back, **more)
    world = corner()
    for away in 10.0 ** -np.arange(2, 16, 3):
        crowd = dataclasses.replace(
            crowd_at([(1 - away, 1 + away / 3, 0)]), wait=np.full(1, 50.0 if more else np.inf)
        )
        moved, tally = advance(crowd, machine, world, FRAME)
        assert tally.pieces <= PIECES + PIECES_A_CELL
        assert tally.stuck.all() or away > 1e-4
        assert np.hypot(moved.x - 1, moved.y - 1) < 10 * away + 0.05 * (not tally.stuck[0])
        assert (
            not more
            or moved.state[0]
            or moved.wait[0] == pytest.approx(50 - FRAME, abs=1e-12)
            or tally.reads > 1
        )
        exact, caught = walk(crowd, machine, world, 60.0)
        assert np.isfinite(exact.x).all() and (caught.all() or away > 1e-3 or back)


@pytest.mark.once
@pytest.mark.parametrize("more", [{}, {"after": [3, 9], "then": {"out": 1, "back": 1}}])
@pytest.mark.parametrize("edge", ["clamp", "wrap"])
def test_all_forms_of_a_step_agree_on_agents_between_walls(edge, more, monkeypatch):
    monkeypatch.setattr(step, "FEW_AGENTS", 0)
    random = np.random.default_rng(3)
    world = LabelMap(np.tile(np.array([[1, 0], [0, 1]], np.uint8), (6, 6)), Area(-30, 0, 30, 60))
    machine = turning((5, 4), edge, **more)
    crowd = populate(200, 1, 1, machine, world)
    middle = 10 * random.integers(6, size=20) + 5
    away = 10.0 ** random.uniform(-9, -2, 20)
    crowd.x[:20] = middle - 30 - away
    crowd.y[:20] = middle + away * random.uniform(0.1, 0.9, 20)
    crowd.state[:20] = 0
    make = lambda: Walk(crowd, machine, world, (walker(),), FRAME, 0, every=8)  # noqa: E731
    asked = make()
    whole = make()
    alone = crowd
    for frame in range(4):
        alone, _ = advance(alone, machine, world, FRAME) if frame else (alone, None)
        assert same(asked.at(frame), alone) and same(every_step(whole).at(frame), alone)
    for time in (2.5, 1, 3):
        assert same(asked.at(time), make().at(time))


def test_agents_caught_between_walls_are_in_trouble_and_others_are_not():
    machine = turning((1, 0.7))
    world = corner()
    away = np.array([1e-2, 1e-5, 1e-8, 0.7])
    crowd = crowd_at(np.array([1 - away, 1 + away / 3, 0 * away]).T)
    (found,) = trouble(crowd, machine, world)
    assert found.kind == "chatters" and found.agents.tolist() == [0, 1, 2]
    assert (found.column[0], found.row[0]) in [(0, 1), (0, 0), (1, 1)]


VERY_FAST = [(1e5, 0), (0, -1e5), (-0.37e5, 1e5)]


def go_very_fast(way, edge, walls):
    """(moved, x, y): fifty agents after a frame at a hundred thousand meters a second."""
    labels = np.pad(np.zeros((62, 62), np.uint8), 1, constant_values=walls)
    world = LabelMap(labels, Area(-32, 0, 32, 64))
    x, y = np.random.default_rng(0).uniform((-30, 2), (30, 62), (50, 2)).T
    crowd = crowd_at(np.array([x, y, 0 * x]).T)
    moved, tally = advance(crowd, turning(way, edge), world, FRAME)
    assert not tally.stuck.any() and tally.pieces < (200 if 0 in way else 4_000)
    return moved, x, y


@pytest.mark.parametrize("way", VERY_FAST)
def test_between_walls_the_very_fast_go_straight_back_from_the_first_on_either_side(way):
    moved, x, y = go_very_fast(way, "clamp", walls=1)
    vx, vy = way
    with np.errstate(divide="ignore"):
        times = np.array([([[-31], [31]] - x) / vx, ([[1], [63]] - y) / vy])
    ahead = np.where(times > 0, times, np.inf).min(axis=(0, 1))
    behind = np.where(times < 0, times, -np.inf).max(axis=(0, 1))
    time, turned = mirrored(np.full(50, FRAME), behind, ahead)
    assert (moved.state == turned).all()
    np.testing.assert_allclose([moved.x, moved.y], [x + vx * time, y + vy * time], atol=1e-6)


FOLDS = {
    "clamp": lambda value, low: np.clip(value, low, low + 64),
    "wrap": lambda value, low: (value - low) % 64 + low,
    "reflect": lambda value, low: mirrored(value, low, low + 64)[0],
}


@pytest.mark.parametrize("way", VERY_FAST)
@pytest.mark.parametrize("edge", FOLDS)
def test_the_very_fast_end_on_a_straight_line_that_is_folded_at_the_map_s_edges(edge, way):
    moved, x, y = go_very_fast(way, edge, walls=0)
    fold = FOLDS[edge]
    expected = fold(x + way[0] * FRAME, -32), fold(y + way[1] * FRAME, 0)
    np.testing.assert_allclose([moved.x, moved.y], expected, atol=1e-6)


def wheel(turns):
    """`turns` states that follow one another at each read, whose moves lead to one border."""
    return {
        f"s{k}": {
            "start": int(k == 0),
            "on": {
                "ground": {"next": f"s{(k + 1) % turns}", "move": [1, 0]},
                "wall": {"next": f"s{(k + 1) % turns}", "move": [-1, 0]},
            },
        }
        for k in range(turns)
    }


@pytest.mark.parametrize("turns", [1, 2, 7])
def test_who_goes_in_rounds_in_place_stands_after_few_pieces(turns):
    world = LabelMap(np.array([[0, 1]], np.uint8), Area(0, 0, 2, 1))
    crowd = crowd_at([(0.99, 0.5, 0), (0.2, 0.5, 0)])
    moved, tally = advance(crowd, machine_of(wheel(turns)), world, FRAME)
    assert tally.stuck.tolist() == [True, False] and tally.pieces <= 4 * 2 * turns
    assert moved.x[0] == pytest.approx(1, abs=1e-12)


def test_who_turns_many_times_in_place_and_then_walks_out_does_not_stand():
    world = LabelMap(np.array([[0, 1]], np.uint8), Area(0, 0, 2, 1))
    states = wheel(40) | {"s39": {"on": {"*": {"move": [-1, 0]}}}}
    go_like_the_judge(crowd_at([(0.999, 0.5, 0)]), machine_of(states), world, FRAME, 1)


def patches(random):
    """A map of large patches of three labels, with some cells of one strewn in."""
    labels = np.kron(random.integers(3, size=(4, 5)), np.ones((9, 7), int)).astype(np.uint8)
    labels[random.random(labels.shape) < 0.01] = 1
    return LabelMap(labels, Area(-7, 0, 28, 36))


def go_like_the_judge(crowd, machine, world, seconds, steps):
    """The steps' ways and states are the judge's; return how many reads an agent made in a step."""
    truth = follow_exactly(crowd, machine, world, seconds, steps)
    reads = 0
    for _ in range(steps):
        crowd, tally = advance(crowd, machine, world, seconds)
        reads += tally.reads
    assert not truth.unknown.any() and (tally.stuck == truth.chatters).all()
    assert (crowd.state == truth.state)[~truth.chatters].all()
    np.testing.assert_allclose(crowd.x, truth.x, atol=1e-10)
    np.testing.assert_allclose(crowd.y, truth.y, atol=1e-10)
    return reads / len(crowd) / steps


@pytest.mark.parametrize("seed", range(4))
def test_through_cells_of_one_label_at_once_is_through_each(seed):
    """Any table, up to 100 cells a step."""
    random = np.random.default_rng(seed)
    world = patches(random)
    machine = random_machine(random, speeds=(1, 400))
    assert go_like_the_judge(populate(60, seed, 1, machine, world), machine, world, 0.2371, 3) > 3


@pytest.mark.parametrize("seed", range(2))
def test_along_the_axes_through_cells_of_one_label_the_way_is_the_same(seed):
    """Also from a border on, and between two rows of cells, in numbers that float64 never
    rounds.
    """
    random = np.random.default_rng(seed)
    ways = [
        2.0 ** random.integers(3, 8) * np.array(way)
        for way in ((1, 0), (-1, 0), (0, 1), (0, -1)) * 2
    ]
    states = {
        f"s{i}": {"start": 1, "on": {"*": {"move": list(way)}, "l1": {"next": "stands"}}}
        for i, way in enumerate(ways)
    }
    machine = machine_of(states | {"stands": {"on": {"*": {}}}}, labels=("l0", "l1", "l2"))
    world = patches(random)
    crowd = populate(300, seed, 1, machine, world)
    crowd.x[:], crowd.y[:] = np.floor(crowd.x * 2) / 2, np.floor(crowd.y * 2) / 2
    assert go_like_the_judge(crowd, machine, world, 0.2371, 2) > 2
