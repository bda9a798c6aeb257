import dataclasses
import json

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.agents import populate
from crowd_lod_extension.crowd_lod.behaviour import Trajectory, cycles_of, step
from crowd_lod_extension.crowd_lod.machine import load_preset, parse
from crowd_lod_extension.crowd_lod.maps import Area, LabelMap, edge_map

from .crowds import crowd_at, walker

CYCLES = cycles_of((walker(),))


def machine_of(states, edge="clamp", labels=("ground", "wall")):
    colours = {name: {"color": f"#0000{i:02x}"} for i, name in enumerate(labels)}
    return parse(json.dumps({"version": 1, "edge": edge, "labels": colours, "states": states}), "test")


def test_one_step_is_listing_1_1_agent_by_agent():
    machine = load_preset("plaza")
    random = np.random.default_rng(5)
    labels = random.integers(len(machine.labels), size=(40, 40)).astype(np.uint8)
    world = LabelMap(labels, Area(0, 0, 20, 20))
    crowd = populate(2000, 3, 1, machine, world)
    after = step(crowd, machine, world, CYCLES, 1 / 24)
    for i in range(len(crowd)):
        s, label = crowd.state[i], labels[int(crowd.y[i] / 0.5), int(crowd.x[i] / 0.5)]
        dx, dy = machine.velocity[s, label]
        assert after.state[i] == machine.next_state[s, label]
        assert after.x[i] == np.clip(crowd.x[i] + dx * (1 / 24), 0, 20)
        assert after.y[i] == np.clip(crowd.y[i] + dy * (1 / 24), 0, 20)


def test_chapter_walks_right_to_the_edge_turns_and_walks_left():
    machine = load_preset("chapter")
    world = edge_map(Area(0, 0, 64, 1), machine.labels)
    crowd = crowd_at([(60.0, 0.5, 0)])
    xs, states = [], []
    for _ in range(24 * 120):
        crowd = step(crowd, machine, world, CYCLES, 1 / 24)
        xs.append(crowd.x[0])
        states.append(crowd.state[0])
    assert 63 <= max(xs) <= 63 + 1.25 / 24 and 1 - 1.25 / 24 <= min(xs) <= 1
    turns = np.flatnonzero(np.diff(states))
    assert len(turns) == 3  # right edge, left edge, right edge, in 120 s
    # from the right edge's border to the left edge's border: 62 m at 1.25 m/s, to within two steps
    assert (abs(np.diff(turns) / 24 - 62 / 1.25) <= 2 / 24).all()


def test_fast_agents_do_not_jump_over_a_wall_and_slow_ones_take_one_step():
    machine = machine_of({"run": {"on": {"*": {"move": [90, 0]}, "wall": {"next": "stand"}}}, "stand": {"on": {"*": {}}}})
    labels = np.zeros((1, 100), np.uint8)
    labels[0, 50] = 1
    world = LabelMap(labels, Area(0, 0, 100, 1))
    for x in np.linspace(0.01, 49.99, 97):
        crowd = step(crowd_at([(x, 0.5, 0)]), machine, world, CYCLES, 1.0)
        assert 50 <= crowd.x[0] < 51 and crowd.state[0] == 1


EDGES = {"clamp": (10.0, 0.0), "wrap": (0.5, 9.5), "reflect": (9.5, 0.5), "stop": (9.75, 0.25)}


@pytest.mark.parametrize("edge", EDGES)
def test_edge_policies(edge):
    for speed, x in ((0.75, 9.75), (-0.75, 0.25)):
        machine = machine_of({"go": {"on": {"*": {"move": [speed, 0]}}}}, edge, ("ground",))
        world = LabelMap(np.zeros((1, 1), np.uint8), Area(0, 0, 10, 1))
        crowd = step(crowd_at([(x, 0.5, 0)]), machine, world, CYCLES, 1.0)
        assert crowd.x[0] == pytest.approx(EDGES[edge][0 if speed > 0 else 1], abs=1e-12)


def test_phase_advances_with_the_ground_walked():
    machine = machine_of({"go": {"on": {"*": {"move": [0.75, 1.0]}}}})
    world = LabelMap(np.zeros((1, 1), np.uint8), Area(0, 0, 1000, 1000))
    crowd = crowd_at([(1.0, 1.0, 0)])
    for _ in range(40):
        crowd = step(crowd, machine, world, CYCLES, 0.1)
    # 4 s at 1.25 m/s are 5 m, 4 strides of 1.25 m; and 0.1 of a stride more
    crowd = step(crowd, machine, world, CYCLES, 0.1)
    assert crowd.phase[0] == pytest.approx(0.1, abs=1e-5)
    assert crowd.heading[0] == pytest.approx(np.arctan2(1.0, 0.75))


def trajectory(seed=1):
    machine = load_preset("chapter")
    world = edge_map(Area(0, 0, 30, 30), machine.labels)
    return Trajectory(populate(500, seed, 1, machine, world), machine, world, (walker(),), 1 / 24, 10, every=8)


def same(a, b):
    return all(getattr(a, f.name).tobytes() == getattr(b, f.name).tobytes() for f in dataclasses.fields(a))


def test_trajectory_does_not_depend_on_the_order_of_frames():
    times = [100, 10, 55.5, 12.25, 99, 55, 100, 3, 11, 55.5]
    asked = trajectory()
    for time in times:
        assert same(asked.at(time), trajectory().at(time)), time


def test_before_the_first_frame_the_crowd_stands():
    asked = trajectory()
    assert same(asked.at(-50), asked.start) and same(asked.at(10), asked.start)


def test_sub_frames_lie_between_their_frames():
    asked = trajectory()
    a, b, c = asked.at(20), asked.at(20.25), asked.at(21)
    np.testing.assert_allclose(b.x - a.x, (c.x - a.x) / 4, atol=1e-12)
