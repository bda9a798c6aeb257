"""Chooses the phase classes of a shot, as colors of a graph whose edges are close neighbors.

Drawn at random, a part 1 / C of all close neighbors is in step. Chosen, four classes leave fewer in
step than sixteen at random do.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..animation.phase_classes import Gaits
from ..crowd.agents import CLASSES, FEWEST_CLASSES, Group
from ..progress import breath
from .phases import NEAREST, Phases, palette
from .survey import SEEN, Survey

VARIETY = 0.05  # of close neighbors, at most, in step: about what CLASSES random classes leave
WHOLE = 3  # times a palette of FEWEST_CLASSES is doubled: it then has all CLASSES
MOST_ROUNDS = 40  # of recoloring; some ten suffice where agents meet few others
LITTLE = 2e-4  # of the weight of all meetings: a round that gains no more is the last
# A foot stands for more than half of a walk's cycle and swings forward in the rest: per cycle it
# moves beside the body at this multiple of the stride at most.
SWING = 2.3
# Times the tolerance, in pixels, by which a change of class may move a foot. Of near agents it may
# move it by half of one of the CLASSES classes, as a change of pace does anyway.
JUMP = 2.0
NEAR = 1, 0  # agents that ever need this LOD or a finer one are near; the first that serves


@dataclass(frozen=True)
class Meetings:
    """Pairs of agents that are seen close to each other while both play the same.

    pair: (m, 2) int32, agents.
    block: (m, 2) uint16, what each of them plays (phase_classes.Roles).
    classes: (m, 2) uint8, the classes of their sources then.
    frames: (m,) int64, in how many frames of the survey that were looked at.
    weight: (m,) float64, by nearness and size in pixels, summed over these frames.
    """

    pair: np.ndarray
    block: np.ndarray
    classes: np.ndarray
    frames: np.ndarray
    weight: np.ndarray

    def classes_of(self, phases: Phases, side: int) -> np.ndarray:
        """Return the classes (m,) uint8 that the agents of one side, 0 or 1, show."""
        return phases.classes_of(self.pair[:, side], self.block[:, side], self.classes[:, side])

    def in_step(self, phases: Phases) -> np.ndarray:
        """Return which of them have the same class, (m,) bool."""
        return self.classes_of(phases, 0) == self.classes_of(phases, 1)

    def share_in_step(self, phases: Phases) -> float:
        """Return the part of the meetings that are in step, 0 without any."""
        return float(self.frames[self.in_step(phases)].sum() / max(self.frames.sum(), 1))

    def of(self, mask: np.ndarray) -> "Meetings":
        """Return those of the mask `mask`, (m,) bool."""
        return Meetings(
            self.pair[mask],
            self.block[mask],
            self.classes[mask],
            self.frames[mask],
            self.weight[mask],
        )


def meetings_of(survey: Survey) -> Meetings:
    """Return the meetings that `survey` has seen."""
    assert survey.roles is not None
    pair = survey.encounters.pair
    character = survey.encounters.characters
    weight = survey.encounters.weight
    block = survey.roles.block[character].astype(np.uint16)
    classes = survey.roles.phase_class[character]
    key = np.column_stack((pair, block, classes))
    order = np.lexsort(key.T)
    key = key[order]
    begins = np.append(True, (key[1:] != key[:-1]).any(axis=1))[: len(key)]
    (first,) = np.nonzero(begins)
    if not len(first):
        return Meetings(pair, block, classes, np.empty(0, np.int64), weight)
    longest = order[first]
    return Meetings(
        pair[longest],
        block[longest],
        classes[longest],
        np.diff(np.append(first, len(key))),
        np.add.reduceat(weight[order], first),
    )


@dataclass(frozen=True)
class Changes:
    """Agents that take another class in sight, as most do that begin to play something else.

    agent: (m,) intp. block: (m, 2) uint16 and classes: (m, 2) uint8, before and after.
    pixels: (m,) float64, what a jump by a whole cycle would move a foot.
    """

    agent: np.ndarray
    block: np.ndarray
    classes: np.ndarray
    pixels: np.ndarray

    def of(self, mask: np.ndarray) -> "Changes":
        """Return those of the mask `mask`, (m,) bool."""
        return Changes(self.agent[mask], self.block[mask], self.classes[mask], self.pixels[mask])

    def jumps(self, phases: Phases) -> np.ndarray:
        """Return by how many pixels each change moves a foot, (m,) float64.

        Beside what the change moves with all CLASSES classes.
        """
        ahead = np.empty(self.classes.shape)
        for side in (0, 1):
            own = (self.classes[:, side] + phases.shift[self.agent]) % CLASSES
            shown = phases.classes_of(self.agent, self.block[:, side], self.classes[:, side])
            ahead[:, side] = (shown.astype(np.int16) - own + CLASSES // 2) % CLASSES
        return self.pixels * np.abs(ahead[:, 1] - ahead[:, 0]) / CLASSES

    def refined(self, phases: Phases, mask: np.ndarray) -> Phases:
        """Return `phases` with finer palettes of the agents of the mask `mask`, (m,) bool.

        Until they change they show the class that they have shown.
        """
        agent = self.agent[mask]
        classes = self.classes[mask, 0]
        shift = phases.shift.copy()
        finer = phases.finer.copy()
        shift[agent] = (phases.classes_of(agent, self.block[mask, 0], classes) - classes) % CLASSES
        finer[agent] = phases.finer[agent] + 1
        return replace(phases, shift=shift, finer=finer)


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
    variety: float = VARIETY,
    fixed: np.ndarray | None = None,
    wearer: np.ndarray | None = None,
) -> PhasePlan:
    """Return the fewest classes of each block with which few neighbors are in step.

    strides: of strides_of. tolerance: pixels; None counts as one.
    variety: the part of all close neighbors that may be in step.
    fixed: (n,) bool, agents that keep the phases of their source; None for nobody.
    wearer: (n,) intp, of Trajectory.wearer: what agents wear takes their phases.

    Blocks that the same rigs move have one palette. Agents that would jump by more than JUMP when
    they change what they play have finer ones. Agents that are ever near take FEWEST_CLASSES of
    their palette where that leaves few enough in step: few classes then show fine LODs.
    """
    assert survey.roles is not None
    agents = len(survey.group)
    meetings = meetings_of(survey)
    changes = changes_of(survey, strides)
    if wearer is not None:
        is_agent = wearer == np.arange(agents)
        meetings = meetings.of(is_agent[meetings.pair].all(axis=1))
        changes = changes.of(is_agent[changes.agent])
    family = survey.roles.family
    everything = Phases(
        np.zeros(agents, np.uint8),
        np.full(len(family), CLASSES, np.uint8),
        np.zeros(agents, np.uint8),
    )
    limit = np.maximum(JUMP * (tolerance or 1.0), changes.pixels / CLASSES)
    counts = np.where(family >= 0, FEWEST_CLASSES, CLASSES).astype(np.uint8)
    if fixed is None:
        fixed = np.zeros(agents, bool)
    phases = replace(everything, finer=np.where(fixed, WHOLE, 0).astype(np.uint8))
    crowded = np.ones(len(family), bool)
    while crowded.any():
        theirs = meetings.of(crowded[meetings.block[:, 0]])
        phases = color(theirs, replace(phases, counts=counts), fixed)
        while (jumping := changes.jumps(phases) > limit).any():
            phases = color(theirs, changes.refined(phases, jumping), fixed)
        crowded = _crowded(meetings, phases, family, variety) & (counts < CLASSES)
        counts = counts + crowded
    for finest in NEAR:
        near = _nearest_agents(survey, finest) & (phases.finer == 0)
        sharing = color(meetings, _moved_to_few(survey, phases, near), fixed, near)
        if not _crowded(meetings, sharing, family, variety).any():
            phases = sharing
            break
    if wearer is not None:
        phases = replace(phases, shift=phases.shift[wearer], finer=phases.finer[wearer])
    return PhasePlan(
        phases,
        meetings.share_in_step(phases),
        meetings.share_in_step(everything),
        float(changes.jumps(phases).max(initial=0.0)),
    )


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


def _crowded(meetings: Meetings, phases: Phases, family: np.ndarray, variety: float) -> np.ndarray:
    """Return the blocks (B,) bool of families in which more than `variety` of all are in step."""
    of = family[meetings.block[:, 0]]
    size = max(int(family.max(initial=0)) + 1, 1)
    frames = np.bincount(of, meetings.frames, size)
    in_step = np.bincount(of, meetings.frames * meetings.in_step(phases), size)
    return (in_step > variety * frames)[family] & (family >= 0)


def color(
    meetings: Meetings,
    phases: Phases,
    fixed: np.ndarray | None = None,
    near: np.ndarray | None = None,
) -> Phases:
    """Return `phases` with other shifts, with which fewer of the meetings are in step.

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
    everyone = np.arange(len(shift))
    for _ in range(MOST_ROUNDS):
        breath()
        classes = sides.classes_of(shift)
        in_step = classes == sides.other(classes)
        now = np.bincount(sides.place, sides.weight * in_step, len(shift))
        cost = _costs(sides, classes, options, now > 0)
        best = cost.argmin(axis=0)
        gain = now - cost[best, everyone]
        changes = (gain > 1e-9 * now) & ~_outdone(gain, sides)
        shift[changes] = options[best, everyone][changes]
        if gain[changes].sum() <= LITTLE * sides.weight.sum():
            break
    whole = phases.shift.copy()
    whole[sides.agents] = shift
    return replace(phases, shift=whole)


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
