"""For a LOD's picture: where it deviates most in one pose, and what of its character is hidden."""

from dataclasses import dataclass

import numpy as np

from .posed_shapes import PosedMesh
from .posed_surface import PosedSurface
from .surface import Surface, merge


@dataclass
class InPose:
    """A character and its LOD in one pose, world space.

    hidden: (m,) bool, the character's triangles that do not count.
    worst: (3,) meters, the place that is farthest from the other surface, of all that count.
    """

    character: Surface
    level: Surface
    hidden: np.ndarray
    worst: np.ndarray


def look_in_pose(whole: PosedSurface, character: PosedMesh, level: PosedMesh) -> InPose | None:
    """Compare a LOD with its character in one pose; None where one has no face.

    whole: the character in some pose, whose visible surface is known.
    """
    if len(character.points) != len(whole.shapes[0].points):
        whole = PosedSurface([character])
    merged = whole.at([character.points])
    other = merge([level.points], level.triangles)
    if merged is None or other is None:
        return None
    surfaces = [
        Surface(each.moving.points[:, 0], each.moving.triangles) for each in (merged, other)
    ]
    counted = merged.moving.counted
    near = counted[merged.moving.find(0, surfaces[1].points)]
    places = [
        _places(surfaces[0], counted),
        _places(surfaces[1], near[other.moving.triangles].any(axis=1)),
    ]
    away = np.concatenate([surfaces[1].distances(places[0]), surfaces[0].distances(places[1])])
    return InPose(*surfaces, ~counted, np.concatenate(places)[away.argmax()])


def _places(surface: Surface, faces: np.ndarray) -> np.ndarray:
    """Return corners and middles of the triangles `faces` (m,) bool, (k, 3) meters."""
    triangles = surface.triangles[faces]
    return np.concatenate(
        [surface.points[np.unique(triangles)], surface.points[triangles].mean(axis=1)]
    )
