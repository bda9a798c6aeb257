"""The camera's referential and window (chapter eqs 1.1 to 1.3, 1.5, 1.6), for Blender's kinds of camera."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import CrowdError

# How far pictures may draw an agent from where it stands, relative to the coordinates of agent and camera. Blender's positions
# are float32, which rounds by half an epsilon; the rest is for what renderers round who move meshes and rays by matrices of it.
GRAIN = 4 * float(np.finfo(np.float32).eps)


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

    kind: "PERSP", "ORTHO" or "PANO". origin: (3,) float64, world metres, the chapter's c. X (right), Y (up), Z (view
    direction): (3,) float64; v.X, v.Y, v.Z are the camera coordinates of v = p - c. They are orthonormal, but for a
    camera that a parent shears (see `referential`). near, far: metres along Z (PANO: from the origin). pixels: (width,
    height) of the image.

    cone: radians; a PANO camera sees directions up to this angle from Z, in every direction with the default.
    pad, turn: what else moves a camera's rays, as bounds: every sphere is taken for larger by `pad` metres and `turn`
    metres a metre of distance (see `lens_blur`, `opened`, culling/stereo.py). density: pixels per unit of the window, PANO:
    per radian in the middle; None derives it from pixels and window. rays: near and far are where rays begin and end,
    as in Cycles, not planes; it matters only where the camera is sheared (see `planes`). grain: metres a metre of the
    coordinates, their own and the camera's, by which spheres are taken for larger still (see `pictured`). filtered: pixels by
    which the pixel filter reaches past the picture's edges. It widens what is seen, not the window, from which sizes in pixels
    come.
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
    def seen(self) -> Window:
        """The window, wider by what the pixel filter mixes into the pixels at the picture's edges."""
        w, (width, height) = self.window, self.pixels
        across, up = self.filtered * (w.right - w.left) / width, self.filtered * (w.top - w.bottom) / height
        return Window(w.left - across, w.right + across, w.bottom - up, w.top + up)

    @property
    def pixels_per_unit(self) -> float:
        """Pixels per unit slope (PERSP), metre (ORTHO) or radian (PANO), along the finer of the image's axes."""
        if self.density is not None:
            return self.density
        w = self.window
        return max(self.pixels[0] / (w.right - w.left), self.pixels[1] / (w.top - w.bottom))


def referential(matrix: np.ndarray, name: str = "camera") -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(origin, X, Y, Z), each (3,) float64, of a camera with the world matrix (4, 4), which looks along its own -z.

    As Blender does (BKE_camera_multiview_model_matrix), the matrix's columns are normalised, and nothing else: scale is
    gone, a mirrored camera keeps its mirrored image, and a camera sheared by a parent keeps axes that are not
    orthogonal. X, Y and -Z are the rows of the inverse, which take a point to camera coordinates in every case.
    """
    matrix = np.asarray(matrix, np.float64)
    if not np.isfinite(matrix).all():
        raise CrowdError(f"The camera {name} stands at NaN or infinity: set its transform to finite values.")
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not lengths.all():
        raise CrowdError(f"The camera {name}, or a parent of it, is scaled to 0: set its scale to another value.")
    axes = matrix[:3, :3] / lengths
    if abs(np.linalg.det(axes)) < 1e-6:
        raise CrowdError(f"The camera {name} is sheared flat by a parent: clear the parent's scale.")
    X, Y, back = np.linalg.inv(axes)
    return matrix[:3, 3].copy(), X, Y, -back


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


def crop(camera: Camera, left: float, right: float, bottom: float, top: float) -> Camera:
    """The camera that films a part of the image alone: Blender's render border, in parts of the image's width (left,
    right) and height (bottom, top), out to whole pixels, in Blender's float32, from where it begins to where it ends. A
    panoramic camera is returned as it is."""
    if camera.kind == "PANO":
        return camera
    w, (width, height) = camera.window, camera.pixels
    x = np.floor(np.float32(left) * np.float32(width)), np.ceil(np.float32(right) * np.float32(width))
    y = np.floor(np.float32(bottom) * np.float32(height)), np.ceil(np.float32(top) * np.float32(height))
    pixels = max(1, int(x[1] - x[0])), max(1, int(y[1] - y[0]))
    across, up = (w.right - w.left) / width, (w.top - w.bottom) / height
    start = w.left + float(x[0]) * across, w.bottom + float(y[0]) * up
    part = Window(start[0], start[0] + pixels[0] * across, start[1], start[1] + pixels[1] * up)
    return replace(camera, window=part, pixels=pixels, density=camera.pixels_per_unit)


def lens_blur(camera: Camera, aperture: float, focus: float) -> Camera:
    """The camera with a lens that is no pinhole: depth of field lets it see past the window's sides.

    aperture: the lens's radius in metres; focus: distance in metres. At the depth z a ray passes at most
    aperture |1 - z / focus| beside the pinhole's, which is at most aperture (1 + z / focus).
    """
    return replace(camera, pad=camera.pad + aperture, turn=camera.turn + aperture / focus)


def pictured(cameras: Sequence[Camera]) -> tuple[Camera, ...]:
    """The cameras with the rounding of Blender's pictures as their grain.

    Blender draws agents at float32 positions: at 1e6 m from the origin they stand up to 0.03 m beside their float64
    positions along each axis. Drawing rounds further (see GRAIN)."""
    return tuple(replace(camera, grain=GRAIN) for camera in cameras)


def stretch(camera: Camera) -> tuple[float, float]:
    """(least, most): factors by which camera coordinates may be shorter, longer than the world's: singular values of
    the referential. Both are 1, but for rounding, unless the camera is sheared."""
    values = np.linalg.svd(np.array([camera.X, camera.Y, camera.Z]), compute_uv=False)
    return float(values[-1]), float(values[0])


@dataclass(frozen=True)
class Planes:
    """The six planes of a PERSP or ORTHO camera: right, left, top, bottom, near, far.

    A point at v = p - c lies inside plane k iff normals[k] . v <= offsets[k]. normals: (6, 3) float64, unit vectors in
    world space, outward. offsets: (6,) metres. fixed: (6,) metres along the normal that one metre of v.X, v.Y (the
    chapter's fixed Delta) or v.Z is. rounding: how much larger than 1 were the terms that cancelled in a normal: the
    factor by which its rounding may exceed a unit vector's.
    """

    normals: np.ndarray
    offsets: np.ndarray
    fixed: np.ndarray
    rounding: float

    def limits(self, margin: float | None = None, rounding: float = 0.0) -> np.ndarray:
        """(6,) metres: the offsets, farther out by the part `rounding` of each, and at the sides by the chapter's fixed Delta,
        `margin` metres, if there is one."""
        found = self.offsets + rounding * np.abs(self.offsets) if rounding else self.offsets.copy()
        found[:4] += (margin or 0.0) * self.fixed[:4]
        return found


def planes(camera: Camera) -> Planes:
    """The camera's planes (chapter eqs 1.4 to 1.6).

    |v.X| <= w / 2 with w = 2 (v.Z) tan(fov / 2) is (X - t Z) . v <= 0 with the slope t = tan(fov / 2) of the window's
    side. Divided by its length sqrt(1 + t^2), the chapter's 1 / cos(fov / 2), it measures the distance from the plane
    in metres, stays finite as fov goes to 180 degrees, and a sphere touches the plane iff it is at most r. Cycles begins
    and ends a sheared camera's rays at near and far times a factor that depends on the direction: with `rays` the two
    planes are moved apart by its bound, `stretch`.
    """
    w, X, Y, Z = camera.seen, camera.X, camera.Y, camera.Z
    edges = ((X, w.right), (-X, -w.left), (Y, w.top), (-Y, -w.bottom))
    slopes = [0.0 if camera.kind == "ORTHO" else edge for _, edge in edges]
    least, most = stretch(camera) if camera.rays and camera.kind != "ORTHO" else (1.0, 1.0)
    rows = np.array([axis - slope * Z for (axis, _), slope in zip(edges, slopes, strict=True)] + [-Z, Z])
    offsets = [edge - slope for (_, edge), slope in zip(edges, slopes, strict=True)]
    lengths = np.sqrt((rows * rows).sum(axis=1))
    across, up, along = (math.sqrt(axis @ axis) for axis in (X, Y, Z))
    terms = [axis + abs(slope) * along for axis, slope in zip((across, across, up, up), slopes, strict=True)]
    return Planes(
        normals=rows / lengths[:, None],
        offsets=np.array([*offsets, -camera.near * least, camera.far * most]) / lengths,
        fixed=1 / lengths,
        rounding=float((terms / lengths[:4]).max()),
    )


def opened(samples: Sequence[Camera]) -> tuple[Camera, ...]:
    """The cameras of an open shutter: `samples`, one camera at consecutive times, each with its spheres grown by as
    much as the camera moves to the sample before or after.

    What the camera sees at any time between two samples, one of them then sees, if it moves on between them without
    turning back. From n . (p - c) <= offset + r: a plane's normal that turns by dn moves by |dn| |v|, the origin by
    |dc|, the offset by itself.
    """
    moves = [(0.0, 0.0), *(_change(a, b) for a, b in zip(samples[:-1], samples[1:], strict=True)), (0.0, 0.0)]
    return tuple(
        replace(camera, pad=camera.pad + max(before[0], after[0]), turn=camera.turn + max(before[1], after[1]))
        for camera, before, after in zip(samples, moves[:-1], moves[1:], strict=True)
    )


def differs(planned: Camera, shown: Camera) -> bool:
    """Whether what is `shown` is more than rounding off what was `planned`: a sample of `opened`, and its camera as it is."""
    if planned.kind != shown.kind:
        return True
    moved, turned = _change(planned, shown)
    rounding = 1e-5 * (1 + np.abs(shown.origin).max())  # float32's, and that of sub-frames
    return moved > rounding + 1e-3 * planned.pad or turned > 1e-5 + 1e-3 * planned.turn


def _change(a: Camera, b: Camera) -> tuple[float, float]:
    """(metres, metres a metre of distance) by which what bounds the view moves from camera a to b."""
    moved = float(np.linalg.norm(b.origin - a.origin))
    if a.kind == "PANO" or b.kind == "PANO":
        clip = max(abs(b.near - a.near), abs(b.far - a.far))
        return moved + clip, float(np.linalg.norm(b.Z - a.Z)) + abs(b.cone - a.cone)
    one, two = planes(a), planes(b)
    return (
        moved + float(np.abs(two.offsets - one.offsets).max()),
        float(np.linalg.norm(two.normals - one.normals, axis=1).max()),
    )


def frustum_corners(camera: Camera, distance: float) -> np.ndarray:
    """World positions (4, 3) of the window's corners at `distance` metres along the view, around from left bottom."""
    w = camera.window
    at = 1.0 if camera.kind == "ORTHO" else distance
    corners = [(w.left, w.bottom), (w.right, w.bottom), (w.right, w.top), (w.left, w.top)]
    coordinates = np.array([(at * x, at * y, distance) for x, y in corners])
    return camera.origin + coordinates @ np.linalg.inv(np.array([camera.X, camera.Y, camera.Z])).T
