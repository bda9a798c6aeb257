"""How far each agent's outline may be off in a frame, and why some are told apart."""

from dataclasses import dataclass, replace

import numpy as np

from ..culling.camera import Camera
from ..frame.frame import Frame
from ..frame.planned import OVERRIDDEN, PINNED
from ..levels.assignment import pixels_of

BEYOND = 1.01  # times what is allowed, from which on a pinned agent stands apart
OVERSCAN = 0.5  # of the picture's size, beyond each of its edges: the lens stretches no further
# why agents stand apart
PINNED_APART = "pinned"
BLURRED_APART = "blurred"
FADING_APART = "in a cross-fade"


@dataclass(frozen=True)
class Allowances:
    """What a frame's agents may be off in its picture, (n,) each.

    level: intp, the LOD that the build shows; 0 if it shows none.
    depth: meters from the nearest eye to the sphere's center along its view; infinite behind all.
    predicted: pixels by which the LOD shifts its outline at most; NaN if that is not known.
    allowed: pixels that it may be off; NaN if neither a tolerance nor the prediction is known.
    apart: str, why `allowed` does not bind it, or "".
    """

    level: np.ndarray
    depth: np.ndarray
    predicted: np.ndarray
    allowed: np.ndarray
    apart: np.ndarray

    def of_wearers(self, wearer: np.ndarray) -> "Allowances":
        """Return the same, by which a part that is worn may be off for its wearer, too.

        wearer: (n,) the agent who wears each; itself, for others.
        """
        allowed, predicted = self.allowed.copy(), self.predicted.copy()
        np.fmax.at(allowed, wearer, self.allowed)
        np.fmax.at(predicted, wearer, self.predicted)
        apart = self.apart.copy()
        worn = np.flatnonzero(self.apart != "")
        apart[wearer[worn]] = self.apart[worn]
        return replace(self, allowed=allowed, predicted=predicted, apart=apart)


def allowances(
    frame: Frame, agents: np.ndarray, levels: np.ndarray, tolerance: float | None
) -> Allowances:
    """Return what the agents of a frame may be off; of a part that is worn, see its own row.

    Nothing is known in the picture of a panoramic camera.

    agents: (m,) intp, that the build shows to the camera.
    levels: (m,) intp, their LODs.
    tolerance: pixels that LODs may deviate; None where they may deviate as their bounds predict.
    """
    crowd = frame.crowd
    group = crowd.group.astype(np.intp)
    spheres = frame.trajectory.spheres
    radius = spheres.radius[group]
    center = np.stack([crowd.x, crowd.y, crowd.z + spheres.center[group]], axis=1)
    level = np.zeros(len(crowd), np.intp)
    level[agents] = levels
    bound = _bounds(frame, level)[group, level]
    depths = np.stack([(center - eye.origin) @ eye.Z for eye in frame.eyes])
    depths = np.where(depths > 0, depths, np.inf)
    nearest = depths.argmin(axis=0)
    depth = depths.min(axis=0)
    pixels, predicted, stretch = np.full((3, len(crowd)), np.nan)
    for number, eye in enumerate(frame.eyes):
        at = np.flatnonzero((nearest == number) & np.isfinite(depth))
        if eye.kind == "PANO":
            continue
        off = np.nan_to_num(bound[at])
        stretch[at] = _stretch(eye, center[at], radius[at] + off)
        pixels[at] = pixels_of(bound[at], depth[at], eye, radius[at])
        # the LOD's surface may be nearer to the camera than the character's
        predicted[at] = stretch[at] * pixels_of(bound[at], depth[at], eye, radius[at] + off)
    allowed = stretch * _tolerated(frame, depth, radius, tolerance)
    apart = _apart(frame, pixels > BEYOND * allowed / stretch)
    with np.errstate(divide="ignore", invalid="ignore"):
        nearer = predicted / stretch / pixels
    allowed = np.where(np.isfinite(nearer) & (nearer > 0), allowed * nearer, allowed)
    allowed = np.where(np.isnan(allowed), predicted, allowed)
    return Allowances(level, depth, predicted, np.where(np.isinf(allowed), np.nan, allowed), apart)


def _bounds(frame: Frame, level: np.ndarray) -> np.ndarray:
    """Return the meters by which each group's LODs deviate, (G, K); NaN if not measured."""
    groups = frame.trajectory.groups
    table = np.full((len(groups), int(level.max(initial=0)) + 1), np.nan)
    for row, bounds in zip(
        table, (group.bounds[: table.shape[1]] for group in groups), strict=True
    ):
        row[: len(bounds)] = bounds
    table[:, 0] = 0.0
    return table


def _tolerated(
    frame: Frame, depth: np.ndarray, radius: np.ndarray, tolerance: float | None
) -> np.ndarray:
    """Return the pixels of the tolerance in the middle of the picture, (n,); NaN without one.

    Where less detail is painted, an agent has the LOD of one that is farther away.
    """
    tolerated = np.full(len(depth), np.nan if tolerance is None else tolerance)
    if frame.factors is None or frame.camera.kind != "PERSP":
        return tolerated
    ahead = (depth > radius) & np.isfinite(depth)
    farther = (frame.factors * depth - radius)[ahead] / (depth - radius)[ahead]
    tolerated[ahead] *= np.maximum(farther, 1.0)
    return tolerated


def _apart(frame: Frame, is_beyond: np.ndarray) -> np.ndarray:
    """Return for each agent why it stands apart, "" if it does not, (n,) str.

    is_beyond: (n,) bool, whether its LOD is predicted to be off by more than is allowed.
    """
    row = np.zeros(len(frame.crowd), np.uint8) if frame.plan_row is None else frame.plan_row
    pinned = (row & PINNED != 0) & is_beyond
    overridden = pinned & (row & OVERRIDDEN != 0)
    faded = frame.crowd.faded
    fading = np.zeros(len(row), bool) if faded is None else faded < 1
    reasons = [PINNED_APART, BLURRED_APART, FADING_APART]
    return np.select([overridden, pinned, fading], reasons, "")


def _stretch(camera: Camera, center: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Return how much longer a length looks at each sphere than in the picture's middle, at most.

    A point at slope s that moves by e to depth z' moves by (e.XY - s e.Z) / z' in the picture,
    which is sqrt(1 + s^2) |e| / z' at most.

    center: (m, 3) meters, in front of the camera.
    radius: (m,) meters.
    """
    if camera.kind == "ORTHO":
        return np.ones(len(center))
    x, y, depth = np.stack([camera.X, camera.Y, camera.Z]) @ (center - camera.origin).T
    window = camera.window
    slopes = []
    for middle, least, most in ((x, window.left, window.right), (y, window.bottom, window.top)):
        widest = max(abs(least), abs(most)) + OVERSCAN * (most - least)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = (np.abs(middle) + radius) / (depth - radius)
        slopes.append(np.where(depth > radius, np.minimum(slope, widest), widest))
    return np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)
