"""The camera's referential and window (chapter eqs 1.1 to 1.3, 1.5, 1.6), for Blender's kinds of camera."""

from dataclasses import dataclass

import numpy as np

from .errors import CrowdError


@dataclass(frozen=True)
class Window:
    """What the image shows of the plane one metre ahead (perspective: slopes, tan of the half angles) or of any plane
    across the view (orthographic: metres), along the camera's X (left, right) and Y (bottom, top)."""

    left: float
    right: float
    bottom: float
    top: float


@dataclass(frozen=True)
class Camera:
    """A camera at one time.

    kind: "PERSP", "ORTHO" or "PANO" (sees in every direction). origin: (3,) float64, world metres, the chapter's c.
    X (right), Y (up), Z (view direction): (3,) float64 unit vectors, mutually orthogonal. near, far: metres along Z
    (PANO: from the origin). pixels: (width, height) of the image.
    """

    kind: str
    origin: np.ndarray
    X: np.ndarray
    Y: np.ndarray
    Z: np.ndarray
    window: Window
    near: float
    far: float
    pixels: tuple[int, int]


def referential(matrix: np.ndarray, name: str = "camera") -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(origin, X, Y, Z), each (3,) float64, of a camera with the world matrix (4, 4), which looks along its own -z.

    Scale and shear of parents are removed: the columns are normalised, as Blender's renderer does, then X and Y are
    made orthogonal to the view. A mirrored camera keeps its mirrored X.
    """
    matrix = np.asarray(matrix, np.float64)
    if not np.isfinite(matrix).all():
        raise CrowdError(f"The camera {name} stands at NaN or infinity: set its transform to finite values.")
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not lengths.all():
        raise CrowdError(f"The camera {name}, or a parent of it, is scaled to 0: set its scale to another value.")
    right, up, back = (matrix[:3, :3] / lengths).T
    Z = -back
    X = right - (right @ Z) * Z
    Y = up - (up @ Z) * Z - (up @ X) * X / (X @ X)
    if min(X @ X, Y @ Y) < 1e-12:
        raise CrowdError(f"The camera {name} is sheared flat by a parent: clear the parent's scale.")
    return matrix[:3, 3].copy(), X / np.linalg.norm(X), Y / np.linalg.norm(Y), Z


def window(
    size: float,
    fit: str,
    pixels: tuple[int, int],
    aspect: tuple[float, float] = (1.0, 1.0),
    shift: tuple[float, float] = (0.0, 0.0),
) -> Window:
    """The window of a Blender camera.

    size: extent of the fitted side: sensor / lens (perspective; sensor_height for VERTICAL fit, else sensor_width) or
    the orthographic scale in metres. fit: AUTO, HORIZONTAL or VERTICAL. pixels: image width and height. aspect: pixel
    aspect x, y. shift: lens shift in parts of the fitted side. Source: Blender's BKE_camera_params_compute_viewplane.
    """
    width, height = pixels[0] * aspect[0], pixels[1] * aspect[1]
    horizontal = fit == "HORIZONTAL" or (fit == "AUTO" and width >= height)
    unit = size / (width if horizontal else height)
    half_x, half_y = width * unit / 2, height * unit / 2
    return Window(shift[0] * size - half_x, shift[0] * size + half_x, shift[1] * size - half_y, shift[1] * size + half_y)


def side_planes(camera: Camera) -> tuple[tuple[float, float, float, float], ...]:
    """The window's four sides, right, left, top, bottom, as (x, y, z, offset): a point with camera coordinates v (along
    X, Y, Z) lies inside iff x v.X + y v.Y + z v.Z <= offset; (x, y, z) is a unit vector, offset in metres."""
    w = camera.window
    sides = ((1.0, 0.0, w.right), (-1.0, 0.0, -w.left), (0.0, 1.0, w.top), (0.0, -1.0, -w.bottom))
    if camera.kind == "ORTHO":
        return tuple((x, y, 0.0, edge) for x, y, edge in sides)
    # sin and cos of the side's angle, written so that a field of view near 180 degrees stays finite
    return tuple((x / np.hypot(1, t), y / np.hypot(1, t), -t / np.hypot(1, t), 0.0) for x, y, t in sides)


def frustum_corners(camera: Camera, distance: float) -> np.ndarray:
    """World positions (4, 3) of the window's corners at `distance` metres along the view, around from left bottom."""
    w = camera.window
    at = 1.0 if camera.kind == "ORTHO" else distance
    corners = [(w.left, w.bottom), (w.right, w.bottom), (w.right, w.top), (w.left, w.top)]
    return np.array([camera.origin + distance * camera.Z + at * (x * camera.X + y * camera.Y) for x, y in corners])
