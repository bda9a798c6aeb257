"""The two eyes of Blender's stereo cameras.

Source: BKE_camera_multiview_model_matrix, camera_stereo3d_shift_x.
"""

from dataclasses import dataclass, replace

import numpy as np

from .camera import Camera

EYES = ("left", "right")


@dataclass(frozen=True)
class Stereo:
    """The stereo settings of a Blender camera.

    mode: OFFAXIS, PARALLEL or TOE.
    pivot: LEFT, RIGHT or CENTER.
    distance: meters between the eyes.
    convergence: meters to the plane where their images meet.
    """

    mode: str
    pivot: str
    distance: float
    convergence: float


def eye(matrix: np.ndarray, stereo: Stereo, side: str) -> tuple[np.ndarray, float]:
    """Return (world matrix (4, 4), slope) of one eye of a stereo camera.

    matrix: (4, 4), the camera's world matrix.
    side: left or right.

    Blender adds slope x lens / sensor width to the eye's lens shift in x.
    """
    if stereo.pivot == side.upper():
        return matrix, 0.0
    sign = 1.0 if side == "left" else -1.0
    offset = sign * stereo.distance * (0.5 if stereo.pivot == "CENTER" else 1.0)
    base = np.array(matrix, np.float64)
    base[:3, :3] /= np.linalg.norm(base[:3, :3], axis=0)
    move = np.eye(4)
    move[0, 3] = -offset
    if stereo.mode != "TOE":
        return base @ move, offset / stereo.convergence if stereo.mode == "OFFAXIS" else 0.0
    angle = sign * np.arctan(stereo.distance / 2 / stereo.convergence)
    turn = np.eye(4)
    turn[[0, 0, 2, 2], [0, 2, 0, 2]] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
    return (base @ move @ turn if stereo.pivot == "CENTER" else base @ turn @ move @ turn), 0.0


def spherical(camera: Camera, stereo: Stereo) -> Camera:
    """Return one camera that sees all that both eyes of Cycles' spherical stereo see.

    Conservative. Every ray starts half the eye distance aside, and turns in to meet that of the
    other eye at the convergence distance.
    """
    aside = stereo.distance / 2
    if stereo.mode == "PARALLEL":
        return replace(camera, pad=camera.pad + aside)
    inward = np.arcsin(min(1.0, aside / stereo.convergence)) if stereo.convergence > 0 else np.pi
    return replace(camera, pad=camera.pad + aside, turn=camera.turn + float(inward))
