"""Small crowds that walk, stand, or do as a random table says."""

import json
from copy import copy
from dataclasses import replace
from unittest.mock import patch

import numpy as np
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset, parse
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.world import morton_order
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap, edge_map

from .crowds import walker

POLICY = LevelPolicy((0.3, 0.6))


ONE = (walker(),)


AREA = Area(-40, 0, 40, 100)


IDLER = replace(walker(), stride=0.0, period=1.7, center=1.1, radius=0.7)


def machine(states=None, edge="clamp"):
    """Two labels, ground and wall. states: all else; standing if not given."""
    labels = {"ground": {"color": "#808080"}, "wall": {"color": "#202020", "spawn": False}}
    states = states or {"stand": {"color": "#ff0000", "on": {"*": {}}}}
    return parse(
        json.dumps({"version": 1, "edge": edge, "labels": labels, "states": states}), "test"
    )


def chapter(area):
    """The state machine of the thesis' chapter, and the map of an area at whose edges it turns."""
    table = load_preset("chapter")
    return table, edge_map(area, table.labels)


def walking(edge="clamp", turn="on"):
    """Who comes to a wall turns round."""
    wall = {"next": "back" if turn else "on", "move": [-1.5, 0.5]}
    on = {"color": "#ff0000", "start": 1, "on": {"*": {"move": [1.5, 0.25]}, "wall": wall}}
    return machine({"on": on, "back": {"color": "#00ff00", "on": {"*": {"move": [-1.5, 0]}}}}, edge)


def ground(walls=(), shape=(7, 9)):
    labels = np.zeros(shape, np.uint8)
    for place in walls:
        labels[place] = 1
    return LabelMap(labels, AREA)


def shot(table=None, world=None, groups=ONE, count=400, seed=3, **more):
    table = table or machine()
    world = world or ground()
    return Walk(
        populate(count, seed, len(groups), table, world), table, world, groups, 1 / 24, **more
    )


def every_step(walk):
    """The same walk, which takes each step although nobody moves."""
    other = replace(walk)
    other.still = False
    return other


def full_plan(trajectory, *arguments):
    """The plan by a radar test of every agent, which holds no plan made before."""
    other = copy(trajectory)
    other.still = other.stays = False
    with patch.object(morton_order, "FEWEST", len(trajectory.start) + 1):
        return plan(other, *arguments)


def raw(frame):
    """All that a frame says of the crowd, as bytes."""
    return *known(frame), frame.buckets.order.tobytes()


def known(frame):
    """All that a frame says of the crowd but for the order in its buckets, as bytes."""
    crowd = [column.tobytes() for column in frame.crowd.columns.values()]
    members = [np.sort(frame.buckets[level]) for level in range(len(frame.buckets.counts))]
    seen = [a.tobytes() for a in (frame.visible, frame.levels, *members, frame.buckets.offsets)]
    kinds = [
        str(a.dtype)
        for a in (frame.visible, frame.levels, frame.buckets.order, frame.buckets.offsets)
    ]
    return (
        crowd,
        seen,
        kinds,
        frame.vertices,
        frame.triangles,
        frame.full_vertices,
        frame.full_triangles,
        frame.dropped,
    )
