import dataclasses
import weakref

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.plain_step import advance
from crowd_lod_extension.crowd_lod.behavior.step import courant, step
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.height_map import HeightMap
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap

from ..support.crowds import crowd_at, walker
from ..support.machines import LIVELY, TO_AND_FRO, machine_of, mirrored, random_world, same
from ..support.shots import ONE, chapter, shot


def test_a_step_within_a_cell_is_listing_1_1_bit_for_bit():
    machine = load_preset("plaza")
    random = np.random.default_rng(5)
    labels = random.integers(len(machine.labels), size=(40, 40)).astype(np.uint8)
    world = LabelMap(labels, Area(0, 0, 20, 20))
    crowd = populate(2000, 3, 1, machine, world)
    after = step(crowd, machine, world, 1 / 24)
    stayed = 0
    for i in range(len(crowd)):
        s = crowd.state[i]
        row = int(crowd.y[i] / 0.5)
        column = int(crowd.x[i] / 0.5)
        dx, dy = machine.velocity[s, labels[row, column]]
        x = crowd.x[i] + dx * (1 / 24)
        y = crowd.y[i] + dy * (1 / 24)
        if (int(x // 0.5), int(y // 0.5)) == (column, row):
            assert after.state[i] == machine.next_state[s, labels[row, column]]
            assert (after.x[i], after.y[i]) == (x, y)
            stayed += 1
    assert stayed > 1500


def test_chapter_walks_right_to_the_edge_turns_and_walks_left():
    machine, world = chapter(Area(0, 0, 64, 1))
    crowd = crowd_at([(60.0, 0.5, 0)])
    xs = []
    states = []
    for _ in range(24 * 120):
        crowd = step(crowd, machine, world, 1 / 24)
        xs.append(crowd.x[0])
        states.append(crowd.state[0])
    assert 63 - 1.25 / 24 <= max(xs) <= 63 and 1 <= min(xs) <= 1 + 1.25 / 24
    turns = np.flatnonzero(np.diff(states))
    assert len(turns) == 3  # right edge, left edge, right edge, in 120 s
    # from the right edge's border to the left edge's border: 62 m at 1.25 m/s, to within two steps
    assert (abs(np.diff(turns) / 24 - 62 / 1.25) <= 2 / 24).all()


STOPS = {
    "run": {"on": {"*": {"move": [90, 0]}, "wall": {"next": "stand"}}},
    "stand": {"on": {"*": {}}},
}


def test_fast_agents_do_not_jump_over_a_wall():
    machine = machine_of(STOPS)
    labels = np.zeros((1, 100), np.uint8)
    labels[0, 50] = 1
    world = LabelMap(labels, Area(0, 0, 100, 1))
    for x in np.linspace(0.01, 49.99, 97):
        crowd = step(crowd_at([(x, 0.5, 0)]), machine, world, 1.0)
        assert crowd.x[0] == 50 and crowd.state[0] == 1


@pytest.mark.once
@pytest.mark.parametrize("offset", [0.0, -3e4 / 7])
@pytest.mark.parametrize("rising", [True, False])
def test_a_diagonal_wall_of_cells_that_touch_at_corners_is_never_crossed(rising, offset):
    size = 64
    labels = np.zeros((size, size), np.uint8)
    diagonal = np.arange(size)
    labels[diagonal, diagonal if rising else size - 1 - diagonal] = 1
    cell = 0.125
    world = LabelMap(labels, Area(offset, offset, offset + size * cell, offset + size * cell))
    random = np.random.default_rng(4)
    across = -1 if rising else 1
    for speed in (1e-3, 0.3, 1, 2**0.5, 7, 1e3):
        ways = [
            (1, 0),
            (0, 1),
            (-1, 0),
            (0, -1),
            (1, 1),
            (-1, 1),
            (-1, -1),
            (1, -1),
            *random.normal(size=(3, 2)),
        ]
        for way in ways:
            rule = {"move": [speed * cell * part for part in way]}
            machine = machine_of(
                {
                    "run": {"on": {"ground": rule, "wall": {"next": "stand"}}},
                    "stand": {"on": {"*": {}}},
                }
            )
            column, row = random.integers(size, size=(2, 300))
            centerd = (
                np.arange(300) < 150
            )  # from the middle of a cell the diagonal ways lead through corners
            within = np.where(centerd, 0.5, random.random((2, 300)))
            x, y = offset + (np.stack([column, row]) + within) * cell
            crowd = crowd_at(np.stack([x, y, 0 * x], axis=1))

            def side(crowd):
                column, row = world.cells(crowd.x, crowd.y)
                return np.sign(row + across * column + (0 if rising else 1 - size))

            before = side(crowd)
            for _ in range(3):
                crowd = step(crowd, machine, world, 1.0)
            after = side(crowd)
            # an agent stops on entering the wall's cell, at its border: the rounding of the border
            # may fall to either
            assert (after * before >= 0).all(), (speed, way)


def test_cost_grows_with_the_fast_agents_only():
    """Speeds from 1e-3 to 1e3 cells a step in one table; counted in reads, not in seconds."""
    speeds = 10.0 ** np.arange(-3, 4)
    machine = machine_of(
        {f"s{i}": {"on": {"*": {"move": [v, 0]}}} for i, v in enumerate(speeds)},
        "wrap",
        ("ground",),
    )
    world = LabelMap(np.zeros((1, 100), np.uint8), Area(0, 0, 100, 1))
    assert courant(machine, world, 1.0).ravel() == pytest.approx(speeds)
    counts = np.array([5000, 5000, 5000, 100, 20, 5, 2])
    x = np.random.default_rng(0).uniform(0, 100, counts.sum())
    crowd = crowd_at(np.stack([x, 0 * x + 0.5, 0 * x], axis=1))
    crowd = dataclasses.replace(crowd, state=np.repeat(np.arange(7), counts).astype(np.uint8))
    moved, tally = advance(crowd, machine, world, 1.0)
    crossed = np.floor(x + np.repeat(speeds, counts)) - np.floor(x)
    assert tally.reads == len(x) + crossed.sum()
    assert tally.reads < 1.25 * len(x)
    np.testing.assert_allclose(moved.x, np.mod(x + np.repeat(speeds, counts), 100), atol=1e-9)


def test_nobody_gets_further_than_its_speed_about_the_origin():
    random = np.random.default_rng(1)
    fastest = []
    for _ in range(12):
        table = load_preset("plaza")
        (width, depth) = 10 ** random.uniform(1, 2.5, 2)
        labels = np.where(
            random.random((31, 37)) < 0.25, random.integers(len(table.labels), size=(31, 37)), 0
        ).astype(np.uint8)
        world = LabelMap(labels, Area(-width / 2, -depth / 2, width / 2, depth / 2))
        crowd = populate(500, 1, 1, table, world)
        reach = np.hypot(*table.velocity.reshape(-1, 2).T).max() / 24
        for _ in range(12):
            before = crowd
            crowd = step(crowd, table, world, 1 / 24)
            fastest.append(np.hypot(crowd.x - before.x, crowd.y - before.y).max() / reach)
    assert 0.9 < max(fastest) < 1 + 1e-9


def test_absurd_speeds_are_refused_by_name():
    machine = machine_of(
        {"walk": {"on": {"*": {}}}, "warp": {"on": {"*": {}, "wall": {"move": [0, -1e9]}}}}
    )
    world = LabelMap(np.zeros((10, 10), np.uint8), Area(0, 0, 10, 10))
    with pytest.raises(CrowdError, match=r"1e\+09 cells.*'warp' on 'wall'.*65536"):
        step(crowd_at([(1, 1, 0)]), machine, world, 1.0)
    huge = machine_of({"warp": {"on": {"*": {"move": [1.7e308, 1.7e308]}}}})
    with pytest.raises(CrowdError, match="inf cells"):
        step(crowd_at([(1, 1, 0)]), huge, world, 1.0)


@pytest.mark.once
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("edge", ["clamp", "wrap", "reflect", "stop"])
def test_edge_policies_at_any_speed(edge, seed):
    """One label, one velocity: the way has a closed form. From a thousandth to hundreds of cells a
    step.
    """
    random = np.random.default_rng(seed)
    area = Area(-4, 1, 8, 10)
    world = LabelMap(np.zeros((7, 11), np.uint8), area)
    for speed in (1e-3, 0.9, 13, 400):
        heading = random.uniform(0, 360)
        machine = machine_of(
            {"go": {"on": {"*": {"speed": speed, "heading": heading}}}}, edge, ("ground",)
        )
        crowd = populate(200, seed, 1, machine, world)
        x = crowd.x
        y = crowd.y
        vx, vy = machine.velocity[0, 0]
        for count in (1, 2, 3):
            crowd = step(crowd, machine, world, 1.0)
            far_x = x + vx * count
            far_y = y + vy * count
            if edge == "clamp":
                far_x = far_x.clip(-4, 8)
                far_y = far_y.clip(1, 10)
            elif edge == "wrap":
                far_x = (far_x + 4) % 12 - 4
                far_y = (far_y - 1) % 9 + 1
            elif edge == "reflect":
                (far_x, flip_x) = mirrored(far_x, -4, 8)
                (far_y, flip_y) = mirrored(far_y, 1, 10)
                assert (crowd.mirror == flip_x + 2 * flip_y).all()
            else:
                time = np.minimum(
                    (np.where(vx > 0, 8, -4) - x) / vx, (np.where(vy > 0, 10, 1) - y) / vy
                )
                time = np.minimum(time, count)
                far_x = x + vx * time
                far_y = y + vy * time
                assert not advance(crowd, machine, world, 1.0)[1].stuck.any()
            np.testing.assert_allclose(crowd.x, far_x, atol=1e-9)
            np.testing.assert_allclose(crowd.y, far_y, atol=1e-9)


@pytest.mark.parametrize("way", [(0, 1), (1, 0)])
def test_where_the_map_stops_agents_they_walk_along_its_border(way):
    machine = machine_of({"go": {"on": {"*": {"move": list(way)}}}}, "stop", ("ground",))
    world = LabelMap(np.zeros((1, 1), np.uint8), Area(0, 0, 4, 4))
    places = np.array([(0, 2, 0), (4, 2, 0), (2, 0, 0), (2, 4, 0)][:: 1 if way[1] else -1][:2])
    moved = step(crowd_at(places), machine, world, 1.0)
    assert [moved.x, moved.y] == pytest.approx(places[:, :2].T + np.array(way)[:, None])


def test_an_agent_that_the_table_sends_to_and_fro_stands_and_is_told():
    machine = machine_of(TO_AND_FRO)
    world = LabelMap(np.array([[0, 1]], np.uint8), Area(0, 0, 2, 1))
    crowd, tally = advance(crowd_at([(0.5, 0.5, 0), (0.1, 0.5, 0)]), machine, world, 0.75)
    assert tally.stuck.tolist() == [True, False] and tally.reads <= 8
    np.testing.assert_allclose(crowd.x, [1.0, 0.85], atol=1e-12)


def lively(seed=1, edge="wrap", **more):
    world = random_world(np.random.default_rng(seed), 2)
    return shot(machine_of(LIVELY, edge), world, seed=seed, first_frame=10, every=8, **more)


def trajectory(seed=1):
    return shot(*chapter(Area(0, 0, 30, 30)), ONE, 500, seed, first_frame=10, every=8)


@pytest.mark.once
@pytest.mark.parametrize("make", [trajectory, lively, lambda: lively(edge="reflect")])
def test_trajectory_does_not_depend_on_the_order_of_frames(make):
    times = [100, 10, 55.5, 12.25, 99, 55, 100, 3, 11, 55.5]
    asked = make()
    for time in times:
        assert same(asked.at(time), make().at(time)), time


def test_the_times_of_an_open_shutter_do_not_step_from_far_back_again():
    """Blender asks for them before, at and after each frame: what those need is at hand."""
    asked = trajectory()
    for number in range(20, 36):
        crowd = asked.at(number)
        before = asked.at(number - 1)
        for time in (number - 0.25, number, number + 0.25, number, number - 0.75):
            asked.at(time)
        assert asked.at(number) is crowd and asked.at(number - 1) is before


def test_a_crowd_that_nobody_asks_for_again_is_let_go():
    asked = trajectory()
    before = weakref.ref(asked.at(20))
    assert asked.at(21) and before() is None


def test_an_agents_chances_do_not_depend_on_the_rest_of_the_crowd():
    whole = lively()
    part = lively()
    chosen = np.arange(0, 400, 7)
    fields = {name: column[chosen] for name, column in part.start.columns.items()}
    part = dataclasses.replace(part, start=dataclasses.replace(part.start, **fields))
    a = whole.at(150)
    b = part.at(150)
    assert (a.x[chosen] == b.x).all() and (a.state[chosen] == b.state).all()


@pytest.mark.parametrize("edge", ["clamp", "reflect"])
def test_nobody_walks_or_climbs_faster_than_a_walk_says_and_some_as_fast(edge):
    ways = {"go": [3, 2], "back": [-1, -4]}
    machine = machine_of(
        {name: {"start": 1, "on": {"*": {"move": way}}} for name, way in ways.items()}, edge
    )
    world = LabelMap(np.zeros((1, 1), np.uint8), Area(0, 0, 20, 20))
    valley = HeightMap(3 * np.abs(np.arange(-4, 6, dtype=np.float32)[:, None]), world.area)
    crowd = populate(40, 1, 1, machine, world)
    walk = Walk(crowd, machine, world, (walker(),), 0.5, heights=valley)
    moved = []
    for frame in range(2, 9):
        a, b = walk.at(frame), walk.at(frame + 1)
        moved.append([b.x - a.x, b.y - a.y, b.z - a.z])
    bounds = walk.velocity(2, 9)
    least, most = bounds.between([0.5])
    assert np.min(moved, axis=(0, 2)) == pytest.approx(least, rel=1e-6)
    assert np.max(moved, axis=(0, 2)) == pytest.approx(most, rel=1e-6)
    assert np.hypot(*np.swapaxes(moved, 0, 1)[:2]).max() == pytest.approx(bounds.speed / 2)


def test_a_reflected_agent_walks_mirrored_until_its_state_changes():
    states = {
        "east": {
            "start": 1,
            "on": {"ground": {"move": [1, 0.1]}, "wall": {"next": "east too", "move": [1, 0]}},
        },
        "east too": {"on": {"*": {"move": [1, 0]}}},
    }
    machine = machine_of(states, "reflect")
    world = LabelMap(np.array([[0, 1, 0, 0]], np.uint8), Area(0, 0, 4, 4))
    crowd = crowd_at([(2.6, 0.5, 0)])
    seen = []
    for _ in range(8):
        crowd = step(crowd, machine, world, 0.5)
        seen.append((crowd.x[0], int(crowd.state[0]), int(crowd.mirror[0])))
    # to the edge at 4 m, mirrored back to the label at 2 m and on to the step's end, then east as
    # the table says
    expected = [
        (3.1, 0, 0),
        (3.6, 0, 0),
        (3.9, 0, 1),
        (3.4, 0, 1),
        (2.9, 0, 1),
        (2.4, 0, 1),
        (1.9, 1, 0),
        (2.4, 1, 0),
    ]
    assert seen == [(pytest.approx(x), state, mirror) for x, state, mirror in expected]
    assert crowd.heading[0] == 0


def test_time_passes_for_an_agent_that_is_sent_to_and_fro():
    states = {
        "a": {**TO_AND_FRO["a"], "after": 1, "then": "off"},
        "off": {"on": {"*": {"move": [0, 1]}}},
    }
    machine = machine_of(states)
    world = LabelMap(np.array([[0, 1]], np.uint8), Area(0, 0, 2, 1))
    crowd = dataclasses.replace(crowd_at([(0.75, 0.25, 0)]), wait=np.ones(1))
    for _ in range(6):
        crowd = step(crowd, machine, world, 0.25)
    assert crowd.state[0] == 1 and crowd.y[0] == pytest.approx(0.75)


def test_an_agent_takes_52_bytes_at_most():
    crowd = lively().at(50)
    assert sum(column.nbytes for column in crowd.columns.values()) <= 52 * len(crowd)


def test_before_the_first_frame_the_crowd_stands():
    asked = trajectory()
    assert same(asked.at(-50), asked.start) and same(asked.at(10), asked.start)


def test_sub_frames_lie_between_their_frames():
    asked = trajectory()
    a = asked.at(20)
    b = asked.at(20.25)
    c = asked.at(21)
    np.testing.assert_allclose(b.x - a.x, (c.x - a.x) / 4, atol=1e-12)


def test_agents_stand_on_the_height_map_wherever_they_walk():
    area = Area(-3, 5, 23, 14, 2.0)
    heights = HeightMap(np.random.default_rng(1).normal(size=(6, 8)).astype(np.float32), area)
    flat = lively()
    hilly = lively(heights=heights)
    for time in (0, 30, 30.5):
        a = flat.at(time)
        b = hilly.at(time)
        assert (a.x == b.x).all() and (b.z == heights.at(b.x, b.y)).all() and b.z.std() > 0.1
