"""Blocks of neighboring agents: culling and LOD without a test of every agent.

Agents are ordered along a space-filling curve (Morton 1966), group by group. Every LEAF agents form
a block, and every FAN blocks form a larger one, each with a box about its spheres: a bounding
volume hierarchy (Clark 1976) with an array per tier. A block that lies wholly outside the picture,
or wholly inside and within one LOD, is decided at once. Otherwise its parts are tested, and in the
end its agents, by `radar` and `assign`. A box counts as outside or inside only beyond any rounding,
so the plan equals, bit for bit, that of testing every agent.

Agents move away from where the boxes were taken. Until the next boxes, these are grown by how far
the table lets agents walk. The order is renewed less often than the boxes, which only grow as
neighbors part (frame/index_cache.py).
"""

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..crowd.agents import Crowd
from ..crowd.bounding_spheres import Spheres
from ..world import morton_order
from ..world.maps import Area
from .frustum_box_test import COLUMNS, HUGE, SLACK, BoxTest, Look

LEAF = 16  # agents in one of the smallest blocks
FAN = 8  # blocks that form the next larger one
FIRST = 1024  # the number of largest blocks is at most this
PART = 8192  # agents of undecided blocks are tested in parts of so many
# in place of a LOD
CULLED = 255
OPEN = 254  # of a block: its agents do not all have one LOD, or it is not known which


@dataclass(frozen=True)
class Blocks:
    """The crowd's blocks at one time.

    rows: (b, LEAF) int32, agent indices, group by group along the curve. The last blocks repeat the
        last agent, to be full.
    groups: (G + 1,) intp: group g is order[groups[g]:groups[g + 1]].
    spheres: (2, G) float64 meters, each group's center height and radius.
    tiers: the largest blocks first, of each tier (agents per block, boxes (8, b) float64, first and
        last group (2, b) uint8). The boxes' rows are center x, y, z; half width along x, y, z;
        least and greatest radius of the spheres, meters.
    extent: the largest coordinate, meters.
    finite: whether no agent stands at NaN or infinity.
    floor: the height of all agents' feet for as long as the blocks hold; None if they differ.
    """

    rows: np.ndarray
    groups: np.ndarray
    spheres: np.ndarray
    tiers: list[tuple[int, np.ndarray, np.ndarray]]
    extent: float
    finite: bool
    floor: float | None

    @property
    def order(self) -> np.ndarray:
        """Return the agent indices in block order, (n,) int32."""
        return self.rows.reshape(-1)[: self.groups[-1]]


@dataclass(frozen=True)
class BlockDecisions:
    """What the tests of blocks decide.

    leaves: (b,) uint8, the LOD of each of the smallest blocks, or CULLED, or OPEN.
    open_blocks: (k,) intp, increasing, the blocks that are OPEN.
    open_levels: (k, LEAF) uint8, the LODs of the agents in these; CULLED if not seen.
    """

    leaves: np.ndarray
    open_blocks: np.ndarray
    open_levels: np.ndarray


def fill_blocks(order: np.ndarray) -> np.ndarray:
    """Return the order (n,) with the last agent repeated to fill all blocks."""
    beyond = -len(order) % _largest(len(order))
    return np.append(order, np.full(beyond, order[-1])) if beyond else order


def _largest(count: int) -> int:
    """Return how many of `count` agents one of the largest blocks holds."""
    size = LEAF
    while count > size * FIRST:
        size *= FAN
    return size


def blocks_of(
    crowd: Crowd,
    order: np.ndarray,
    spheres: Spheres,
    area: Area,
    wraps: tuple | None = None,
    span: tuple[float, float] | None = None,
) -> Blocks:
    """Return the blocks of `crowd`.

    order: from `fill_blocks`.
    area: the crowd's ground. The boxes also hold agents that leave it and are put back onto it.
    wraps: (least, most) displacement (3,) within which the boxes will be used, if agents that leave
        the area come back at its other side.
    span: the least and greatest z of the ground that agents climb; None if their z stays.

    Needs at most about 9 bytes an agent, of which the result keeps 5.
    """
    count = len(crowd)
    rows = order.reshape(-1, LEAF)
    leaves = len(rows)
    size = _largest(count)
    group = crowd.group[rows[:, (0, -1)].T]
    center = spheres.center
    radius = spheres.reach
    boxes = np.empty((8, leaves))
    low, high, radii = np.split(boxes, [3, 6])
    with np.errstate(invalid="ignore"):
        floor = float(crowd.z[0]) if span is None and crowd.z.min() == crowd.z.max() else None
        _enclose(low, high, crowd, rows, floor)
        _stay(low, high, area, wraps, span)
        low[2] += _over(center, np.minimum)[*group]
        high[2] += _over(center, np.maximum)[*group]
        radii[0] = _over(radius, np.minimum)[*group]
        radii[1] = _over(radius, np.maximum)[*group]
        extent = float(max(np.abs(low).max(), np.abs(high).max()))
        tiers = [(LEAF, boxes, group)]
        while tiers[0][0] < size:
            tiers.insert(0, _joined(*tiers[0]))
        for _, boxes, _ in tiers:
            _center(boxes)
    return Blocks(
        rows=rows,
        groups=np.append(0, np.cumsum(_group_sizes(crowd.group, len(center)))),
        spheres=np.array([center, radius]),
        tiers=tiers,
        extent=extent,
        finite=bool(np.isfinite(extent)),
        floor=floor,
    )


def _enclose(
    low: np.ndarray, high: np.ndarray, crowd: Crowd, rows: np.ndarray, floor: float | None
) -> None:
    """Set the corners low and high (3, b) of boxes about the feet of each block's agents."""
    low[2] = high[2] = floor or 0.0
    for at in range(0, len(rows), COLUMNS // 4):
        part = slice(at, at + COLUMNS // 4)
        # transposed, a block a column, so that many blocks are compared at a time
        agents = rows[part].T.astype(np.intp, order="C")
        places = [column[agents] for column in (crowd.x, crowd.y)]
        if floor is None:
            places.append(crowd.z[agents])
        for axis, place in enumerate(places):
            low[axis, part] = place.min(axis=0)
            high[axis, part] = place.max(axis=0)


def _center(boxes: np.ndarray) -> None:
    """Turn the two corners of `boxes` (8, b) into center and half width, in place."""
    low = boxes[:3]
    high = boxes[3:6]
    half = (high - low) / 2
    low[:] = (low + high) / 2
    high[:] = half


def _group_sizes(group: np.ndarray, groups: int) -> np.ndarray:
    """Return the agents of each group, (groups,) intp, from those of all agents (n,) uint8."""
    if groups == 1:
        return np.array([len(group)])
    # bincount copies its input as numbers of 8 bytes: a part at a time takes less memory
    size = morton_order.BLOCK
    parts = (group[at : at + size] for at in range(0, len(group), size))
    return np.sum([np.bincount(part, minlength=groups) for part in parts], axis=0)


def _joined(size: int, boxes: np.ndarray, group: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
    """Return the next larger tier: every FAN blocks joined into one.

    boxes: (8, b), with the least and greatest corners in place of center and half width.
    """
    parts = boxes.reshape(8, -1, FAN)
    least = parts.min(axis=2)
    most = parts.max(axis=2)
    return (
        size * FAN,
        np.concatenate([least[:3], most[3:6], least[6:7], most[7:]]),
        np.array([group[0, ::FAN], group[1, FAN - 1 :: FAN]]),
    )


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


def _over(values: np.ndarray, extreme: np.ufunc) -> np.ndarray:
    """Return (G, G): at [a, b] the extreme of `values` (G,) of groups a to b.

    extreme: np.minimum or np.maximum.
    """
    rows = np.broadcast_to(values, (len(values), len(values)))
    worst = np.inf if extreme is np.minimum else -np.inf
    return extreme.accumulate(np.where(np.tri(len(values), k=-1, dtype=bool), worst, rows), axis=1)


@np.errstate(invalid="ignore", over="ignore", under="ignore")
def decide(
    blocks: Blocks,
    crowd: Crowd,
    views: Sequence[Sequence[Look]],
    thresholds: np.ndarray | None,
    margin: float | None = None,
) -> tuple[BlockDecisions, np.ndarray]:
    """Return (decided, places): what the blocks decide, and which agents stay open.

    crowd: as it stands at the first of the looks' times.
    views: for each time at which agents may be seen, the Looks of the eyes. LODs follow from the
        first time's.
    thresholds: (G, n - 1) meters where LODs begin; None if they depend on more than distance.
    margin: as for `radar`.

    places: (m,) intp, increasing, indices of the open agents in decided.open_levels, flattened,
        where they are CULLED so far.
    """
    ranges = [] if thresholds is None else [_range_of(by_group) for by_group in thresholds.T]
    leaves = np.full(len(blocks.rows), CULLED, np.uint8)
    opened = np.arange(blocks.tiers[0][1].shape[1])
    tests = [[BoxTest(look, blocks.extent, margin) for look in eyes] for eyes in views]
    for tier, (size, boxes, group) in enumerate(blocks.tiers):
        parts = FAN if tier else 1
        undecided = [opened[:0]]
        for at in range(0, len(opened), COLUMNS // parts):
            whole = opened[at : at + COLUMNS // parts]
            numbers = (whole[:, None] * parts + np.arange(parts)).ravel()
            tested = np.ones((9, len(numbers)))
            boxes.reshape(8, -1, parts).take(
                whole, axis=1, out=tested[:8].reshape(8, -1, parts), mode="clip"
            )
            outside, level = _test(tests, ranges, tested, group[:, numbers])
            leveled = (level < CULLED).nonzero()[0] if thresholds is not None else numbers[:0]
            leaves.reshape(-1, size // LEAF)[numbers[leveled]] = level[leveled, None]
            is_open = ~outside
            is_open[leveled] = False
            undecided.append(numbers[is_open])
        opened = np.concatenate(undecided)
    # Copies of the last agent fill its block, and all blocks behind that one.
    last, remainder = divmod(int(blocks.groups[-1]), LEAF)
    leaves[last + (remainder > 0) :] = CULLED
    opened = opened[: np.searchsorted(opened, last + (remainder > 0))]
    if remainder and leaves[last] < CULLED:
        opened = np.append(opened, last)
    leaves[opened] = OPEN
    decided = BlockDecisions(leaves, opened, np.full((len(opened), LEAF), CULLED, np.uint8))
    count = len(opened) * LEAF
    if remainder and leaves[last] == OPEN:
        count -= LEAF - remainder
    if len(views) == 1 and thresholds is not None and all(test.linear for test in tests[0]):
        return decided, _alone(blocks, crowd, tests[0], thresholds, decided, count)
    return decided, np.arange(count)


def near(
    blocks: Blocks,
    leaves: np.ndarray,
    moved: tuple[np.ndarray, np.ndarray],
    grown: float,
    about: float,
    touches: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> np.ndarray:
    """Return the smallest blocks that may hold agents kept by `touches`, (m,) intp.

    leaves: (b,) bool, the smallest blocks to test.
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
        return leaves.nonzero()[0]
    shift = (least + most)[:, None] / 2
    wider = (most - least)[:, None] / 2
    numbers = np.arange(blocks.tiers[0][1].shape[1])
    for tier, (size, boxes, _) in enumerate(blocks.tiers):
        if tier:
            numbers = (numbers[:, None] * FAN + np.arange(FAN)).ravel()
        numbers = numbers[leaves.reshape(-1, size // LEAF).any(axis=1)[numbers]]
        box = boxes.take(numbers, axis=1)
        radius = np.sqrt(((box[3:6] + wider) ** 2).sum(axis=0)) + box[7] + (grown + SLACK * about)
        numbers = numbers[touches((box[:3] + shift).T, radius)]
    return numbers


def _alone(
    blocks: Blocks,
    crowd: Crowd,
    tests: list[BoxTest],
    thresholds: np.ndarray,
    decided: BlockDecisions,
    count: int,
) -> np.ndarray:
    """Decide agents that are clearly in or out; return the places (m,) of the rest.

    count: how many agents of decided.open_levels, flattened, are tested. The places are indices
        into the same array; only exact tests decide those.
    """
    left = [np.arange(0)]
    slack = max(test.slack for test in tests)
    center, radius = blocks.spheres
    uniform = (thresholds == thresholds[0]).all()
    by_group = thresholds.T[:, :1] if uniform else np.ascontiguousarray(thresholds.T)
    order = blocks.rows.take(decided.open_blocks, axis=0).ravel()
    levels = decided.open_levels.reshape(-1)
    groups = None
    if len(center) > 1:
        sizes = np.diff(edges(crowd.group, order[:count], len(center)))
        groups = np.repeat(np.arange(len(center), dtype=np.uint8), sizes)
    for start in range(0, count, PART):
        part = slice(start, min(start + PART, count))
        agents = order[part].astype(np.intp)
        group = 0 if groups is None else groups[part]
        spheres = np.empty((5, len(agents)))
        feet = crowd.z.take(agents, mode="clip") if blocks.floor is None else blocks.floor
        spheres[0] = crowd.x.take(agents, mode="clip")
        spheres[1] = crowd.y.take(agents, mode="clip")
        spheres[2] = feet + center.take(group)
        spheres[3] = radius.take(group)
        spheres[4] = 1.0
        outside, inside, distance = tests[0].alone(spheres)
        for test in tests[1:]:
            eye_outside, eye_inside, eye_distance = test.alone(spheres)
            outside = outside & eye_outside
            inside = inside | eye_inside
            distance = np.minimum(distance, eye_distance)
        beyond = distance - (by_group if uniform else by_group.take(group, axis=1))
        level = np.add.reduce((beyond >= 0).view(np.uint8), axis=0, dtype=np.uint8)
        sure = inside & ~np.logical_or.reduce(np.abs(beyond) <= slack, axis=0)
        levels[part] = _or_culled(level, inside)
        left.append((~(outside | sure)).nonzero()[0] + start)
    return np.concatenate(left)


def edges(group: np.ndarray, agents: np.ndarray, groups: int) -> np.ndarray:
    """Return where each group begins in `agents` (m,), and where the last one ends.

    Returns (groups + 1,) intp.

    group: (n,), of all agents; only a few entries are read.
    agents: ordered group by group.
    """
    return np.array(
        [*(bisect_left(agents, g, key=group.__getitem__) for g in range(groups)), len(agents)]
    )


def _range_of(by_group: np.ndarray) -> tuple:
    """Return the (latest, earliest) threshold of a LOD, meters.

    Each is one number, or (G, G): for the groups a to b at [a, b].

    by_group: (G,) meters, where each group's LOD begins.
    """
    if (by_group == by_group[0]).all():
        return by_group[0], by_group[0]
    return _over(by_group, np.maximum), _over(by_group, np.minimum)


def _test(
    tests: list[list[BoxTest]],
    ranges: list[tuple],
    boxes: np.ndarray,
    group: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return (outside, level), each (b,), for the boxes (9, b).

    tests: for each time, those of the eyes.
    ranges: of each threshold, from `_range_of`.
    group: (2, b), the boxes' first and last group.
    outside: whether no camera sees the box.
    level: the LOD of boxes seen wholly and in one LOD, else CULLED.
    """
    (outside, inside, nearest, farthest), *other_results = (test(boxes) for test in tests[0])
    for _, _, eye_nearest, eye_farthest in other_results:
        nearest = np.minimum(nearest, eye_nearest)
        farthest = np.minimum(farthest, eye_farthest)
    other_results += [test(boxes) for eyes in tests[1:] for test in eyes]
    for eye_outside, eye_inside, *_ in other_results:
        outside = outside & eye_outside
        inside = inside | eye_inside
    finest, coarsest = np.zeros((2, boxes.shape[1]), np.uint8)
    for latest, earliest in ranges:
        latest = latest[*group] if np.ndim(latest) else latest
        earliest = earliest[*group] if np.ndim(earliest) else earliest
        finest += (nearest >= latest).view(np.uint8)
        coarsest += (farthest >= earliest).view(np.uint8)
    return outside, _or_culled(finest, inside & (finest == coarsest))


def _or_culled(levels: np.ndarray, is_visible: np.ndarray) -> np.ndarray:
    """Return `levels` (b,) uint8, with CULLED where not `is_visible` (b,) bool.

    CULLED has all bits set, so that this is several times as fast as np.where.
    """
    return levels | (is_visible.view(np.uint8) - np.uint8(1))
