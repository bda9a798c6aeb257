"""Chooses the phase classes of a shot, as colors of a graph whose edges are close neighbors.

Drawn at random, a part 1 / C of all close neighbors is in step. Chosen, four classes leave fewer in
step than sixteen at random do.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..animation.phase_classes import Gaits, Roles
from ..crowd.agents import CLASSES, FEWEST_CLASSES, Group
from ..progress import Workload, open_ended_progress
from .phases import NEAREST, Changes, Meetings, Phases, palette
from .survey import CULLED, SEEN, Survey

VARIETY = 0.05  # of close neighbors, at most, in step: about what CLASSES random classes leave
WHOLE = 3  # times a palette of FEWEST_CLASSES is doubled: it then has all CLASSES
MOST_ROUNDS = 40  # of recoloring; some ten suffice where agents meet few others
ROUNDS = 60  # of all recolorings of a shot: half of the progress
# About what the searches cost: for the fewest classes, for fewer ones of agents that are near
FEWEST, NEARED = 3.0, 1.0
LITTLE = 2e-4  # of the weight of all meetings: a round that gains no more is the last
# Times the tolerance, in pixels, by which a change of class may move a foot. Of near agents it may
# move it by half of one of the CLASSES classes, as a change of pace does anyway.
JUMP = 2.0
# A foot stands for more than half of a walk's cycle and swings forward in the rest: per cycle it
# moves beside the body at this multiple of the stride at most.
SWING = 2.3
NEAR = 1, 0  # agents that ever need this LOD or a finer one are near; the first that serves


@dataclass(frozen=True)
class PhasePlan:
    """The phase classes of a shot, and what they bring.

    in_step: part of all meetings in step. at_random: the same with the classes of the sources.
    largest_jump: pixels by which a change moves a foot at most, beside what it moves anyway.
    """

    phases: Phases
    in_step: float
    at_random: float
    largest_jump: float

    def rows(self, names: Sequence[str], gaits: Gaits) -> list[dict[str, Any]]:
        """Return what each group plays, and in how many classes. names: of the groups."""
        played = [(g, pair) for g, pairs in enumerate(gaits.plays) for pair in pairs]
        return [
            {
                "group": names[g],
                "action": gaits.actions[action],
                "cycles_per_second": rate,
                "classes": int(count),
            }
            for (g, (action, rate)), count in zip(played, self.phases.counts, strict=True)
        ]


def plan_phases(
    survey: Survey,
    strides: np.ndarray,
    tolerance: float | None,
    fixed: np.ndarray | None = None,
    wearer: np.ndarray | None = None,
) -> Generator[float, None, PhasePlan]:
    """Find the fewest classes of each block with which few neighbors are in step.

    Yields the progress, returns the plan.

    strides: of strides_of. tolerance: pixels; None counts as one.
    fixed: (n,) bool, agents that keep the phases of their source; None for nobody.
    wearer: (n,) intp, of Trajectory.wearer: what agents wear takes their phases.

    Blocks that the same rigs move have one palette. Agents that would jump by more than JUMP when
    they change what they play have finer ones. Agents that are ever near take FEWEST_CLASSES of
    their palette where that leaves few enough in step: few classes then show fine LODs.
    """
    assert survey.roles is not None
    agents = len(survey.group)
    meetings = survey.meetings
    changes = changes_of(survey, strides)
    if wearer is not None:
        is_agent = wearer == np.arange(agents)
        meetings = meetings.of(is_agent[meetings.pair].all(axis=1))
        changes = changes.of(is_agent[changes.agent])
    if fixed is None:
        fixed = np.zeros(agents, bool)
    family = survey.roles.family
    limit = np.maximum(JUMP * (tolerance or 1.0), changes.pixels / CLASSES)

    def crowded(phases: Phases) -> np.ndarray:
        return _crowded(meetings, phases, family)

    fewest = _in_few_classes(meetings, changes, limit, fixed, family, crowded)
    work = Workload(FEWEST + NEARED)
    phases = yield from work.take(open_ended_progress(fewest, ROUNDS), FEWEST)
    nearing = _near_in_fewer(survey, meetings, phases, fixed, crowded)
    phases = yield from work.take(open_ended_progress(nearing, MOST_ROUNDS), NEARED)
    if wearer is not None:
        phases = replace(phases, shift=phases.shift[wearer], finer=phases.finer[wearer])
    return PhasePlan(
        phases,
        meetings.share_in_step(phases),
        meetings.share_in_step(_of_sources(agents, len(family))),
        float(changes.jumps(phases).max(initial=0.0)),
    )


def strides_of(groups: Sequence[Group], gaits: Gaits) -> np.ndarray:
    """Return the stride of what each block plays, (B,) float64 meters; 0 of what is not a walk."""
    return np.array(
        [
            group.action(gaits.actions[action]).stride
            for group, played in zip(groups, gaits.plays, strict=True)
            for action, _ in played
        ]
    )


def changes_of(survey: Survey, strides: np.ndarray) -> Changes:
    """Return the changes of `survey` from one walk to another; strides: of strides_of.

    What is no walk is in no step that a change could break.
    """
    assert survey.roles is not None
    of_block = survey.roles.block
    walks = np.append(strides, 0.0)
    parts = []
    for block, character, scale in survey.cells.tables(survey.character, survey.scale):
        is_other = survey.joined(block)
        is_other[1:] &= character[1:] != character[:-1]
        f, column = np.nonzero(is_other)
        pair = np.column_stack((character[f - 1, column], character[f, column]))
        stride = walks[of_block[pair]]
        (walking,) = np.nonzero((stride > 0).all(axis=1))
        pair = pair[walking]
        pixels = scale[f, column].astype(np.float64)[walking]
        parts.append(
            (
                block.agents[column[walking]],
                of_block[pair],
                survey.roles.phase_class[pair],
                SWING * stride[walking, 1] * pixels,
            )
        )
    if not parts:
        none = np.empty((0, 2), np.intp)
        return Changes(none[:, 0], none, none.astype(np.uint8), np.empty(0))
    return Changes(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _of_sources(agents: int, blocks: int) -> Phases:
    """Return the phases that agents have from their sources, in all CLASSES classes."""
    shift = np.zeros(agents, np.uint8)
    return Phases(shift, np.full(blocks, CLASSES, np.uint8), np.zeros_like(shift))


def _in_few_classes(
    meetings: Meetings,
    changes: Changes,
    limit: np.ndarray,
    fixed: np.ndarray,
    family: np.ndarray,
    crowded: Callable[[Phases], np.ndarray],
) -> Generator[None, None, Phases]:
    """Return phases in the fewest classes with which no block is crowded; yield after each round.

    Blocks begin with FEWEST_CLASSES; those that are crowded take one more, until none is.
    limit: (m,) pixels by which each of `changes` may move a foot.
    fixed, family: as in plan_phases.
    crowded: gives the blocks (B,) bool in which too many neighbors are in step.
    """
    counts = np.where(family >= 0, FEWEST_CLASSES, CLASSES).astype(np.uint8)
    phases = _of_sources(len(fixed), len(family))
    phases = replace(phases, finer=np.where(fixed, WHOLE, 0).astype(np.uint8))
    to_color = np.ones(len(family), bool)
    while to_color.any():
        theirs = meetings.of(to_color[meetings.block[:, 0]])
        phases = yield from color(theirs, replace(phases, counts=counts), fixed)
        while (jumping := changes.jumps(phases) > limit).any():
            phases = yield from color(theirs, changes.refined(phases, jumping), fixed)
        to_color = crowded(phases) & (counts < CLASSES)
        counts = counts + to_color
    return phases


def _near_in_fewer(
    survey: Survey,
    meetings: Meetings,
    phases: Phases,
    fixed: np.ndarray,
    crowded: Callable[[Phases], np.ndarray],
) -> Generator[None, None, Phases]:
    """Return `phases` with FEWEST_CLASSES classes of near agents, where no block is crowded then.

    Yields after each round.
    Near are those that ever need the first LOD of NEAR, or a finer one, with which that holds.
    """
    for finest in NEAR:
        near = _nearest_agents(survey, finest) & (phases.finer == 0)
        few = _moved_to_few(survey, phases, near)
        sharing = yield from color(meetings, few, fixed, near)
        if not crowded(sharing).any():
            return sharing
    return phases


def _nearest_agents(survey: Survey, finest: int) -> np.ndarray:
    """Return which agents need LOD `finest` or a finer one when they are seen, (n,) bool."""
    near = np.zeros(len(survey.group), bool)
    for block, levels, kind in survey.cells.tables(survey.coarsest, survey.kind):
        near[block.agents] = ((kind == SEEN) & (levels <= finest)).any(axis=0)
    return near


def _moved_to_few(survey: Survey, phases: Phases, near: np.ndarray) -> Phases:
    """Return `phases` with other shifts of agents (n,) bool that are near.

    They show the nearest of FEWEST_CLASSES classes of their palettes when they are first seen.
    """
    assert survey.roles is not None
    shift = phases.shift.copy()
    for cells, characters, kind in survey.cells.tables(survey.character, survey.kind):
        (columns,) = np.nonzero(near[cells.agents])
        character = characters[(kind[:, columns] == SEEN).argmax(axis=0), columns]
        block = survey.roles.block[character]
        (rigged,) = np.nonzero(block >= 0)
        agents = cells.agents[columns[rigged]]
        classes = survey.roles.phase_class[character[rigged]].astype(np.intp)
        count = phases.counts[block[rigged]]
        for size in np.unique(count):
            of_size = count == size
            few = _few_of(size)
            shown = (classes[of_size] + shift[agents[of_size]]) % CLASSES
            ahead = (few[:, None] - shown) % CLASSES
            nearest = np.minimum(ahead, CLASSES - ahead).argmin(axis=0)
            shift[agents[of_size]] = (few[nearest] - classes[of_size]) % CLASSES
    return replace(phases, shift=shift)


def _crowded(meetings: Meetings, phases: Phases, family: np.ndarray) -> np.ndarray:
    """Return the blocks (B,) bool of families in which more than VARIETY of all are in step."""
    of = family[meetings.block[:, 0]]
    size = max(int(family.max(initial=0)) + 1, 1)
    frames = np.bincount(of, meetings.frames, size)
    in_step = np.bincount(of, meetings.frames * meetings.in_step(phases), size)
    return (in_step > VARIETY * frames)[family] & (family >= 0)


def color(
    meetings: Meetings,
    phases: Phases,
    fixed: np.ndarray | None = None,
    near: np.ndarray | None = None,
) -> Generator[None, None, Phases]:
    """Return `phases` with other shifts, with which fewer of the meetings are in step.

    Yields after each round.

    fixed: (n,) bool, agents that keep their shift; None for nobody.
    near: (n,) bool, agents that take FEWEST_CLASSES classes of their palette; None for nobody.

    In each round those agents take another shift that gain more by it than all whom they meet. So
    each round lowers the weight of what is in step.
    """
    sides = _sides_of(meetings, phases)
    is_near = np.zeros(len(sides.agents), bool) if near is None else near[sides.agents]
    options = _options(sides, phases, is_near)
    if fixed is not None:
        is_fixed = fixed[sides.agents]
        options[:, is_fixed] = phases.shift[sides.agents[is_fixed]]
    shift = phases.shift[sides.agents]
    for _ in range(MOST_ROUNDS):
        yield
        if _take_better(shift, sides, options) <= LITTLE * sides.weight.sum():
            break
    all_shifts = phases.shift.copy()
    all_shifts[sides.agents] = shift
    return replace(phases, shift=all_shifts)


def _take_better(shift: np.ndarray, sides: "_Sides", options: np.ndarray) -> float:
    """Let agents take the option that leaves least in step; return the weight that they gain.

    shift: (a,) uint8, changed in place. options: (C, a) uint8.
    """
    classes = sides.classes_of(shift)
    in_step = classes == sides.other(classes)
    weight_now = np.bincount(sides.place, sides.weight * in_step, len(shift))
    cost = _costs(sides, classes, options, weight_now > 0)
    best = cost.argmin(axis=0)
    everyone = np.arange(len(shift))
    gain = weight_now - cost[best, everyone]
    changes = (gain > 1e-9 * weight_now) & ~_outdone(gain, sides)
    shift[changes] = options[best, everyone][changes]
    return float(gain[changes].sum())


@dataclass(frozen=True)
class _Sides:
    """Both sides of m meetings, one after the other: (2 m,) each. The other side of i is i +- m.

    agents: (a,), all who meet. place: which of them each side is.
    block, classes, weight: as in Meetings. row: where its palette begins in the flat NEAREST.
    """

    agents: np.ndarray
    place: np.ndarray
    block: np.ndarray
    classes: np.ndarray
    weight: np.ndarray
    row: np.ndarray

    def classes_of(self, shift: np.ndarray) -> np.ndarray:
        """Return the class that each side shows; shift: (a,) uint8."""
        return NEAREST.ravel()[self.row + (self.classes + shift[self.place]) % CLASSES]

    def other(self, values: np.ndarray) -> np.ndarray:
        """Return for each side the value of the other side."""
        return np.roll(values, len(values) // 2)


def _sides_of(meetings: Meetings, phases: Phases) -> _Sides:
    agents, place = np.unique(meetings.pair.T.ravel(), return_inverse=True)
    block = meetings.block.T.ravel()
    row = CLASSES * phases.palette_of(agents[place], block)
    weight = np.tile(meetings.weight, 2)
    return _Sides(agents, place, block, meetings.classes.T.ravel(), weight, row)


def _outdone(gain: np.ndarray, sides: _Sides) -> np.ndarray:
    """Return which agents meet one that gains more, or as much and comes first, (a,) bool."""
    first, second = sides.place.reshape(2, -1)
    yields = (gain[first] < gain[second]) | ((gain[first] == gain[second]) & (first > second))
    outdone = np.zeros(len(gain), bool)
    outdone[np.where(yields, first, second)] = True
    return outdone


def _options(sides: _Sides, phases: Phases, is_near: np.ndarray) -> np.ndarray:
    """Return the shifts that agents may take, (C, a) uint8.

    is_near: (a,) bool, agents that take few classes.

    They lead from the class at one of the agent's meetings to the classes of the palette there.
    Agents with fewer options than others have their last one several times.
    """
    at = np.empty(len(sides.agents), np.intp)
    at[sides.place[::-1]] = np.arange(len(sides.place))[::-1]  # the first meeting of each
    classes = sides.classes[at]
    count = phases.counts[sides.block[at]]
    options = np.empty((int(count.max(initial=1)), len(at)), np.uint8)
    for size in np.unique(count):
        for near in (False, True):
            members = (count == size) & (is_near == near)
            taken = _few_of(size) if near else palette(size)
            number = np.minimum(np.arange(len(options)), len(taken) - 1)
            options[:, members] = (taken[number][:, None] - classes[members]) % CLASSES
    return options


def _few_of(size: int) -> np.ndarray:
    """Return FEWEST_CLASSES classes of the palette of `size`, evenly spread, or all of it."""
    few = min(FEWEST_CLASSES, size)
    return palette(size)[np.arange(few) * int(size) // few]


def _costs(
    sides: _Sides, shown_classes: np.ndarray, options: np.ndarray, is_asked: np.ndarray
) -> np.ndarray:
    """Return the weight that each agent would have in step by each option, (C, a) float64.

    shown_classes: the classes that the sides show. is_asked: (a,) bool; the others' costs are 0.
    """
    cost = np.zeros(options.shape)
    (sides_asked,) = np.nonzero(is_asked[sides.place])
    place = sides.place[sides_asked]
    theirs = sides.other(shown_classes)[sides_asked]
    row = sides.row[sides_asked]
    classes = sides.classes[sides_asked]
    weight = sides.weight[sides_asked]
    for k, shift in enumerate(options):
        option_class = NEAREST.ravel()[row + (classes + shift[place]) % CLASSES]
        cost[k] = np.bincount(place, weight * (option_class == theirs), len(is_asked))
    return cost


def recast(survey: Survey, phases: Phases) -> Survey:
    """Return `survey` with the characters that agents show by `phases`."""
    assert survey.roles is not None
    character = np.empty_like(survey.character)
    for cells, new_characters, rows, kind in survey.cells.tables(
        character, survey.character, survey.kind
    ):
        # what an agent shows follows from its character, which few change from frame to frame
        is_new = np.ones(rows.shape, bool)
        np.not_equal(rows[1:], rows[:-1], out=is_new[1:])
        f, column = np.nonzero(is_new)
        own = rows[f, column]
        new_characters[f, column] = _recast(survey.roles, phases, cells.agents[column], own)
        for g in range(1, len(rows)):
            np.copyto(new_characters[g], new_characters[g - 1], where=~is_new[g])
        new_characters[kind == CULLED] = 0
    return replace(survey, character=character)


def _recast(roles: Roles, phases: Phases, agents: np.ndarray, character: np.ndarray) -> np.ndarray:
    """Return the characters (m,) that `agents` (m,) show by `phases`, of what they show without."""
    block = roles.block[character]
    (rigged,) = np.nonzero(block >= 0)
    classes = roles.phase_class[character[rigged]]
    shown = phases.classes_of(agents[rigged], block[rigged], classes)
    recast = character.copy()
    recast[rigged] += (shown.astype(np.int32) - classes).astype(recast.dtype)
    return recast
