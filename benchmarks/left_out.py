"""What leaving out saves, case by case.

Prints milliseconds of a whole frame in full and lean.

python benchmarks/left_out.py [AGENTS]    1,000,000 if not given
"""

import sys

import numpy as np
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.agents import Group, populate
from crowd_lod_extension.crowd_lod.crowd.maps import Area, edge_map
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset, parse
from crowd_lod_extension.crowd_lod.culling.camera import Camera, Window
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.validation.leave_out_timing import savings

STAND = '{"version": 1, "labels": {"ground": {"color": "#808080"}}, "states": {"stand": {"color": "#ff0000", "on": {"*": {}}}}}'
WALK = STAND.replace('{"*": {}}', '{"*": {"move": [1.25, 0.5]}}').replace('"labels"', '"edge": "wrap", "labels"')


def camera(origin: tuple, pitch: float, half: float, far: float) -> Camera:
    """At `origin`, meters, looking along +y and `pitch` radians down."""
    X, c, s = np.array([1.0, 0, 0]), np.cos(pitch), np.sin(pitch)
    Y, Z = np.array([0, s, c]), np.array([0, c, -s])
    return Camera("PERSP", np.array(origin, float), X, Y, Z, Window(-half, half, -half, half), 0.1, far, (1920, 1080))


def main(agents: int) -> None:
    walker = Group("walker", 0.9, 1.0, 1.25, 1.0, (1000, 400, 120), (2000, 800, 240))
    area, three = Area(-200, -200, 200, 200), LevelPolicy((0.2, 0.6))
    some, all_, none = (
        camera((0, -210, 60), 0.2, 0.5, 400),
        camera((0, -300, 150), 0.4, 4.0, 700),
        camera((0, 300, 60), 0, 0.5, 400),
    )
    chapter, walk, stand = load_preset("chapter"), parse(WALK, "walk"), parse(STAND, "stand")
    cases = {
        "three groups, some visible": (chapter, 3, some, three),
        "one group": (chapter, 1, some, three),
        "one label": (walk, 3, some, three),
        "all inside, three groups": (chapter, 3, all_, three),
        "all inside, one LOD": (chapter, 3, all_, LevelPolicy(())),
        "all outside, three LODs": (chapter, 3, none, three),
        "one LOD": (chapter, 3, some, LevelPolicy(())),
        "nobody moves": (stand, 3, some, three),
    }
    for case, (machine, groups, view, policy) in cases.items():
        world = edge_map(area, machine.labels)
        crowd = populate(agents, 1, groups, machine, world)
        trajectory = Walk(crowd, machine, world, (walker,) * groups, 1 / 24)
        result = savings(trajectory, view, policy, 2, repeats=7)
        print(f"{case:28} full {result.full:8.2f} ms  lean {result.lean:8.2f} ms  x{result.full / result.lean:.2f}")
        for item, saved in result.items.items():
            print(f"    {item.stage:10} {saved:8.2f} ms ± {result.spread[item]:.2f}  {item.reason}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
