"""View-frustum culling: the radar test (chapter eqs 1.4 to 1.6, listing 1.2)."""

import numpy as np

from .agents import Crowd
from .camera import Camera, side_planes

# Agents a block: its few float64 columns stay in the processor's cache.
BLOCK = 16_384
# Bound on the relative rounding of the projections in float64; widens the test so that rounding never drops an agent.
ROUNDING = 16 * np.finfo(np.float64).eps


def radar(
    crowd: Crowd, camera: Camera, centre: np.ndarray, radius: np.ndarray, margin: float | None = None, radial: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """(visible, distance): which agents the camera may see, and how far away they are.

    centre, radius: (G,) float64, each group's bounding sphere: height of its centre above the feet, radius, metres.
    margin: None derives the chapter's widening from the sphere, which is then visible iff it lies in or touches all
    six planes (Delta = r / cos(fov / 2) at the sides, r at near and far); a number is the chapter's fixed Delta in
    metres, at the sides alone. A panoramic camera keeps all within its clip range.

    visible: (n,) bool. distance: (n,) float64, metres from the camera to the sphere's centre: v.Z along the view, or
    |v| with `radial` and for panoramic cameras. Agents exactly on a plane are visible. Positions relative to the
    camera are formed in float64.
    """
    count = len(crowd)
    visible, distance = np.empty(count, bool), np.empty(count)
    planes = side_planes(camera)
    radial = radial or camera.kind == "PANO"
    for begin in range(0, count, BLOCK):
        block = slice(begin, begin + BLOCK)
        group = crowd.group[block]
        vx, vy = crowd.x[block] - camera.origin[0], crowd.y[block] - camera.origin[1]
        vz = crowd.z[block] + centre[group] - camera.origin[2]
        reach = radius[group] if margin is None else 0.0
        slack = ROUNDING * (np.abs(vx) + np.abs(vy) + np.abs(vz) + np.abs(camera.origin).sum())
        depth = vx * camera.Z[0] + vy * camera.Z[1] + vz * camera.Z[2]
        range_ = np.sqrt(vx * vx + vy * vy + vz * vz) if radial else depth
        distance[block] = range_
        along = range_ if camera.kind == "PANO" else depth
        inside = (along >= camera.near - reach - slack) & (along <= camera.far + reach + slack)
        if camera.kind != "PANO":
            right = vx * camera.X[0] + vy * camera.X[1] + vz * camera.X[2]
            up = vx * camera.Y[0] + vy * camera.Y[1] + vz * camera.Y[2]
            for x, y, z, offset in planes:
                across = x * right if x else y * up
                widening = reach if margin is None else margin * abs(x + y)
                inside &= across + z * depth <= offset + widening + slack
        visible[block] = inside
    return visible, distance
