"""Cameras of an open shutter: what one sees while it moves."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .camera import Camera
from .frustum import frustum_of


def open_shutter(samples: Sequence[Camera]) -> tuple[Camera, ...]:
    """Return the cameras of an open shutter, each with its spheres grown.

    samples: one camera at consecutive times. Spheres grow by as much as the camera moves to the
        sample before or after.

    Whatever the camera sees at any time between two samples, one of these two then sees, if the
    camera moves on between them without turning back. From n . (p - c) <= offset + r: a plane's
    normal that turns by dn moves by |dn| |v|, the origin by |dc|, the offset by itself.
    """
    moves = [
        (0.0, 0.0),
        *(_change(a, b) for a, b in zip(samples[:-1], samples[1:], strict=True)),
        (0.0, 0.0),
    ]
    return tuple(
        replace(
            camera,
            pad=camera.pad + max(before[0], after[0]),
            turn=camera.turn + max(before[1], after[1]),
        )
        for camera, before, after in zip(samples, moves[:-1], moves[1:], strict=True)
    )


def differs(planned: Camera, window: Camera) -> bool:
    """Return whether two cameras differ by more than rounding.

    planned: a sample of `open_shutter`.
    window: the camera as it is.
    """
    if planned.kind != window.kind:
        return True
    moved, turned = _change(planned, window)
    rounding = 1e-5 * (1 + np.abs(window.origin).max())  # float32's, and that of sub-frames
    return moved > rounding + 1e-3 * planned.pad or turned > 1e-5 + 1e-3 * planned.turn


def _change(a: Camera, b: Camera) -> tuple[float, float]:
    """Return how far the view's bounds move from camera a to b.

    Returns (meters, meters per meter of distance).
    """
    moved = float(np.linalg.norm(b.origin - a.origin))
    if a.kind == "PANO" or b.kind == "PANO":
        clip = max(abs(b.near - a.near), abs(b.far - a.far))
        return moved + clip, float(np.linalg.norm(b.Z - a.Z)) + abs(b.cone - a.cone)
    first = frustum_of(a)
    two = frustum_of(b)
    return (
        moved + float(np.abs(two.offsets - first.offsets).max()),
        float(np.linalg.norm(two.normals - first.normals, axis=1).max()),
    )
