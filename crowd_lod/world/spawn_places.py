"""Places where a crowd spawns: on surfaces, on a grid, in rows along curves.

The same arguments give the same places, bit for bit.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..crowd.agents import CLASSES, Crowd, Shares
from ..crowd.state_machine import StateMachine
from ..errors import CrowdError
from . import first_frame
from .first_frame import check_counts, place_agents
from .maps import Area, LabelMap

# Places drawn on a surface until one stays, at most.
TRIES = 20_000
# Places drawn on a surface at a time, at most.
AT_A_TIME = 2**18
MOST_EDGES = 200_000  # about a second
# Meters: points of a curve that are closer together count as one.
ONE_POINT = 1e-6
# A length that float32 has rounded down still has room: 20 m for 25 agents at 0.8 m.
ENOUGH = 1 + 1e-6
# At a bend the way from one row to the next grows, to this many times their depth at most.
SHARPEST = 2.0

# (points (k, 3), triangles (k,), weights of their corners (k, 3)) -> the chance (k,), 0 to 1, that
# a place there is kept.
Density = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Places:
    """n places in world space.

    points: (n, 3) float64, meters, the feet.
    heading: (n,) float32, radians from +x, counter-clockwise; NaN where the place has none.
    """

    points: np.ndarray
    heading: np.ndarray

    def __len__(self) -> int:
        return len(self.points)

    def of(self, places: np.ndarray) -> "Places":
        """Return the `places`, indices or (n,) bool, alone."""
        return Places(self.points[places], self.heading[places])


@dataclass(frozen=True)
class Spacing:
    """How agents stand in a grid or in rows.

    apart: meters between neighbors; 0 for the distance that gives as many places as agents.
    rows: how many rows stand along each curve.
    depth, rise: meters from one row to the next, outward and up.
    turn: radians, added to the heading.
    """

    apart: float = 0.0
    rows: int = 1
    depth: float = 0.9
    rise: float = 0.0
    turn: float = 0.0


def without_heading(points: np.ndarray) -> Places:
    """Return places without headings at `points` (n, 3)."""
    return Places(points, np.full(len(points), np.nan, np.float32))


def facing(places: Places, x: float, y: float) -> Places:
    """Return the places with headings toward (x, y), world meters."""
    away = np.array((x, y)) - places.points[:, :2]
    return Places(places.points, np.arctan2(away[:, 1], away[:, 0]).astype(np.float32))


def on_surface(
    corners: np.ndarray, weights: np.ndarray, count: int, seed: int, density: Density | None = None
) -> Places:
    """Return `count` places on triangles, drawn by area times density.

    corners: (m, 3, 3) float64, world meters.
    weights: (m, 3), the density at the corners, 0 or more; it is linear between them.
    density: a further factor.
    CrowdError without faces, at NaN, or where the density is 0 everywhere, or nearly so.
    """
    check_counts(count)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.sqrt(normal[:, 0] ** 2 + normal[:, 1] ** 2 + normal[:, 2] ** 2)
    if not np.isfinite(area).all() or not np.isfinite(weights).all():
        raise CrowdError(
            "The surface to spawn on has points or weights at NaN or infinity: mend its mesh or "
            "its modifiers."
        )
    if not area.any():
        raise CrowdError("The surface to spawn on has no faces: give it a mesh with faces.")
    # a linear density is the sum of three, one of each corner: a corner is drawn, then a place
    until = np.cumsum((area[:, None] * weights).ravel())
    if not until[-1] > 0:
        raise CrowdError(
            "The surface to spawn on has density 0 everywhere: paint its vertex group above 0 "
            "somewhere."
        )
    random = np.random.Generator(np.random.PCG64(seed))
    parts: list[np.ndarray] = []
    placed = 0
    tries = 0
    while placed < count:
        missing: float = count - placed
        if density is not None:  # about as many as are needed, by the share that stayed so far
            share = max(placed / tries, 1 / 1000) if tries else 1.0
            missing = 1.2 * missing / share
        ask = int(np.clip(missing, 16, AT_A_TIME))
        points, triangle, weight = _draw(corners, until, ask, random)
        if density is not None:
            points = points[random.random(ask) < density(points, triangle, weight)]
        parts.append(points)
        placed += len(points)
        tries += ask
        if tries > TRIES * (placed + 100):
            raise CrowdError(
                "The surface to spawn on has density 0 nearly everywhere: brighten the image, or "
                "move the volumes that give it."
            )
    return without_heading(np.concatenate(parts)[:count])


def _draw(
    corners: np.ndarray, until: np.ndarray, count: int, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (points (count, 3), triangles (count,), weights of their corners (count, 3)).

    until: (3 m,), the sum of the shares of all corners up to each.
    """
    # the last corner that has a share: the product may round up to the whole
    last = np.searchsorted(until, until[-1])
    at = np.minimum(np.searchsorted(until, random.random(count) * until[-1], side="right"), last)
    triangle, corner = np.divmod(at, 3)
    # three sorted numbers part 1 in four; two of the parts belong to the corner
    ends = np.sort(random.random((3, count)), axis=0)
    weight = np.empty((count, 3))
    rows = np.arange(count)
    weight[rows, corner] = ends[1]
    weight[rows, (corner + 1) % 3] = ends[2] - ends[1]
    weight[rows, (corner + 2) % 3] = 1 - ends[2]
    a, b, c = np.moveaxis(corners[triangle], 1, 0)
    points = weight[:, :1] * a + weight[:, 1:2] * b + weight[:, 2:] * c
    return points, triangle, weight


def on_grid(area: Area, count: int, spacing: Spacing) -> Places:
    """Return places in a grid over the `area`, from its lower left corner on.

    With a distance the area fixes their number; without one there are `count`.
    CrowdError if a count is out of range.
    """
    width, depth = area.size
    if spacing.apart:
        columns = max(int(width / spacing.apart * ENOUGH), 1)
        rows = max(int(depth / spacing.apart * ENOUGH), 1)
        count = columns * rows
        check_counts(count)
        across = up = spacing.apart
    else:
        check_counts(count)
        columns = max(round(np.sqrt(count * width / depth)), 1)
        rows = -(-count // columns)
        across = width / columns
        up = depth / rows
    row, column = np.divmod(np.arange(count), columns)
    left = (area.x_min + area.x_max - columns * across) / 2
    low = (area.y_min + area.y_max - rows * up) / 2
    x = left + (column + 0.5) * across
    y = low + (row + 0.5) * up
    return without_heading(np.stack([x, y, np.full(count, area.z)], axis=1))


def in_rows(curves: Sequence[tuple[np.ndarray, bool]], count: int, spacing: Spacing) -> Places:
    """Return places in rows along curves.

    All face inward from a closed curve, and to the right of an open one. The first row lies on the
    curve, and each further one behind it. With a distance the curves fix the number of places;
    without one there are `count`, spread evenly over all rows.

    curves: of each its points (k, 3) float64, world meters, and whether it is closed.
    CrowdError if no curve has a length, a point is at NaN, or the count is out of range.
    """
    rows = [
        _row(points, closed, k, spacing) for points, closed in curves for k in range(spacing.rows)
    ]
    rows = [(points, lengths) for points, lengths in rows if len(lengths)]
    totals = [float(lengths.sum()) for _, lengths in rows]
    total = sum(totals)
    if not total > 0:
        raise CrowdError(
            "The curves to spawn along have no length: give the object splines or edges that are "
            "longer than 0."
        )
    if spacing.apart:
        counts = [max(int(length / spacing.apart * ENOUGH), 1) for length in totals]
    else:
        check_counts(count)
        until = np.rint(np.cumsum(totals) / total * count).astype(int)
        counts = np.diff(until, prepend=0).tolist()
    check_counts(sum(counts))
    parts = [
        _along(points, lengths, number, spacing.turn)
        for (points, lengths), number in zip(rows, counts, strict=True)
    ]
    return Places(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.heading for part in parts]),
    )


def chains(edges: np.ndarray, count: int) -> list[tuple[np.ndarray, bool]]:
    """Return the chains of a wire, each its points (k,) intp in order, and whether it is closed.

    A chain ends where more than two edges meet. It goes on from its end that was made first.

    edges: (e, 2), the points that each joins.
    count: of all points.
    CrowdError beyond MOST_EDGES.
    """
    if len(edges) > MOST_EDGES:
        raise CrowdError(
            f"The curves to spawn along have {len(edges):,} edges, more than {MOST_EDGES:,}: "
            f"choose a curve or a wire."
        )
    beside: list[list[int]] = [[] for _ in range(count)]
    for a, b in edges.tolist():
        beside[a].append(b)
        beside[b].append(a)
    unused = {(a, b) for a, b in edges.tolist()} | {(b, a) for a, b in edges.tolist()}
    wires = []
    ends = [point for point in range(count) if len(beside[point]) not in (0, 2)]
    for start in [*ends, *range(count)]:
        for onward in sorted(beside[start]):
            chain = [start]
            while (chain[-1], onward) in unused:
                unused -= {(chain[-1], onward), (onward, chain[-1])}
                chain.append(onward)
                if len(beside[onward]) == 2:
                    onward = sum(beside[onward]) - chain[-2]
            if len(chain) > 1:
                closed = chain[0] == chain[-1] and len(chain) > 2
                wires.append((np.array(chain[:-1] if closed else chain, np.intp), closed))
    return wires


def _row(
    points: np.ndarray, closed: bool, k: int, spacing: Spacing
) -> tuple[np.ndarray, np.ndarray]:
    """Return (points (p, 3), lengths (p - 1,)) of the row `k` along a curve.

    A closed one ends at its first point.
    """
    if not np.isfinite(points).all():
        raise CrowdError(
            "The curves to spawn along have points at NaN or infinity: mend the object or its "
            "modifiers."
        )
    points = np.concatenate([points, points[:1]]) if closed else points
    points = points[np.append(True, _lengths(points[:, :2]) > ONE_POINT)] if len(points) else points
    if len(points) < 2:
        return points, np.empty(0)
    if closed and _turns_left(points):
        points = points[::-1]
    way = np.diff(points[:, :2], axis=0)
    left = np.stack([-way[:, 1], way[:, 0]], axis=1) / _lengths(points[:, :2])[:, None]
    before = np.concatenate([left[-1:] if closed else left[:1], left])
    after = np.concatenate([left, left[:1] if closed else left[-1:]])
    # where two sides meet, the corner lies on both rows
    both = before + after
    length = np.maximum((both**2).sum(axis=1, keepdims=True), 1e-12)
    corner = both * np.minimum(2 / length, SHARPEST / np.sqrt(length))
    rise = np.full((len(points), 1), k * spacing.rise)
    points = points + np.concatenate([corner * (k * spacing.depth), rise], axis=1)
    return points, _lengths(points)


def _lengths(points: np.ndarray) -> np.ndarray:
    """Return the distances of neighboring points (k, 2) or (k, 3), (k - 1,) meters."""
    return np.sqrt(sum(step**2 for step in np.diff(points, axis=0).T))


def _turns_left(points: np.ndarray) -> bool:
    """Return whether a closed way (k, 3) goes counter-clockwise seen from above.

    It ends where it begins.
    """
    x = points[:, 0] - points[0, 0]
    y = points[:, 1] - points[0, 1]
    return bool((x[:-1] * y[1:] - x[1:] * y[:-1]).sum() > 0)


def _along(points: np.ndarray, lengths: np.ndarray, count: int, turn: float) -> Places:
    """Return `count` places, evenly along one row; their headings are turned by `turn` radians."""
    until = np.append(0.0, np.cumsum(lengths))
    apart = until[-1] / max(count, 1)
    at = (np.arange(count) + 0.5) * apart
    side = np.clip(np.searchsorted(until, at, side="right") - 1, 0, len(lengths) - 1)
    part = (at - until[side]) / np.maximum(lengths[side], ONE_POINT)
    way = points[side + 1] - points[side]
    length = np.maximum(_lengths(points[:, :2])[side], ONE_POINT)
    right = np.stack([way[:, 1], -way[:, 0]], axis=1) / length[:, None]
    places = points[side] + part[:, None] * way
    heading = np.arctan2(right[:, 1], right[:, 0]) + turn
    return Places(places, heading.astype(np.float32))


def stays(machine: StateMachine, world: LabelMap) -> bool:
    """Return whether no agent ever moves, wherever it starts."""
    return not first_frame.reachable_velocities(machine, world, np.flatnonzero(machine.start)).any()


def allowed_agents(places: Places, machine: StateMachine, world: LabelMap) -> np.ndarray:
    """Return which places agents may spawn at, (n,) bool: on the map, where its label lets them."""
    x, y, _ = places.points.T
    return world.area.holds(x, y) & machine.spawn[world.at(x, y)]


def settle(
    places: Places,
    seed: int,
    groups: Shares,
    machine: StateMachine,
    world: LabelMap,
) -> Crowd:
    """Return the crowd's first frame: an agent at each of the places, mixed.

    Headings are those of the places; where they have none, as `populate` gives them. All else is as
    there, too.
    CrowdError if a count is out of range, or a place is at NaN or infinity.
    """
    if not np.isfinite(places.points).all():
        raise CrowdError(
            "Places to spawn are at NaN or infinity: mend the object that they come from."
        )
    check_counts(len(places), groups)
    random = np.random.Generator(np.random.PCG64(seed))
    places = places.of(random.permutation(len(places)))
    points = tuple(places.points.T.copy())
    return place_agents(points, places.heading, random, (seed, groups, CLASSES), machine, world)
