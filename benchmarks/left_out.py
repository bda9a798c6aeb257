"""What leaving work out saves: for each part, the share of a frame that it would cost.

    python benchmarks/left_out.py [AGENTS]...    1000 10000 100000 1000000 if not given

Of each part the best of the scenes below counts. A part that saves less than a tenth of a frame, at
10,000 agents and at a million, is not worth a branch.
"""

import sys
from collections import defaultdict

import numpy as np
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.crowd.leave_outs import ALL, STATIC, LeftOut
from crowd_lod_extension.crowd_lod.crowd.state_machine import StateMachine, load_preset, parse
from crowd_lod_extension.crowd_lod.culling.camera import Camera, Window
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.sources.trajectory import Trajectory
from crowd_lod_extension.crowd_lod.validation.leave_out_timing import plan_leaving
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.maps import Area, edge_map

STAND = (
    '{"version": 1, "labels": {"ground": {"color": "#808080"}}, "states": {"stand": {"color": '
    '"#ff0000", "on": {"*": {}}}}}'
)
WALK = STAND.replace('{"*": {}}', '{"*": {"move": [1.25, 0.5]}}').replace(
    '"labels"', '"edge": "wrap", "labels"'
)
WALKER = Group("walker", 0.9, 1.0, 1.25, 1.0, (1000, 400, 120), (2000, 800, 240))
TIME = 4  # frame


def camera(origin: tuple[float, float, float], pitch: float, half: float, far: float) -> Camera:
    """Return a camera at `origin`, meters, that looks along +y and `pitch` radians down."""
    c = np.cos(pitch)
    s = np.sin(pitch)
    axes = np.array([[1, 0, 0], [0, s, c], [0, c, -s]])
    return Camera(
        "PERSP", np.array(origin), *axes, Window(-half, half, -half, half), 0.1, far, (1920, 1080)
    )


def scenes() -> dict[str, tuple[StateMachine, int, Camera, LevelPolicy]]:
    """Return the scenes: machine, number of groups, camera, policy."""
    chapter = load_preset("chapter")
    walk = parse(WALK, "walk")
    stand = parse(STAND, "stand")
    three = LevelPolicy((0.2, 0.6))
    one_lod = LevelPolicy(())
    part = camera((0.0, -210.0, 60.0), 0.2, 0.5, 400)
    whole = camera((0.0, -300.0, 150.0), 0.4, 4.0, 700)
    away = camera((0.0, 300.0, 60.0), 0.0, 0.5, 400)
    close = camera((0.0, -20.0, 2.0), 0.0, 0.3, 200)
    return {
        "three groups": (chapter, 3, part, three),
        "one group": (chapter, 1, part, three),
        "one label": (walk, 1, part, three),
        "all in the picture": (chapter, 1, whole, three),
        "all in the picture, one LOD": (chapter, 1, whole, one_lod),
        "nobody in the picture": (chapter, 1, away, three),
        "a tenth in the picture": (chapter, 1, close, three),
        "nobody moves": (stand, 1, part, three),
    }


def shares(
    trajectory: Trajectory, view: Camera, policy: LevelPolicy, repeats: int
) -> dict[LeftOut, float]:
    """Return the share of a frame that each part would cost."""
    items = sorted(
        set(plan_leaving(ALL, trajectory, view, policy, TIME).left_out) - {STATIC},
        key=lambda item: item.reason,
    )
    choices = [ALL, *(ALL - {item} for item in items)]
    took = np.array(
        [
            [
                sum(plan_leaving(leave, trajectory, view, policy, TIME).milliseconds.values())
                for leave in choices
            ]
            for _ in range(repeats)
        ]
    )
    least = took.min(axis=0)
    return {
        item: float(1 - least[0] / with_it) for item, with_it in zip(items, least[1:], strict=True)
    }


def main(counts: list[int]) -> None:
    best: dict[LeftOut, dict[int, tuple[float, str]]] = defaultdict(dict)
    for count in counts:
        for name, (machine, groups, view, policy) in scenes().items():
            world = edge_map(Area(-200, -200, 200, 200), machine.labels)
            crowd = populate(count, 1, groups, machine, world)
            trajectory = Walk(crowd, machine, world, (WALKER,) * groups, 1 / 24)
            for item, share in shares(
                trajectory, view, policy, 40 if count < 50_000 else 10
            ).items():
                best[item][count] = max(best[item].get(count, (-1.0, "")), (share, name))
    for item, by_count in best.items():
        print(f"{item.stage}: {item.reason}")
        for count, (share, name) in by_count.items():
            print(f"    {count:9,} agents {100 * share:5.1f} %  {name}")


if __name__ == "__main__":
    main([int(word) for word in sys.argv[1:]] or [1_000, 10_000, 100_000, 1_000_000])
