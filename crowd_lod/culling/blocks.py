"""Blocks of neighboring agents: culling and LODs without a test of every agent.

Agents are ordered along a space-filling curve (Morton 1966), group by group. Every SIZE agents form
a block, with a box about the centers of their spheres. A block that lies wholly outside the
picture, or wholly inside and within one LOD, is decided at once; `radar` and `assign` decide the
agents of all others. Every FAN blocks have a box, too: the blocks of one that is decided are not
tested. A box counts as outside or inside only beyond any rounding, so the plan equals, bit for bit,
that of testing every agent.

Agents move away from where the boxes were taken. Until the next boxes, these are grown by how far
agents may walk (frame/index_cache.py).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.bounds import Spheres
from ..world.maps import Area
from .camera import Camera, stretch
from .frustum import Frustum
from .volumes import view

SIZE = 64  # agents of a block
FAN = 16  # blocks that share a wider box
PART = 1024  # blocks whose boxes are made at a time, to take little memory
# in place of a LOD
CULLED = 255
OPEN = 254  # of a block: its agents do not all have one LOD, or it is not known which
MIXED = -1  # in place of a group: a block's agents have more than one

# Relative to the largest coordinate, far more than all roundings together: those of the radar, of
# the boxes, and of the walk, which rounds at each border that it crosses. A box nearer to a plane
# than this stays open: that costs time, and is never wrong.
SLACK = 1e-8
# Meters. Beyond these, products and squares may overflow, or lose their bits to underflow.
HUGE = 1e100
LEAST = 1e-100
# Times the largest coordinate: farther off no plane meets a box, whatever is rounded.
BEYOND = 2.0**20


@dataclass(frozen=True)
class Boxes:
    """Boxes that hold the centers of agents' spheres.

    center, half: (3, b) float64 meters, middle and half of the width along x, y and z.
    radius: (2, b) float64 meters, bounds of the spheres' radii.
    group: (b,) intp, the group of the agents, or MIXED.
    """

    center: np.ndarray
    half: np.ndarray
    radius: np.ndarray
    group: np.ndarray

    def __len__(self) -> int:
        return len(self.group)

    def of(self, numbers: np.ndarray) -> "Boxes":
        """Return the boxes `numbers` (m,)."""
        return Boxes(*(column.take(numbers, axis=-1) for column in vars(self).values()))

    def joined(self) -> "Boxes":
        """Return one box about every FAN of them."""
        starts = np.arange(0, len(self), FAN)
        low = np.minimum.reduceat(self.center - self.half, starts, axis=1)
        high = np.maximum.reduceat(self.center + self.half, starts, axis=1)
        least = np.minimum.reduceat(self.radius[0], starts)
        most = np.maximum.reduceat(self.radius[1], starts)
        first = np.minimum.reduceat(self.group, starts)
        last = np.maximum.reduceat(self.group, starts)
        group = np.where(first == last, first, MIXED)
        return Boxes((low + high) / 2, (high - low) / 2, np.array([least, most]), group)


@dataclass(frozen=True)
class Blocks:
    """The crowd's blocks at one time.

    order: (n,) int32, agent indices, group by group along the curve.
    rows: (b, SIZE) int32, the same; the last block repeats the last agent, to be full.
    boxes: of the blocks.
    wide: of every FAN blocks.
    extent: the largest coordinate, meters; NaN if an agent stands at NaN or infinity.
    """

    order: np.ndarray
    rows: np.ndarray
    boxes: Boxes
    wide: Boxes
    extent: float

    @property
    def finite(self) -> bool:
        """Whether no agent stands at NaN or infinity."""
        return bool(np.isfinite(self.extent))

    def agents(self, numbers: np.ndarray) -> np.ndarray:
        """Return the agents (m,) int32 of the blocks `numbers`, increasing, each once."""
        agents = self.rows.take(numbers, axis=0).ravel()
        repeated = self.rows.size - len(self.order)
        if len(numbers) and numbers[-1] == len(self.rows) - 1:
            return agents[: len(agents) - repeated]
        return agents


def blocks_of(
    crowd: Crowd,
    order: np.ndarray,
    spheres: Spheres,
    area: Area,
    wraps: tuple | None = None,
    span: tuple[float, float] | None = None,
) -> Blocks:
    """Return the blocks of `crowd`.

    order: (n,) int32, from `morton_order.order_of`.
    area: the crowd's ground. The boxes also hold agents that leave it and are put back onto it.
    wraps: (least, most) displacement (3,) within which the boxes will be used, if agents that leave
        the area come back at its other side.
    span: the least and greatest z of the ground that agents climb; None if their z stays.
    """
    beyond = -len(order) % SIZE
    rows = np.append(order, np.full(beyond, order[-1])).reshape(-1, SIZE)
    first, last = crowd.group[rows[:, (0, -1)].T].astype(np.intp)
    group = np.where(first == last, first, MIXED)
    low, high = np.empty((2, 3, len(rows)))
    with np.errstate(invalid="ignore"):
        for at in range(0, len(rows), PART):
            part = slice(at, at + PART)
            for axis, column in enumerate((crowd.x, crowd.y, crowd.z)):
                places = column[rows[part]]
                low[axis, part] = places.min(axis=1)
                high[axis, part] = places.max(axis=1)
        _stay(low, high, area, wraps, span)
        centers = _bounds(spheres.center, group)
        low[2] += centers[0]
        high[2] += centers[1]
        extent = float(max(np.abs(low).max(), np.abs(high).max()))
        boxes = Boxes((low + high) / 2, (high - low) / 2, _bounds(spheres.reach, group), group)
        return Blocks(order, rows, boxes, boxes.joined(), extent)


def _bounds(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return the least and greatest of `values` (G,) in blocks of `group` (b,), (2, b)."""
    own = values[group]
    mixed = group == MIXED
    return np.array([np.where(mixed, values.min(), own), np.where(mixed, values.max(), own)])


def _stay(
    low: np.ndarray,
    high: np.ndarray,
    area: Area,
    wraps: tuple | None,
    span: tuple[float, float] | None,
) -> None:
    """Grow the boxes low, high (3, b) for agents that are moved onto the area.

    With `wraps` the boxes also hold agents that come back at the other side of the area, where the
    ground may have another height.
    """
    for axis, (least, most) in enumerate(((area.x_min, area.x_max), (area.y_min, area.y_max))):
        if wraps is not None:
            crosses = (low[axis] + wraps[0][axis] <= least) | (high[axis] + wraps[1][axis] >= most)
            low[axis, crosses] = np.minimum(low[axis, crosses], least)
            high[axis, crosses] = np.maximum(high[axis, crosses], most)
            if span is not None:
                low[2, crosses] = np.minimum(low[2, crosses], span[0])
                high[2, crosses] = np.maximum(high[2, crosses], span[1])
        low[axis] = np.minimum(low[axis], most)
        high[axis] = np.maximum(high[axis], least)


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

    @cached_property
    def frustum(self) -> Frustum:
        """The camera's planes; a pyramid about the cone of a PANO camera."""
        return view(self.camera)


@np.errstate(invalid="ignore", over="ignore", under="ignore")
def decide(
    blocks: Blocks,
    views: Sequence[Sequence[Look]],
    thresholds: np.ndarray | None,
    margin: float | None = None,
) -> np.ndarray:
    """Return the LOD of each block, or CULLED, or OPEN, (b,) uint8.

    views: for each time at which agents may be seen, the Looks of the eyes. LODs follow from the
        first time's.
    thresholds: (G, n - 1) meters where LODs begin; None if they depend on more than distance.
    margin: as for `radar`.
    """
    levels = np.repeat(_decide(blocks.wide, blocks.extent, views, thresholds, margin), FAN)
    levels = levels[: len(blocks.rows)]
    opened = (levels == OPEN).nonzero()[0]
    parts = blocks.boxes.of(opened)
    levels[opened] = _decide(parts, blocks.extent, views, thresholds, margin)
    if len(blocks.order) < blocks.rows.size and levels[-1] != CULLED:
        levels[-1] = OPEN  # it repeats an agent
    return levels


def _decide(
    boxes: Boxes,
    extent: float,
    views: Sequence[Sequence[Look]],
    thresholds: np.ndarray | None,
    margin: float | None,
) -> np.ndarray:
    """Return the LOD of each box, or CULLED, or OPEN, (b,) uint8."""
    tests = [[_test(boxes, extent, look, margin) for look in eyes] for eyes in views]
    every = [test for eyes in tests for test in eyes]
    outside = np.logical_and.reduce([test[0] for test in every])
    levels = np.where(outside, np.uint8(CULLED), np.uint8(OPEN))
    if thresholds is None:
        return levels
    inside = np.logical_or.reduce([test[1] for test in every])
    nearest, farthest = np.minimum.reduce([test[2] for test in tests[0]])
    begins = thresholds.T.take(boxes.group, axis=1)
    finest = (nearest >= begins).sum(axis=0)
    is_whole = inside & (finest == (farthest >= begins).sum(axis=0)) & (boxes.group != MIXED)
    levels[is_whole] = finest[is_whole]
    return levels


def _test(
    boxes: Boxes, extent: float, look: Look, margin: float | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (outside, inside, range): what one camera surely sees of the boxes.

    outside, inside: (b,) bool, whether all spheres of a box surely are.
    range: (2, b) meters, the least and greatest distance of their centers.

    A sphere beyond a plane by d is seen iff d is at most its reach. In a box with the middle v and
    the half width e, n . v - offset differs by at most |n| . e. Boxes are never surely inside for a
    PANO camera, whose cone the planes only bound.
    """
    camera = look.camera
    v = boxes.center + ((look.least + look.most) / 2 - camera.origin)[:, None]
    half = boxes.half + ((look.most - look.least) / 2)[:, None]
    reach = camera.pad + (boxes.radius + look.grown if margin is None else np.zeros((2, 1)))
    about = extent + np.abs([camera.origin, look.least, look.most]).max(axis=1).sum()
    about += camera.pad + look.grown
    slack = (SLACK + 6 * camera.grain) * (1 + camera.turn) * (1 + np.abs(camera.Z).sum()) * about
    if not about < HUGE:
        slack = np.nan  # nothing is sure
    away = np.sqrt((v * v).sum(axis=0))
    ball = np.sqrt((half * half).sum(axis=0)) + slack
    reach = reach + camera.turn * (np.array([away - ball, away + ball]) + reach)
    ranged = camera.kind == "PANO"
    frustum = look.frustum
    limits = frustum.limits(None if ranged else margin)
    # roundings of planes so far off that no box comes near, as a far one may be, decide nothing
    offsets = np.abs(limits)
    slack *= max(1.0, frustum.rounding)
    slack += 1e-12 * offsets[offsets < BEYOND * (1 + camera.turn) * about].max(initial=0.0) + LEAST
    beyond = frustum.normals @ v - limits[:, None]
    wide = np.abs(frustum.normals) @ half
    if ranged:
        least, most = stretch(camera)
        outside = (beyond - wide).max(axis=0) > (reach[1] + slack) * (most / least)
        return outside, np.zeros(len(boxes), bool), np.array([away - ball, away + ball])
    outside = (beyond - wide).max(axis=0) > reach[1] + slack
    inside = (beyond + wide).max(axis=0) <= reach[0] - slack
    depth = camera.Z @ v
    deep = np.abs(camera.Z) @ half + slack
    return outside, inside, np.array([depth - deep, depth + deep])


def near(
    blocks: Blocks,
    numbers: np.ndarray,
    moved: tuple[np.ndarray, np.ndarray],
    grown: float,
    about: float,
    touches: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> np.ndarray:
    """Return those of the blocks `numbers` (b,) that may hold agents kept by `touches`, (m,) intp.

    moved: (least, most) displacement (3,) from the boxes, meters.
    grown: meters by which the agents' spheres are larger.
    about: the largest coordinate that `touches` computes with; the test allows for its rounding.
    touches: (points (b, 3), radii (b,)) -> (b,) bool, which spheres it keeps. If it keeps a sphere,
        it must keep every sphere that contains that one. It is called with spheres about whole
        blocks.
    """
    least, most = moved
    about = about + np.abs(moved).max() + grown
    if not about < HUGE:
        return numbers
    boxes = blocks.boxes.of(numbers)
    half = boxes.half + (most - least)[:, None] / 2
    radius = np.sqrt((half**2).sum(axis=0)) + boxes.radius[1] + (grown + SLACK * about)
    return numbers[touches((boxes.center + (least + most)[:, None] / 2).T, radius)]
