"""Phase classes of a shot: few of them, and few close neighbors in step."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.animation.phase_classes import Cast, first_blocks
from crowd_lod_extension.crowd_lod.crowd.agents import CLASSES
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.shot import coloring
from crowd_lod_extension.crowd_lod.shot.coloring import changes_of, plan_phases, recast, strides_of
from crowd_lod_extension.crowd_lod.shot.phases import NEAREST, Meetings, Phases, palette
from crowd_lod_extension.crowd_lod.shot.recording import MEET_EVERY, close_pairs
from crowd_lod_extension.crowd_lod.shot.survey import SEEN

from ..support.plaza_shot import cast_of_rigs, plaza_shot


@pytest.fixture(scope="module")
def shot():
    """The plaza's trajectory, and its survey from a camera that flies into 2,000 people."""
    return plaza_shot(2000, range(1, 41))


@pytest.fixture(scope="module")
def planned(shot):
    trajectory, survey = shot
    strides = strides_of(trajectory.groups, trajectory.gaits)
    return finished(plan_phases(survey, strides, 1.0))


def test_palettes_are_even_and_each_class_takes_the_nearest_of_them():
    for count in range(1, CLASSES + 1):
        classes = palette(count)
        assert len(set(classes.tolist())) == count and np.diff([*classes, CLASSES]).max() <= (
            np.ceil(CLASSES / count)
        )
        for phase_class in range(CLASSES):
            ahead = [min((c - phase_class) % CLASSES, (phase_class - c) % CLASSES) for c in classes]
            nearest = NEAREST[count, phase_class]
            assert nearest in classes and ahead[classes.tolist().index(nearest)] == min(ahead)


def test_palettes_of_twice_as_many_classes_hold_those_of_half():
    for count in (3, 4, 5, 6, 8):
        assert set(palette(count)) <= set(palette(min(2 * count, CLASSES)))


@pytest.mark.parametrize("seed", range(4))
def test_close_pairs_are_those_of_a_plain_search(seed):
    random = np.random.default_rng(seed)
    place = random.uniform(-20, 20, (300, 3)) * (1, 1, 0.1)
    kind = random.integers(0, 3, 300)
    pairs, apart = close_pairs(place, kind, 2.0, 10**6)
    expected = {
        (i, j)
        for i in range(300)
        for j in range(i)
        if kind[i] == kind[j] and np.linalg.norm(place[i] - place[j]) <= 2.0
    }
    assert {(max(pair), min(pair)) for pair in pairs.tolist()} == expected
    assert len(pairs) == len(expected)
    assert np.allclose(apart, np.linalg.norm(place[pairs[:, 0]] - place[pairs[:, 1]], axis=1))


def test_of_a_dense_crowd_some_pairs_are_taken():
    place = np.random.default_rng(0).uniform(0, 10, (4000, 3)) * (1, 1, 0)
    pairs, _ = close_pairs(place, np.zeros(4000, int), 2.0, 20_000)
    assert 5000 < len(pairs) <= 20_000
    assert len(close_pairs(place[:1], np.zeros(1, int), 2.0, 10)[0]) == 0
    assert len(close_pairs(place[:0], np.zeros(0, int), 2.0, 10)[0]) == 0


def test_few_classes_leave_few_neighbors_in_step(planned):
    assert planned.at_random > 0.04
    assert planned.in_step <= coloring.VARIETY
    assert planned.phases.counts.max() <= 6


def test_in_step_is_what_the_crowd_shows(shot, planned):
    """Counted again from the crowd of each frame, by a plain search."""
    trajectory, survey = shot
    close = 0
    in_step = 0
    for f in range(0, len(survey.times), 4):
        time = survey.times[f]
        crowd = planned.phases.applied(trajectory.at(time), trajectory.gaits)
        kind, coarsest = (survey.cells.row(column, f) for column in (survey.kind, survey.coarsest))
        agents = np.flatnonzero((kind == SEEN) & (coarsest <= 3))
        place = np.column_stack((crowd.x, crowd.y, crowd.z))[agents]
        apart = np.linalg.norm(place[:, None] - place, axis=2)
        block = (
            trajectory.gaits.play_number[crowd.group, crowd.playing][agents]
            + 10 * crowd.group[agents]
        )
        alike = (block[:, None] == block) & (apart <= 2) & (np.arange(len(agents)) < 1e9)
        alike &= np.tri(len(agents), k=-1, dtype=bool)
        shown = crowd.phase_class[agents]
        close += alike.sum()
        in_step += (alike & (shown[:, None] == shown)).sum()
    assert close > 1000
    assert in_step / close == pytest.approx(planned.in_step)


def test_the_survey_and_the_crowd_show_the_same_characters(shot, planned):
    trajectory, survey = shot
    again = recast(survey, planned.phases)
    for f in (0, 17, 39):
        time = survey.times[f]
        crowd = planned.phases.applied(trajectory.at(time), trajectory.gaits)
        agents, cells = survey.cells.in_frame(f)
        is_seen = survey.is_seen[cells]
        agents = agents[is_seen]
        seconds = trajectory.seconds(time)
        shown = cast_of_rigs().character_of(trajectory.gaits, crowd, seconds, agents)
        assert (shown == again.character[cells[is_seen]]).all()
    before, after = (np.unique(each.character[each.is_seen]) for each in (survey, again))
    assert len(after) < 0.6 * len(before)


def test_phases_follow_from_the_crowd_alone(shot, planned):
    """An agent that plays the same all the time keeps its class at any time between frames."""
    trajectory, _ = shot
    whole, between = (
        planned.phases.applied(trajectory.at(time), trajectory.gaits) for time in (20, 20.3)
    )
    same = trajectory.at(20).playing == trajectory.at(20.3).playing
    assert same.any() and (whole.phase_class == between.phase_class)[same].all()


def test_whole_palettes_without_shift_change_nothing(shot):
    trajectory, _ = shot
    crowd = trajectory.at(10)
    blocks = first_blocks(trajectory.gaits)[-1]
    agents = len(crowd)
    none = np.zeros(agents, np.uint8)
    phases = Phases(none, np.full(blocks, CLASSES, np.uint8), none)
    assert (phases.applied(crowd, trajectory.gaits).phase_class == crowd.phase_class).all()


@pytest.fixture
def varied(shot):
    """Phases whose palettes differ from block to block, and from agent to agent."""
    trajectory, _ = shot
    random = np.random.default_rng(3)
    agents = len(trajectory.at(0))
    return Phases(
        random.integers(0, CLASSES, agents).astype(np.uint8),
        random.choice([3, 4, 5, 6], first_blocks(trajectory.gaits)[-1]).astype(np.uint8),
        random.integers(0, 2, agents).astype(np.uint8),
    )


def test_each_agent_shows_the_class_of_what_its_group_plays(shot, varied):
    trajectory, _ = shot
    gaits = trajectory.gaits
    crowd = trajectory.at(20)
    shown = varied.applied(crowd, gaits).phase_class
    for agent, (group, playing) in enumerate(zip(crowd.group, crowd.playing, strict=True)):
        block = first_blocks(gaits)[group] + gaits.play_number[group, playing]
        count = int(varied.counts[block]) * 2 ** int(varied.finer[agent])
        ahead = (int(crowd.phase_class[agent]) + int(varied.shift[agent])) % CLASSES
        assert shown[agent] == NEAREST[count, ahead]


def test_agents_with_finer_palettes_show_what_they_showed_before(shot, varied):
    trajectory, survey = shot
    varied = replace(varied, finer=np.zeros_like(varied.finer))
    changes = changes_of(survey, strides_of(trajectory.groups, trajectory.gaits))
    once = np.zeros(len(changes.agent), bool)
    once[np.unique(changes.agent, return_index=True)[1]] = True
    refined = changes.refined(varied, once)
    before, after = (
        each.classes_of(changes.agent[once], changes.block[once, 0], changes.classes[once, 0])
        for each in (varied, refined)
    )
    assert (before == after).all() and (refined.finer[changes.agent] == 1).all()


def test_changes_of_near_agents_jump_by_no_more_than_a_class(shot, planned):
    trajectory, survey = shot
    changes = changes_of(survey, strides_of(trajectory.groups, trajectory.gaits))
    assert len(changes.agent) > 20
    jumps = changes.jumps(planned.phases)
    assert (jumps <= np.maximum(2.0, changes.pixels / CLASSES) * (1 + 1e-12)).all()
    assert jumps.max() == planned.largest_jump
    coarse = replace(planned.phases, finer=np.zeros_like(planned.phases.finer))
    assert (changes.jumps(coarse) > np.maximum(2.0, changes.pixels / CLASSES)).any()


def test_coloring_finds_no_step_where_there_need_be_none():
    """Rings of agents, each of which meets its two neighbors: as few as two or three colors do."""
    meetings = ring_of(30)
    none = np.zeros(30, np.uint8)
    phases = finished(coloring.color(meetings, Phases(none, np.array([3], np.uint8), none)))
    assert meetings.share_in_step(phases) == 0


def test_coloring_is_near_the_best_of_all_colorings():
    meetings = ring_of(7)
    shifts = np.array(list(product(palette(2), repeat=7)), np.uint8)
    none = np.zeros(7, np.uint8)
    start = Phases(none, np.array([2], np.uint8), none)
    best = min(meetings.share_in_step(replace(start, shift=shift)) for shift in shifts)
    assert best == pytest.approx(1 / 7)
    assert meetings.share_in_step(finished(coloring.color(meetings, start))) <= 3 / 7


def ring_of(agents):
    """Meetings of agents in a ring, all in step at first."""
    pair = np.column_stack((np.arange(agents), (np.arange(agents) + 1) % agents))
    zeros = np.zeros((agents, 2), int)
    ones = np.ones(agents)
    return Meetings(pair, zeros, zeros.astype(np.uint8), ones.astype(int), ones)


def test_what_meets_nobody_has_the_fewest_classes(shot):
    trajectory, survey = shot
    alone = replace(survey, meetings=Meetings())
    plan = finished(plan_phases(alone, strides_of(trajectory.groups, trajectory.gaits), 1.0))
    assert (plan.phases.counts == coloring.FEWEST_CLASSES).all() and plan.in_step == 0


def test_groups_that_are_posed_keep_their_characters(shot):
    trajectory, survey = shot
    posed = Cast(np.array([8, 0, 0], np.intp))
    roles = posed.roles(trajectory.gaits)
    first = posed.first(trajectory.gaits)
    assert (roles.block[: first[1]] == -1).all() and (roles.block[first[1] :] >= 0).all()
    assert (roles.family[: first_blocks(trajectory.gaits)[1]] == -1).all()


def test_meetings_are_counted_by_frames(shot):
    _, survey = shot
    meetings = survey.meetings
    looked_at = len(survey.numbers[::MEET_EVERY])
    assert 1 < meetings.frames.max() <= looked_at and meetings.frames.min() == 1
    played = np.column_stack((meetings.pair, meetings.block, meetings.classes))
    assert len(np.unique(played, axis=0)) == len(played)


def test_near_agents_take_few_classes_of_their_palettes():
    meetings = ring_of(30)
    none = np.zeros(30, np.uint8)
    near = np.arange(30) < 15
    start = Phases(none, np.array([8], np.uint8), none)
    shift = finished(coloring.color(meetings, start, near=near)).shift
    assert len(np.unique(shift[near])) <= coloring.FEWEST_CLASSES
    assert set(shift[~near]) <= set(palette(8))


def test_near_agents_share_few_classes_where_variety_allows():
    """So few classes show fine LODs, while all agents together have more."""
    trajectory, survey = plaza_shot(6000, range(1, 10))
    plan = finished(plan_phases(survey, strides_of(trajectory.groups, trajectory.gaits), 1.0))
    again = recast(survey, plan.phases)
    block = survey.roles.block[again.character]
    agent = np.concatenate(
        [np.tile(block.agents, block.end - block.begin) for block in survey.cells.blocks]
    )
    near = np.zeros(len(survey.group), bool)
    near[agent[again.is_seen & (survey.coarsest <= coloring.NEAR[-1])]] = True
    near &= plan.phases.finer == 0
    counts = [
        [
            len(np.unique(again.character[agents[agent] & again.is_seen & (block == b)]))
            for b in np.flatnonzero(plan.phases.counts > coloring.FEWEST_CLASSES)
        ]
        for agents in (near, ~near)
    ]
    assert max(counts[0]) <= coloring.FEWEST_CLASSES < min(counts[1])
    assert plan.in_step <= coloring.VARIETY


def test_given_phases_stay(shot):
    trajectory, survey = shot
    given = np.arange(len(survey.group)) % 2 == 0
    strides = strides_of(trajectory.groups, trajectory.gaits)
    phases = finished(plan_phases(survey, strides, 1.0, fixed=given)).phases
    crowd = trajectory.at(20)
    shown = phases.applied(crowd, trajectory.gaits).phase_class
    assert (shown == crowd.phase_class)[given].all()
    assert (shown != crowd.phase_class)[~given].any()


def test_agents_whose_class_drifts_in_sight_have_finer_palettes(shot):
    """As recorded tracks do, whose speed varies: one class more in every second frame."""
    trajectory, survey = shot
    own = survey.roles.phase_class[survey.character]
    drift = np.concatenate(
        [
            np.repeat(np.arange(block.begin, block.end) // 2, len(block.agents))
            for block in survey.cells.blocks
        ]
    )
    drifted = survey.character - own + (own + drift) % CLASSES
    seen = survey.kind != 0
    survey = replace(survey, character=np.where(seen, drifted, 0).astype(np.uint16))
    plan = finished(plan_phases(survey, strides_of(trajectory.groups, trajectory.gaits), 1.0))
    near = np.zeros(len(survey.group), bool)
    for block, scale in survey.cells.tables(survey.scale):
        near[block.agents] = (scale > 60).any(axis=0)
    assert near.sum() > 20 and (plan.phases.finer[near] > 0).mean() > 0.9
    assert plan.largest_jump < jump_of_block_palettes(survey, trajectory, plan)


def jump_of_block_palettes(survey, trajectory, plan):
    """The largest jump if all had the palettes of their blocks."""
    changes = changes_of(survey, strides_of(trajectory.groups, trajectory.gaits))
    coarse = replace(plan.phases, finer=np.zeros_like(plan.phases.finer))
    return changes.jumps(coarse).max()
