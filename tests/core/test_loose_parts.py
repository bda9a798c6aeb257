"""Loose parts do not starve the body that they are on."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.mesh import Mesh
from crowd_lod_extension.crowd_lod.simplification.decimate import decimate
from crowd_lod_extension.crowd_lod.simplification.pose_deformation import Skin, frames_of

from ..support.bodies import drum

pytestmark = pytest.mark.once

pytest.importorskip("fast_simplification")


def toothy(count=60):
    """A body of 1 m with a tail of 0.5 m, and loose teeth of 30 mm at its front."""
    body, faces = drum(16, 60)
    along = (body[:, 2] - body[:, 2].min()) / np.ptp(body[:, 2])
    width = np.where(
        along < 1 / 3,
        0.02 + 0.1 * along,
        np.sqrt(np.maximum(1 - (3 * along - 2) ** 2, 0.06)) * 0.25,
    )
    points = [np.column_stack([body[:, :2] * width[:, None], 1.5 * along])]
    triangles = [faces]
    tooth, faces = drum(8, 4)
    tooth = tooth / np.ptp(tooth, axis=0) * (0.012, 0.012, 0.03)
    for k in range(count):
        turn = k * 2.4
        points.append(tooth + (0.2 * np.cos(turn), 0.2 * np.sin(turn), 1.1 + 0.2 * k / count))
        triangles.append(faces + sum(map(len, points[:-1])))
    return np.concatenate(points), np.concatenate(triangles)


def swung(points, triangles):
    """The skin of a tail that swings to one side."""
    place = points.copy()
    place[:, 0] += np.maximum(0.5 - points[:, 2], 0) ** 2
    place = place[None]
    return Skin(points, place, frames_of(points, place, triangles))


@pytest.mark.parametrize("moves", [False, True])
def test_a_tail_stays_beside_more_teeth_than_there_are_triangles_for(moves):
    points, triangles = toothy()
    skin = swung(points, triangles) if moves else None
    lod = decimate(Mesh(points, triangles), 150 / len(triangles), "toothy", skin=skin, effort=0.2)
    assert 100 < len(lod.triangles) <= 150
    tip = points[points[:, 2].argmin()]
    assert np.linalg.norm(lod.points - tip, axis=1).min() < 0.06
    assert (lod.source < len(drum(16, 60)[0])).sum() > 15


def test_copies_of_a_body_in_one_place_both_stay():
    body, faces = drum(16, 20)
    points = np.concatenate([body, body])
    triangles = np.concatenate([faces, faces[:, ::-1] + len(body)])
    lod = decimate(Mesh(points, triangles), 0.1, "doubled", effort=0.1)
    assert len(np.unique(lod.source // len(body))) == 2
