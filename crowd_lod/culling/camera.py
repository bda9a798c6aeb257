"""Blender's cameras: axes and window (chapter eqs 1.1 to 1.3, 1.5, 1.6), the two eyes of stereo
cameras, and where a camera stands that frames a crowd.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import CrowdError

# How far pictures may draw an agent from where it stands, relative to the coordinates of agent and
# camera. Blender's positions are float32, which rounds by half an epsilon; the rest is for what
# renderers round who move meshes and rays by matrices of it.
GRAIN = 4 * float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class Window:
    """The part of a view plane that the image shows, along the camera's X and Y.

    Perspective: on the plane one meter ahead, as slopes (tan of the half angles). Orthographic: on
        any plane across the view, in meters.

    left, right: along X.
    bottom, top: along Y.
    """

    left: float
    right: float
    bottom: float
    top: float


@dataclass(frozen=True)
class Camera:
    """A camera at one time.

    kind: "PERSP", "ORTHO" or "PANO".
    origin: (3,) float64, world meters, the chapter's c.
    X, Y, Z: (3,) float64, right, up, view direction. v.X, v.Y, v.Z are the camera coordinates of v
        = p - c. The axes are orthonormal, except for a camera that a parent shears (see
        `referential`).
    near, far: meters along Z; PANO: from the origin.
    pixels: (width, height) of the image.
    cone: radians; a PANO camera sees directions up to this angle from Z. The default is every
        direction.
    pad, turn: bounds on other displacements of the camera's rays. Every sphere counts as larger by
        `pad` meters, and by `turn` meters per meter of distance (see `lens_blur`,
        culling/shutter.py, culling/camera.py).
    density: pixels per unit of the window; PANO: per radian in the middle. None derives it from
        pixels and window.
    rays: near and far are where rays begin and end, as in Cycles, not planes. It matters only for a
        sheared camera (see culling/frustum.py).
    grain: meters per meter of the coordinates, the sphere's and the camera's, by which spheres
        count as larger still (see `as_pictured`).
    filtered: pixels by which the pixel filter reaches past the picture's edges. It widens what is
        seen, not the window, from which sizes in pixels follow.
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
    cone: float = np.pi
    pad: float = 0.0
    turn: float = 0.0
    density: float | None = None
    rays: bool = False
    grain: float = 0.0
    filtered: float = 0.0

    @property
    def visible_window(self) -> Window:
        """Return the window, widened by the reach of the pixel filter."""
        w = self.window
        (width, height) = self.pixels
        across = self.filtered * (w.right - w.left) / width
        up = self.filtered * (w.top - w.bottom) / height
        return Window(w.left - across, w.right + across, w.bottom - up, w.top + up)

    @property
    def pixels_per_unit(self) -> float:
        """Return the pixels per unit of the window, along the finer axis of the image.

        The unit is slope 1 (PERSP), a meter (ORTHO) or a radian (PANO).
        """
        if self.density is not None:
            return self.density
        w = self.window
        return max(self.pixels[0] / (w.right - w.left), self.pixels[1] / (w.top - w.bottom))


def referential(
    matrix: np.ndarray, name: str = "camera"
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return (origin, X, Y, Z), each (3,) float64, of a camera's world matrix.

    matrix: (4, 4); the camera looks along its own -z.
    name: the camera's name, for errors.

    As in Blender (BKE_camera_multiview_model_matrix), only the lengths of the matrix's columns are
    normalized. Scale is gone, a mirrored camera keeps its mirrored image, and a camera sheared by a
    parent keeps axes that are not orthogonal. X, Y and -Z are the rows of the inverse; they take a
    point to camera coordinates in every case.

    Raises CrowdError if the matrix is not finite, is scaled to 0, or is sheared flat.
    """
    matrix = np.asarray(matrix, np.float64)
    if not np.isfinite(matrix).all():
        raise CrowdError(
            f"The camera {name} stands at NaN or infinity: set its transform to finite values."
        )
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not lengths.all():
        raise CrowdError(
            f"The camera {name}, or a parent of it, is scaled to 0: set its scale to another value."
        )
    axes = matrix[:3, :3] / lengths
    if abs(np.linalg.det(axes)) < 1e-6:
        raise CrowdError(
            f"The camera {name} is sheared flat by a parent: clear the parent's scale."
        )
    X, Y, back = np.linalg.inv(axes)
    return matrix[:3, 3].copy(), X, Y, -back


def window(
    size: float,
    fit: str,
    pixels: tuple[int, int],
    aspect: tuple[float, float] = (1.0, 1.0),
    shift: tuple[float, float] = (0.0, 0.0),
) -> Window:
    """Return the window of a Blender camera.

    size: extent of the fitted side: sensor / lens for perspective (sensor_height for VERTICAL fit,
        else sensor_width), or the orthographic scale in meters.
    fit: AUTO, HORIZONTAL or VERTICAL.
    pixels: image width and height.
    aspect: pixel aspect x, y.
    shift: lens shift in parts of the fitted side.

    Source: Blender's BKE_camera_params_compute_viewplane.
    """
    width = pixels[0] * aspect[0]
    height = pixels[1] * aspect[1]
    horizontal = fit == "HORIZONTAL" or (fit == "AUTO" and width >= height)
    unit = size / (width if horizontal else height)
    half_x = width * unit / 2
    half_y = height * unit / 2
    return Window(
        shift[0] * size - half_x,
        shift[0] * size + half_x,
        shift[1] * size - half_y,
        shift[1] * size + half_y,
    )


def lens_blur(camera: Camera, aperture: float, focus: float) -> Camera:
    """Return the camera with depth of field, which sees past the window's sides.

    aperture: the lens's radius, meters.
    focus: distance, meters.

    At the depth z a ray passes at most aperture |1 - z / focus| beside the pinhole's ray, which is
    at most aperture (1 + z / focus).
    """
    return replace(camera, pad=camera.pad + aperture, turn=camera.turn + aperture / focus)


def as_pictured(cameras: Sequence[Camera]) -> tuple[Camera, ...]:
    """Return the cameras with the rounding of Blender's pictures as their grain.

    Blender draws agents at float32 positions: at 1e6 m from the origin they stand up to 0.03 m
    beside their float64 positions along each axis. Drawing rounds further (see GRAIN).
    """
    return tuple(replace(camera, grain=GRAIN) for camera in cameras)


def stretch(camera: Camera) -> tuple[float, float]:
    """Return (least, most): factors of camera coordinates against world coordinates.

    They are singular values of the axes. Both are 1, up to rounding, unless the camera is sheared.
    """
    values = np.linalg.svd(np.array([camera.X, camera.Y, camera.Z]), compute_uv=False)
    return float(values[-1]), float(values[0])


def frustum_corners(camera: Camera, distance: float) -> np.ndarray:
    """Return the world positions (4, 3) of the window's corners at `distance` meters.

    The distance is along the view. The order goes around from the bottom left.
    """
    w = camera.window
    at = 1.0 if camera.kind == "ORTHO" else distance
    corners = [(w.left, w.bottom), (w.right, w.bottom), (w.right, w.top), (w.left, w.top)]
    coordinates = np.array([(at * x, at * y, distance) for x, y in corners])
    return camera.origin + coordinates @ np.linalg.inv(np.array([camera.X, camera.Y, camera.Z])).T


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


def place_eye(matrix: np.ndarray, stereo: Stereo, side: str) -> tuple[np.ndarray, float]:
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


def make_spherical(camera: Camera, stereo: Stereo) -> Camera:
    """Return one camera that sees all that both eyes of Cycles' spherical stereo see.

    Conservative. Every ray starts half the eye distance aside, and turns in to meet that of the
    other eye at the convergence distance.
    """
    aside = stereo.distance / 2
    if stereo.mode == "PARALLEL":
        return replace(camera, pad=camera.pad + aside)
    inward = np.arcsin(min(1.0, aside / stereo.convergence)) if stereo.convergence > 0 else np.pi
    return replace(camera, pad=camera.pad + aside, turn=camera.turn + float(inward))


EYE = 1.7  # meters above the ground
BODY = 1.0  # meters above it, of the part of people that the picture holds
CELL = 2.0  # meters, of the grid that finds where the crowd is densest
WAYS = 32  # directions that are tried
SEEN = 0.95  # part of the places that the picture holds at least
NEAREST = 3.0  # meters between the camera and the place that it looks at, at least


@dataclass(frozen=True)
class LevelCamera:
    """A camera that stands upright and looks level.

    eye: (3,) float64, world meters.
    ahead: (2,) float64, the unit vector along x and y in which it looks.
    far: meters along it, beyond everyone.
    """

    eye: np.ndarray
    ahead: np.ndarray
    far: float


def framing(places: np.ndarray, across: float, below: float, above: float) -> LevelCamera:
    """Return the view over the densest of `places` that holds most of them from the least distance.

    places: (n, 3) float64, n > 0, world meters: the feet of all agents at several times.
    across, below, above: slopes of the picture's sides, of its bottom and of its top, all above 0.
    """
    middle = _densest(places)
    x, y, z = (places - middle).T
    turn = np.arange(WAYS) * (2 * np.pi / WAYS)
    ways = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    distances = np.empty(WAYS)
    for k, (cos, sin) in enumerate(ways):
        ahead = cos * x + sin * y
        aside = cos * y - sin * x
        needed = np.maximum.reduce(
            [np.abs(aside) / across, (z + BODY - EYE) / above, (EYE - BODY - z) / below]
        )
        distances[k] = np.quantile(needed - ahead, SEEN, method="higher")
    best = int(distances.argmin())
    way = ways[best]
    away = max(float(distances[best]), NEAREST)
    eye = middle + np.array([*(-away * way), EYE])
    far = float(((places[:, :2] - eye[:2]) @ way).max())
    return LevelCamera(eye, way, 1.1 * max(far, away) + NEAREST)


def _densest(places: np.ndarray) -> np.ndarray:
    """Return the middle (3,) of the places in the fullest cell of a grid, on their usual height."""
    cell = np.floor((places[:, :2] - places[:, :2].min(axis=0)) / CELL).astype(np.int64)
    number = cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1]
    _, which, counts = np.unique(number, return_inverse=True, return_counts=True)
    inside = places[which == counts.argmax()]
    return np.array([*inside[:, :2].mean(axis=0), np.median(inside[:, 2])])
