"""The state of a fit: a LOD, and the samples by which it is held against its source."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from .triangle_mesh import TriangleMesh

UNMEASURED: Any = None  # what SurfaceFit.measure is to fill


@dataclass(frozen=True)
class FitState:
    """A fit at one moment: a value, whose arrays are never written to.

    lod: the LOD, in all copies. worst: the largest distance of a sample from the other surface.

    k samples lie on the source. points: (3, k) their places; face (k,), weights (3, k): the closest
    points of the LOD; off: (3, k) from these to the samples, distance: (k,) its length; pull: (k,)
    their weights in the next move.

    j samples lie on the LOD. lod_face (j,), lod_weights (3, j): their places; source_face (j,),
    source_weights (3, j): the closest points of the source; lod_off: (3, j) from the samples to
    these, lod_distance: (j,) its length; lod_pull: (j,) as above.
    """

    lod: TriangleMesh
    points: np.ndarray
    face: np.ndarray
    weights: np.ndarray
    pull: np.ndarray
    lod_face: np.ndarray
    lod_weights: np.ndarray
    source_face: np.ndarray
    source_weights: np.ndarray
    lod_pull: np.ndarray
    off: np.ndarray = UNMEASURED
    distance: np.ndarray = UNMEASURED
    lod_off: np.ndarray = UNMEASURED
    lod_distance: np.ndarray = UNMEASURED
    worst: float = np.inf

    def errors(self) -> np.ndarray:
        """The worst distance at each face of the LOD, (m,)."""
        errors = np.zeros(self.lod.corners.shape[1])
        np.maximum.at(errors, self.face, self.distance)
        np.maximum.at(errors, self.lod_face, self.lod_distance)
        return errors

    def errors_around(self) -> np.ndarray:
        """The worst distance at each face of the LOD and the faces that share a vertex, (m,)."""
        worst = np.zeros(self.lod.points.shape[1])
        errors = self.errors()
        for corner in self.lod.corners:
            np.maximum.at(worst, corner, errors)
        return worst[self.lod.corners].max(axis=0)
