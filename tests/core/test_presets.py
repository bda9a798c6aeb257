"""The presets on maps that mean what their labels say."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.exact_walk import trouble
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap

from ..support.crowds import walker


def painted(machine, rows, columns, *strokes):
    """(label, row slice, column slice) each, on ground of the first label."""
    labels = np.zeros((rows, columns), np.uint8)
    for label, row, column in strokes:
        labels[row, column] = machine.labels.index(label)
    return LabelMap(labels, Area(0, 0, columns / 2, rows / 2))


ALL = slice(None)
RIM = ((0, slice(None)), (-1, slice(None)), (slice(None), 0), (slice(None), -1))


def market(machine):
    halls = [
        ("stall", slice(r, r + 6), slice(c, c + 10))
        for r in range(10, 60, 16)
        for c in range(10, 80, 20)
    ]
    fronts = [("stall front", slice(r.start - 2, r.stop + 2), c) for _, r, c in halls]
    lanes = [
        ("crossing", slice(r - 2, r + 2), slice(c - 2, c + 2))
        for r in range(6, 60, 16)
        for c in range(6, 80, 20)
    ]
    return painted(machine, 64, 84, *lanes, *fronts, *halls, *[("wall", *rim) for rim in RIM])


def evacuation(machine):
    signs = [
        ("sign east", slice(28, 32), slice(0, 70)),
        ("sign south", slice(52, 59), ALL),
        ("sign north", slice(1, 8), ALL),
    ]
    walls = [("wall", slice(12, 26), 30), ("wall", slice(34, 50), 50), ("wall", 34, slice(20, 30))]
    walls += [("wall", *rim) for rim in RIM]
    return painted(
        machine,
        60,
        80,
        *signs,
        *walls,
        ("fire", slice(16, 18), slice(60, 62)),
        ("exit", slice(20, 40), slice(70, 80)),
    )


def concourse(machine):
    rows = [("row", slice(r, r + 2), ALL) for r in range(12, 60, 4)] + [
        ("seat", r, ALL) for r in range(13, 60, 4)
    ]
    aisles = [("aisle", slice(6, 60), slice(c, c + 4)) for c in (10, 40, 70)]
    return painted(machine, 64, 84, *rows, *aisles, ("top", slice(60, 64), ALL), ("pitch", slice(0, 2), ALL),
                   ("wall", ALL, 0), ("wall", ALL, -1))  # fmt: skip


CLOSED = {"market": ("wall", "stall"), "evacuation": ("wall",), "concourse": ("wall", "pitch")}


@pytest.mark.once
@pytest.mark.parametrize("make", [market, evacuation, concourse])
def test_agents_keep_out_of_walls_and_out_of_trouble(make):
    machine = load_preset(make.__name__)
    world = make(machine)
    trajectory = Walk(populate(1000, 4, 1, machine, world), machine, world, (walker(),), 1 / 12)
    closed = [machine.labels.index(label) for label in CLOSED[machine.name]]
    states = []
    for frame in range(1, 720, 30):
        crowd = trajectory.at(frame)
        states.append(np.bincount(crowd.state, minlength=len(machine.states)))
        inside = np.isin(world.at(crowd.x, crowd.y), closed)
        # an agent that has just come to a wall is on its very border
        column, row = world.cells(crowd.x[inside], crowd.y[inside])
        depth = [
            np.minimum(p / 0.5 - i, i + 1 - p / 0.5)
            for p, i in ((crowd.x[inside], column), (crowd.y[inside], row))
        ]
        assert np.min(depth, axis=0).max(initial=0) < 1e-9
    assert (np.array(states)[5:].sum(axis=0) > 0).all()  # every state is lived
    assert trouble(crowd, machine, world, 20.0) == ()
    if machine.name == "evacuation":
        assert states[-1][machine.states.index("safe")] > 500


def test_an_audience_stays_and_cheers_where_it_is_lively():
    machine = load_preset("audience")
    world = painted(machine, 10, 30, ("lively", ALL, slice(10, 20)), ("quiet", ALL, slice(20, 30)))
    start = populate(3000, 2, 1, machine, world)
    label = world.at(start.x, start.y)
    trajectory = Walk(start, machine, world, (walker(),), 1 / 6)
    cheers = np.zeros(3000)
    for frame in range(121, 721, 20):
        crowd = trajectory.at(frame)
        assert (crowd.x == start.x).all() and (crowd.heading == start.heading).all()
        cheers += crowd.state == machine.states.index("cheer")
    seats, lively, quiet = (cheers[label == k].mean() / 30 for k in range(3))
    assert abs(seats - 1 / 6) < 0.02 and abs(lively - 2 / 3) < 0.05 and quiet == 0


def test_a_sign_that_leads_into_a_wall_is_found():
    machine = load_preset("evacuation")
    world = painted(machine, 20, 20, ("sign north", slice(5, 15), ALL), ("wall", 15, ALL))
    crowd = populate(300, 1, 1, machine, world)
    (found,) = (each for each in trouble(crowd, machine, world, 60.0) if each.kind == "chatters")
    assert len(found.agents) > 100 and set(found.row) <= {14, 15}
