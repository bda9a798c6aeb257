"""Choice of a character's LODs from candidates, by a tolerance in pixels.

And the deviations that a shot allows its LODs, with curves through what is known of these.
"""

from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np

from ..crowd.agents import Group
from ..culling.camera import Camera
from ..errors import CrowdError
from ..messages import Message, MessageKind
from ..progress import finished
from .assignment import MOST_LEVELS, LevelPolicy, deviations, threshold_distances
from .cost_model import NAMES, Actors, Costs, Holdings, Price, price, work_of

PRECISE = 1.002  # factor within which the least tolerance is found


def least_tolerance(
    fits: Callable[[float], bool], low: float, high: float
) -> Generator[None, None, float]:
    """Find by bisection the least tolerance from `low` on that fits: yield at each, return it.

    fits: whether a tolerance fits, in pixels; what a larger one takes is no more.
    low: pixels, above 0.
    high: pixels, which fit.
    """
    if fits(low):
        return low
    while high > PRECISE * low:
        yield
        middle = float(np.sqrt(low * high))
        if fits(middle):
            high = middle
        else:
            low = middle
    return high


LEAST_SAVED = 0.2  # of the triangles of the next finer LOD, else a LOD is not worth a mesh
WORTH = 0.05  # of the least time or memory that is found: what a LOD has to save
MOST_RAISED = 2.0**15  # factor by which a tolerance rises at most until LODs fit in memory
# between two frames that were looked at, agents may be nearer or farther by this factor
BETWEEN = 1.25
CLOSE = 1.05  # so many times as far is about as far


@dataclass(frozen=True)
class View:
    """A group's agents in one frame of the shot.

    nearest, farthest: meters from `camera`, of all the group's agents.
    distance: (m,) meters, of each agent; empty if not known.
    character: (m,) intp, which of its group's characters each agent shows
        (animation/phase_classes.py, Cast); empty if not known.
    agents: (m,) intp, how many agents stand there; or 1.
    frame: of the timeline.
    lods: (m, 2) intp, the finest and the coarsest LOD that overrides allow; or (2,), of all.
    """

    camera: Camera
    nearest: float
    farthest: float
    distance: np.ndarray = field(default_factory=lambda: np.empty(0))
    character: np.ndarray = field(default_factory=lambda: np.empty(0, np.intp))
    agents: np.ndarray | int = 1
    frame: int = 0
    lods: np.ndarray = field(default_factory=lambda: np.array([0, MOST_LEVELS]))

    def counted(self) -> "View":
        """Return the view with agents of a character together that stand within CLOSE of each
        other.
        """
        steps = np.floor(np.log(self.distance.clip(1e-9)) / np.log(CLOSE)).astype(np.intp)
        lods = np.broadcast_to(self.lods, (len(steps), 2)).T
        cells = np.stack([steps, self.character, *lods])
        (steps, character, *bounds), agents = np.unique(cells, axis=1, return_counts=True)
        return replace(
            self,
            distance=CLOSE ** (steps + 0.5),
            character=character,
            agents=agents,
            lods=np.stack(bounds, axis=1),
        )


def choose(
    group: Group,
    tolerance: float,
    views: Sequence[View],
    meters: float = 1.0,
    given: Collection[int] = (),
) -> tuple[list[int], dict[int, Message]]:
    """Return (candidates to keep, {dropped candidate: why}).

    The first is always kept: it is the character. Another one is dropped in these cases:
    - One with fewer triangles deviates no more.
    - A coarser one was given that has about as many triangles: what artists made goes before.
    - It saves less than LEAST_SAVED of the triangles of the next finer one kept.
    - In no view an agent is at a distance at which it would be used within the tolerance.
    group: with triangles and bounds of its candidates, finest first.
    tolerance: pixels.
    meters: the length of a unit in meters, for the messages.
    given: candidates that artists made. Only the last two rules drop these.
    """
    candidates, dropped = _worth_making(group, given)
    deviation = np.array([[group.bounds[k] for k in candidates]])
    policy = LevelPolicy((0.0,) * (len(candidates) - 1), tolerance=tolerance)
    is_used = np.zeros(len(candidates), bool)
    rows = []
    for view in views:
        row = threshold_distances(policy, view.camera, np.array([group.radius]), deviation)[0]
        row = np.concatenate([[-np.inf], row, [np.inf]])
        is_used |= (
            (row[:-1] < row[1:])
            & (row[:-1] <= view.farthest * BETWEEN)
            & (row[1:] > view.nearest / BETWEEN)
        )
        rows.append(row)
    thresholds = np.array(rows)
    for j in (np.flatnonzero(~is_used[1:]) + 1).tolist():
        k = candidates[j]
        if (np.isfinite(thresholds[:, j + 1]) & (thresholds[:, j] >= thresholds[:, j + 1])).all():
            fewer = group.triangles[candidates[j + 1]]
            dropped[k] = _not_made(MessageKind.DEVIATES_AS_MUCH, group, k, fewer=fewer)
        else:
            kind, facts = _unused(j, thresholds, views, meters)
            dropped[k] = _not_made(kind, group, k, **facts)
    return [k for k, needed in zip(candidates, is_used, strict=True) if needed or k == 0], dropped


def _not_made(kind: MessageKind, group: Group, k: int, **facts: Any) -> Message:
    """Return why candidate `k` is not made."""
    lod = {"triangles": int(group.triangles[k]), "measured": True}
    return Message(kind, group.name, lod | facts)


def _worth_making(group: Group, given: Collection[int]) -> tuple[list[int], dict[int, Message]]:
    """Return (candidates, {dropped candidate: why}) by the rules of `choose` without views."""
    candidates = [0]
    dropped = {}
    for k in range(1, len(group.triangles)):
        count = group.triangles[k]
        finer = group.triangles[candidates[-1]]
        coarser = zip(group.triangles[k + 1 :], group.bounds[k + 1 :], strict=True)
        lower = [n for n, deviation in coarser if n < count and deviation <= group.bounds[k]]
        rivals = [group.triangles[n] for n in given if n > k and k not in given]
        rivals = [triangles for triangles in rivals if triangles > (1 - LEAST_SAVED) * count]
        if rivals:
            dropped[k] = _not_made(MessageKind.BESIDE_GIVEN, group, k, given=int(rivals[0]))
        elif lower and k not in given:
            dropped[k] = _not_made(MessageKind.DEVIATES_AS_MUCH, group, k, fewer=int(lower[0]))
        elif count > (1 - LEAST_SAVED) * finer:
            dropped[k] = _not_made(MessageKind.SAVES_LITTLE, group, k, finer=int(finer))
        else:
            candidates.append(k)
    return candidates, dropped


def _unused(
    j: int, thresholds: np.ndarray, views: Sequence[View], meters: float
) -> tuple[MessageKind, dict[str, Any]]:
    """Return why no agent uses candidate j: the kind of message, and its facts.

    The numbers are those of the view that comes closest to using it.
    thresholds: (views, candidates + 1) meters, where each candidate begins and where the last ends.
    """
    begin = thresholds[:, j]
    end = thresholds[:, j + 1]
    nearest, farthest = np.array([(view.nearest, view.farthest) for view in views]).T
    coarse = begin > farthest
    if np.isinf(begin).all() and coarse.all() and views[0].camera.kind != "ORTHO":
        return MessageKind.NEVER_ALIKE, {}
    if np.isinf(begin).all() and coarse.all():
        return MessageKind.TOO_COARSE, {}
    if np.isinf(begin).all() and not coarse.any():
        return MessageKind.TOO_FINE, {}
    if coarse.all():
        i = (begin / farthest).argmin()
        far = {"begin": float(meters * begin[i]), "farthest": float(meters * farthest[i])}
        return MessageKind.BEGINS_TOO_FAR, far
    if not coarse.any():
        i = (end / nearest).argmax()
        near = {"end": float(meters * end[i]), "nearest": float(meters * nearest[i])}
        return MessageKind.ENDS_TOO_NEAR, near
    return MessageKind.TOO_FEW, {"few": int(coarse.sum()), "frames": len(views)}


@dataclass(frozen=True)
class GroupShot:
    """What determines the price of a group's LODs.

    views: where the shot has agents of the group.
    characters: how many characters of the group a build has.
    costs: of the engine, on the machine that renders.
    holdings: of the group; armatures and bones are means over these characters.
    """

    views: Sequence[View]
    characters: int
    costs: Costs
    holdings: Holdings = Holdings()


def counting(group: Group, tolerance: float, shot: GroupShot) -> Group:
    """Return the group with bounds that include what colors ask for.

    tolerance: pixels.
    """
    policy = LevelPolicy((0.0,) * (len(group.bounds) - 1), tolerance=tolerance)
    table = deviations((group,), policy)
    assert table is not None  # the policy has as many LODs as the group has bounds
    return replace(group, bounds=tuple(table[0].tolist()))


def allowed(
    group: Group, candidates: Sequence[int], tolerance: float, shot: GroupShot
) -> np.ndarray:
    """Return (F, K, N) intp: how many agents may show each candidate at the coarsest.

    An agent counts at the coarsest of the `candidates`, finest first, that stays within the
    tolerance in pixels: for each of F views, K candidates and N characters.
    """
    policy = LevelPolicy((0.0,) * (len(candidates) - 1), tolerance=tolerance)
    deviation = np.array([[group.bounds[k] for k in candidates]])
    counts = np.zeros((len(shot.views), len(candidates), shot.characters), np.intp)
    for view_counts, view in zip(counts, shot.views, strict=True):
        row = threshold_distances(policy, view.camera, np.array([group.radius]), deviation)[0]
        np.add.at(
            view_counts,
            (np.searchsorted(row, view.distance, side="right"), view.character),
            view.agents,
        )
    return counts


def priced(
    group: Group, candidates: Sequence[int], tolerance: float, shot: GroupShot
) -> Iterator[tuple[tuple[int, ...], Price]]:
    """Yield (chosen candidates, price of a build with them) for each usable choice.

    A choice of `candidates` is usable if it has one for every agent of the shot.
    """
    may = allowed(group, candidates, tolerance, shot)
    needed = np.flatnonzero(may.any(axis=(0, 2)))
    owner = np.zeros(shot.characters, np.intp)
    for count in range(1, len(candidates) + 1):
        for choice in combinations(range(len(candidates)), count):
            if len(needed) and choice[0] > needed[0]:
                continue
            agents = np.add.reduceat(may[:, choice[0] :], np.array(choice) - choice[0], axis=1)
            triangles = np.array([[group.triangles[candidates[j]] for j in choice]])
            stored = sum(group.triangles[candidates[j]] for j in choice if candidates[j])
            work = work_of(Actors(triangles, owner, shot.holdings, stored), agents)
            yield tuple(candidates[j] for j in choice), price(work, shot.costs)


def cheapest(
    group: Group,
    candidates: Sequence[int],
    tolerance: float,
    shot: GroupShot,
    measured: Collection[int] = (),
    given: Collection[int] = (),
) -> tuple[list[int], dict[int, Message]]:
    """Return (the candidates that cost least, {dropped candidate: why}).

    Time counts first, then memory, then LODs, which take time to be made:
    of the choices that take at most WORTH more time than the quickest, those remain that take at
    most WORTH more memory than the smallest of them. Of these the one with the fewest LODs is
    taken, then the one with the most `measured` candidates. Those `given` by artists are taken. The
    first candidate is kept for agents that come nearer than the shot shows. All are kept if the
    distances of the shot's agents are not known.
    """
    if not any(len(view.distance) for view in shot.views):
        return list(candidates), {}
    wanted = set(given).intersection(candidates)
    prices = {
        choice: price
        for choice, price in priced(group, candidates, tolerance, shot)
        if choice[0] == candidates[0] and wanted.issubset(choice)
    }
    quick = _near_least({choice: price.seconds for choice, price in prices.items()})
    small = _near_least({choice: prices[choice].memory for choice in quick})
    best = min(
        small,
        key=lambda choice: (
            len(choice),
            len(set(choice).difference(measured)),
            prices[choice].seconds,
        ),
    )
    dropped = [k for k in candidates if k not in best]
    return list(best), {
        k: _not_made(MessageKind.NOT_WORTH_IT, group, k, engine=NAMES[shot.costs.engine])
        for k in dropped
    }


def _near_least(costs: Mapping[tuple[int, ...], float]) -> list[tuple[int, ...]]:
    """Return the choices whose cost is at most WORTH above the least."""
    most = (1 + WORTH) * min(costs.values())
    return [choice for choice, cost in costs.items() if cost <= most]


def _least(
    group: Group, candidates: Sequence[int], tolerance: float, shot: GroupShot
) -> tuple[tuple[int, ...], Price]:
    """Return (the choice of `candidates` that takes least memory, its price).

    It is all of `candidates` if the distances of the shot's agents are not known.
    """
    prices = dict(priced(group, candidates, tolerance, shot))
    best = min(prices, key=lambda choice: (prices[choice].memory, len(choice)))
    best = best if any(len(view.distance) for view in shot.views) else tuple(candidates)
    return best, prices[best]


def fit_in_memory(
    groups: Sequence[Group], tolerance: float, shots: Sequence[GroupShot], memory: float
) -> tuple[float, list[list[int]], list[tuple[int, ...]]]:
    """Return the least tolerance at which the groups' LODs fit in `memory` bytes.

    Returns (tolerance in pixels, candidates that each group keeps, candidates that it builds).
    tolerance: pixels, to begin with.
    CrowdError if none is enough.
    """

    @cache
    def built(pixels: float) -> list[tuple[tuple[int, ...], Price]]:
        found = []
        for group, shot in zip(groups, shots, strict=True):
            counted = counting(group, pixels, shot)
            keep, _ = choose(counted, pixels, shot.views)
            found.append(_least(counted, keep, pixels, shot))
        return found

    def bytes_at(pixels: float) -> float:
        return sum(price.memory for _, price in built(pixels))

    most = MOST_RAISED * tolerance
    least = bytes_at(most)
    if least > memory:
        raise CrowdError(
            f"The characters cannot take less than {np.ceil(least / 1e6):,.0f} MB: set "
            "Character Memory to that, or use fewer character groups."
        )
    search = least_tolerance(lambda pixels: bytes_at(pixels) <= memory, tolerance, most)
    reached = finished(search)
    choices = [choice for choice, _ in built(reached)]
    return reached, [sorted({0, *choice}) for choice in choices], choices


MOST_LENGTHS = MOST_LEVELS - 1
APART = 1.25  # times the length before, at least: with less, next to no triangles are saved
COARSEST = 0.25  # of the radius: a LOD that deviates more is a few triangles whatever the length
# of a length, by which a LOD deviates that was made for another: it takes few triangles more than
# the length needs
NEAR_ENOUGH = 0.87
DIGITS = 4  # of a length, so that it is the same the next time


def allowed_lengths(
    views: Sequence[View],
    radius: float,
    tolerance: float,
    finest: float,
    higher: bool = False,
) -> list[float]:
    """Return deviations that agents allow, in meters, rising: from the nearest agent's to the
    farthest's.

    They are a geometric series, of at most MOST_LENGTHS.

    radius: meters, of the agents' bounding sphere.
    tolerance: pixels.
    finest: meters; a LOD that deviates less saves nothing.
    higher: whether also to return those that a higher tolerance allows.
    """
    ends = np.array([_lengths(view, radius, tolerance) for view in views])
    most = COARSEST * radius
    low = float(np.clip(ends[:, 0].min(), min(finest, most), most))
    high = most if higher else float(np.clip(ends[:, 1].max(), low, most))
    count = min(MOST_LENGTHS, int(np.log(high / low) / np.log(APART)) + 1)
    return [_rounded_down(length) for length in np.geomspace(low, high, count)]


def in_gaps(lengths: Sequence[float], given_lengths: Sequence[float]) -> list[float]:
    """Return those `lengths`, meters, that lie farthest from deviations of LODs that are given.

    With these they are at most MOST_LENGTHS.
    """
    left = sorted(lengths)
    away = {
        length: min(abs(np.log(length / other)) for other in given_lengths)
        for length in left
        if given_lengths
    }
    while len(left) + len(given_lengths) > MOST_LENGTHS:
        left.remove(min(left, key=lambda length: away[length]))
    return left


def _lengths(view: View, radius: float, tolerance: float) -> tuple[float, float]:
    """Return what shows `tolerance` pixels of the nearest and of the farthest agent, in meters."""
    pixel = tolerance / view.camera.pixels_per_unit
    if view.camera.kind == "ORTHO":
        return pixel, pixel
    return pixel * max(view.nearest - radius, 0.0), pixel * max(view.farthest - radius, 0.0)


def _rounded_down(length: float) -> float:
    """Return `length` with DIGITS digits, no larger."""
    step = 10.0 ** (np.floor(np.log10(length)) + 1 - DIGITS)
    return float(f"{np.floor(length / step * (1 + 1e-12)) * step:.{DIGITS}g}")


def read_curve(
    at: Sequence[float], pairs: Iterable[tuple[float, float]], power: float
) -> np.ndarray:
    """Return values (k,) at `at` of the falling or rising curve through the points `pairs`.

    It is linear between the points' logarithms. Beyond the first and the last it goes as x **
    power. Where points contradict the sign of `power`, the least value counts. `pairs` has one
    point at least; all is positive.
    """
    x, y = np.log(np.array(sorted(pairs))).T
    y = np.minimum.accumulate(y) if power < 0 else np.minimum.accumulate(y[::-1])[::-1]
    x, first = np.unique(x, return_index=True)
    y = y[np.append(first[1:], len(y)) - 1] if power < 0 else y[first]
    x_at = np.log(np.asarray(at, np.float64))
    beyond = np.minimum(x_at - x[0], 0) + np.maximum(x_at - x[-1], 0)
    return np.exp(np.interp(x_at, x, y) + power * beyond)
