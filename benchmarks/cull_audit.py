"""The culling against exact arithmetic, for each lens, and the extreme cases.

    python benchmarks/cull_audit.py [PAIRS]

PAIRS: of camera and agent, over all lenses; 1,000,000 if not given.
"""

import sys
import time

import numpy as np
from crowd_lod_extension.crowd_lod.culling.camera import Camera, referential, window
from crowd_lod_extension.crowd_lod.validation.exact_frustum import (
    CullingJudgment,
    judge_culling,
    scatter,
)
from crowd_lod_extension.crowd_lod.validation.extreme_cases import table, table_text

# name: kind of camera, range of log10 of the fitted side (slope or meters), largest lens shift
LENSES = {
    "telephoto": ("PERSP", (-3.0, -1.0), 0.1),
    "normal": ("PERSP", (-1.0, 0.5), 0.1),
    "wide angle": ("PERSP", (0.5, 2.0), 0.1),
    "shifted": ("PERSP", (-1.0, 1.0), 3.0),
    "orthographic": ("ORTHO", (-1.0, 3.0), 1.0),
    "panoramic": ("PANO", (0.0, 0.0), 0.0),
    "sheared": ("PERSP", (-1.0, 0.5), 0.1),
    # its rays may see beyond the planes, so the culling keeps more
    "sheared, Cycles": ("PERSP", (-1.0, 0.5), 0.1),
}
AGENTS = 1000  # of each random camera


def random_camera(random, lens):
    """Return a camera with the lens `lens` of LENSES at a random place and rotation.

    Some cameras are mirrored.
    """
    kind, (low, high), shift = LENSES[lens]
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(random.normal(size=(3, 3)))[0]  # a rotation, mirrored or not
    if lens.startswith("sheared"):
        matrix[:3, :3] = np.diag(random.uniform(0.5, 2, 3)) @ matrix[:3, :3]
    matrix[:3, 3] = random.normal(size=3) * 10.0 ** random.uniform(-1, 4)
    width, height = random.integers(10, 4000, size=2).tolist()
    pixels = width, height
    fit = ("AUTO", "HORIZONTAL", "VERTICAL")[random.integers(3)]
    aspect = tuple(random.uniform(0.5, 2, 2))
    shifts = tuple(random.uniform(-shift, shift, 2))
    shape = window(10.0 ** random.uniform(low, high), fit, pixels, aspect, shifts)
    near = 10.0 ** random.uniform(-2, 0)
    return Camera(
        kind,
        *referential(matrix),
        shape,
        near,
        near + 10.0 ** random.uniform(0.5, 3),
        pixels,
        rays=lens.endswith("Cycles"),
    )


def audit(lens, pairs, on_planes=0.0):
    """Return the verdict on `pairs` random pairs of camera and agent.

    lens: one of LENSES.
    on_planes: the part of the agents within roundings of a plane.
    """
    return sum(_audits(lens, pairs, np.random.default_rng(0), on_planes), CullingJudgment())


def _audits(lens, pairs, random, on_planes):
    while pairs > 0:
        camera = random_camera(random, lens)
        count = min(pairs, AGENTS)
        radius = 10.0 ** random.uniform(-3, 1.5, 8)
        group = random.integers(len(radius), size=count, dtype=np.uint8)
        yield judge_culling(
            camera, scatter(camera, radius[group], random, on_planes), radius, group
        )
        pairs -= count


def main(pairs: int) -> None:
    print(
        "kept for nothing: surplus, of those kept, by the planes; beside, of those visible, "
        "misses the body at edges or corners"
    )
    print(
        f"{'lens':16} {'pairs':>9} {'visible':>9} {'missed':>6} {'surplus %':>9} {'beside %':>9} "
        f"{'seconds':>7}"
    )
    for lens in LENSES:
        started = time.perf_counter()
        v = audit(lens, -(-pairs // len(LENSES)))
        seconds = time.perf_counter() - started
        surplus = 100 * v.surplus / v.survivors
        beside = 100 * v.beside / v.visible
        print(
            f"{lens:16} {v.pairs:9,} {v.visible:9,} {v.missed:6} {surplus:9.4f} {beside:9.3f} "
            f"{seconds:7.1f}"
        )
    print("\nwithin roundings of a plane, one in two: decided by fractions where float64 cannot")
    for lens in LENSES:
        v = audit(lens, max(1, pairs // 100), on_planes=0.5)
        print(f"{lens:16} {v.pairs:9,} pairs, {v.doubtful:9,} by fractions, {v.missed} missed")
    print(
        "\nextremes (a quarter of the agents are put within roundings of a plane: those kept "
        "graze it; depth error as a part of its bound)"
    )
    print(table_text(list(table())))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
