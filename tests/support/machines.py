"""State machines and maps, also random ones."""

import json

import numpy as np
from crowd_lod_extension.crowd_lod.crowd.state_machine import parse
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap

# States that draw, wait and turn.
LIVELY = {
    "walk": {
        "start": 1, "after": [0.3, 2], "then": {"rest": 1, "walk": 1, "run": 1},
        "on": {"ground": {"move": [1.1, 0.3]}, "wall": {"next": {"back": 2, "walk": 1}, "move": [0.2, 0.1]}},
    },
    "run": {"after": 1.5, "then": "walk", "on": {"*": {"move": [-3, 2]}, "wall": {"next": "rest"}}},
    "back": {"on": {"*": {"move": [-1.3, -0.9]}, "wall": {"next": {"walk": 1, "run": 1}, "move": [-2, 0]}}},
    "rest": {"after": [0.2, 0.9], "then": "walk", "on": {"*": {}}},
}  # fmt: skip


def machine_of(states, edge="clamp", labels=("ground", "wall")):
    colors = {name: {"color": f"#0000{i:02x}"} for i, name in enumerate(labels)}
    return parse(
        json.dumps({"version": 1, "edge": edge, "labels": colors, "states": states}), "test"
    )


def random_machine(random, states=5, labels=3, speeds=(0.01, 30), edge="clamp"):
    """Any table at all: speeds of any size, the state changes on one label in two."""
    names = [f"s{i}" for i in range(states)]
    label_names = [f"l{i}" for i in range(labels)]

    def rule():
        speed = 10 ** random.uniform(*np.log10(speeds))
        where = {"next": names[random.integers(states)]} if random.random() < 0.5 else {}
        return {"speed": speed, "heading": random.uniform(0, 360), **where}

    return machine_of(
        {s: {"on": {label: rule() for label in label_names}} for s in names}, edge, label_names
    )


def random_world(random, labels=3, rows=9, columns=13, area=None):
    return LabelMap(
        random.integers(labels, size=(rows, columns)).astype(np.uint8), area or Area(-3, 5, 23, 14)
    )


def mirrored(value, low, high):
    """`value` on a line folded at low and high, and whether the number of folds is odd."""
    turns = np.floor((value - low) / (high - low))
    offset = value - low - turns * (high - low)
    return np.where(turns % 2, high - offset, low + offset), turns % 2 == 1


TO_AND_FRO = {"a": {"on": {"ground": {"move": [1, 0]}, "wall": {"move": [-1, 0]}}}}


def same(a, b):
    return all(column.tobytes() == b.columns[name].tobytes() for name, column in a.columns.items())
