"""Frustum tests of boxes and of single spheres that hold beyond all rounding.

Whatever lies too close to a limit stays undecided.
"""

from dataclasses import dataclass

import numpy as np

from .camera import Camera, stretch
from .frustum import frustum_of

# Relative to the largest coordinate, far more than all roundings together: those of the radar, of
# the boxes, and of the walk, which rounds at each border that it crosses. A box nearer to a plane
# than this stays open: that costs time, and is never wrong.
SLACK = 1e-8
# NumPy's matrix product takes several threads for more columns than this: it costs them more to
# start than they save.
COLUMNS = 2048
# Meters. Beyond these, products and squares may overflow, or lose their bits to underflow.
HUGE = 1e100
LEAST = 1e-100
# Times the largest coordinate: farther off no plane meets a box, whatever is rounded.
BEYOND = 2.0**20


@dataclass(frozen=True)
class Look:
    """One camera's view of the crowd, for agents that moved since the boxes.

    least, most: (3,) meters, the bounds of the agents' displacement from the boxes.
    grown: meters by which the agents' spheres are larger.
    """

    camera: Camera
    least: np.ndarray
    most: np.ndarray
    grown: float = 0.0


class BoxTest:
    """Decides boxes for one Look by linear forms: `forms` (f, 9) times (box, 1).

    extent: the largest coordinate of the boxes, meters.
    margin: as for `radar`.
    """

    def __init__(self, look: Look, extent: float, margin: float | None):
        camera = self.camera = look.camera
        self.radial = camera.kind == "PANO"
        self.linear = not (self.radial or camera.turn)
        self.moved = (look.least + look.most) / 2
        self.wider = (look.most - look.least) / 2
        normals = np.empty((0, 3))
        offsets = np.empty(0)
        rounding = 1.0
        if camera.kind != "PANO":
            frustum = frustum_of(camera)
            normals = frustum.normals
            offsets = frustum.limits(margin)
            rounding = max(1.0, frustum.rounding)
        self.reach = camera.pad + (look.grown if margin is None else 0.0)
        self.radius = 1.0 if margin is None else 0.0
        about = (
            extent
            + np.abs(camera.origin).max()
            + np.abs(self.moved).max()
            + self.wider.max()
            + self.reach
        )
        self.slack = (
            (SLACK + 6 * camera.grain)
            * (1 + camera.turn)
            * rounding
            * (1 + np.abs(camera.Z).sum())
            * about
        )
        away = np.abs(offsets)
        # of a plane so far beyond all boxes that none comes near, as a far one may be, roundings
        # decide nothing
        self.slack += (
            1e-12 * away[away < BEYOND * (1 + camera.turn) * about].max(initial=0.0) + LEAST
        )
        if not about < HUGE:
            self.slack = np.nan  # nothing is decided
        k = self.count = len(normals)
        axes = np.empty((2 * k + 2, 3))
        sign = np.ones((2 * k + 2, 1))
        part = np.zeros((2 * k + 2, 2))
        axes[:k] = axes[k:-2] = normals
        axes[-2:] = camera.Z
        sign[:k] = sign[-2] = -1.0
        part[:k, 1] = part[k:-2, 0] = -self.radius
        wide = sign * np.abs(axes)
        add = axes @ (self.moved - camera.origin) + wide @ self.wider
        beyond = offsets + self.reach
        add[:k] -= beyond
        add[k:-2] -= beyond
        add[-2:] += (-self.slack, self.slack)
        self.forms = np.concatenate([axes, wide, part, add[:, None]], axis=1)
        # of single spheres, which have not moved on: rows of `single` (f, 5) times (x, y, z,
        # radius, 1)
        self.single = np.empty((k + 1, 5))
        self.single[:, :3] = axes[k:-1]
        self.single[:, 3] = part[k:-1, 0]
        self.single[:, 4] = axes[k:-1] @ -camera.origin
        self.single[:k, 4] -= beyond

    def __call__(self, boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return (outside, inside, nearest, farthest), each (b,), for `boxes` (9, b).

        boxes: as Blocks.tiers, with a last row of 1.
        outside, inside: bool, whether all spheres of a box surely are.
        nearest, farthest: bounds of their distances, meters.
        """
        camera = self.camera
        k = self.count
        values = self.forms @ boxes
        nearest, farthest = values[-2:]
        turned = 0.0, 0.0
        if self.radial or camera.turn:
            off = np.abs(boxes[:3] + (self.moved - camera.origin)[:, None])
            half = boxes[3:6] + self.wider[:, None]
            close = np.sqrt((np.maximum(off - half, 0) ** 2).sum(axis=0)) - self.slack
            away = np.sqrt(((off + half) ** 2).sum(axis=0)) + self.slack
            least, most = self.reach + self.radius * boxes[6:8]
            turned = camera.turn * (close + least), camera.turn * (away + most)
            if self.radial:
                nearest = close
                farthest = away
        if camera.kind == "PANO":
            return (
                *self._of_range(boxes, close, away, least + turned[0], most + turned[1]),
                nearest,
                farthest,
            )
        outside = values[:k].max(axis=0) > turned[1] + self.slack
        inside = values[k : 2 * k].max(axis=0) <= turned[0] - self.slack
        return outside, inside, nearest, farthest

    def alone(self, spheres: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (outside, inside, distance), each (m,), for single `spheres` (5, m).

        spheres: rows x, y, z, radius, 1.
        outside, inside: bool, whether a sphere surely is.
        distance: meters, to within the slack.

        Only for cameras whose reach and distance are linear (`linear`).
        """
        *sides, distance = values = np.empty((len(self.single), spheres.shape[1]))
        for at in range(0, spheres.shape[1], COLUMNS):
            np.matmul(self.single, spheres[:, at : at + COLUMNS], out=values[:, at : at + COLUMNS])
        worst = values[: len(sides)].max(axis=0)
        return worst > self.slack, worst <= -self.slack, distance

    def _of_range(
        self,
        boxes: np.ndarray,
        close: np.ndarray,
        away: np.ndarray,
        least: np.ndarray,
        most: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return (outside, inside), each (b,), for a PANO camera's clip range and cone.

        The cone tests a sphere about each box.

        close, away: (b,) meters, bounds of the distances of the boxes' centers.
        least, most: (b,) meters, bounds of the reach of the boxes' spheres.
        """
        camera = self.camera
        outside = (close > camera.far + most + self.slack) | (
            away < camera.near - most - self.slack
        )
        inside = (close >= camera.near - least + self.slack) & (
            away <= camera.far + least - self.slack
        )
        if camera.cone < np.pi:
            v = boxes[:3] + (self.moved - camera.origin)[:, None]
            longer = stretch(camera)[1]
            ball = (
                longer * np.sqrt(((boxes[3:6] + self.wider[:, None]) ** 2).sum(axis=0))
                + longer * self.slack
            )
            across = np.hypot(camera.X @ v, camera.Y @ v)
            depth = camera.Z @ v
            beyond = across * np.cos(camera.cone) - depth * np.sin(camera.cone)
            outside |= beyond - ball > longer * most
            inside &= beyond + ball <= longer * least
        return outside, inside
