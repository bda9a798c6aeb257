"""What stands in for the meshes that a build of a planned shot does not hold."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.animation.phase_classes import Cast, Roles
from crowd_lod_extension.crowd_lod.crowd.agents import CLASSES
from crowd_lod_extension.crowd_lod.shot.needed_meshes import hold_shown, stand_ins

from ..support.plaza_shot import cast_of_rigs, plaza_shot

BLOCKS = 3
LEVELS = 4
ROLES = Roles(
    np.repeat(np.arange(BLOCKS), CLASSES),
    np.tile(np.arange(CLASSES), BLOCKS).astype(np.uint8),
    np.arange(BLOCKS),
)


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_class_stands_in_no_coarser_where_there_is_one(seed):
    random = np.random.default_rng(seed)
    held = random.random((LEVELS, BLOCKS * CLASSES)) < random.choice((0.05, 0.2, 0.8))
    shown = stand_ins(held, ROLES)
    for level, number in np.ndindex(held.shape):
        block, phase_class = divmod(number, CLASSES)
        meshes = [
            (k, other)
            for k, other in np.argwhere(held).tolist()
            if other // CLASSES == block  # what plays another action is no stand-in
        ]
        if not meshes:
            assert tuple(shown[:, level, number]) == (level, number)
            continue

        def rank(mesh, level=level, phase_class=phase_class):
            ahead = (mesh[1] - phase_class) % CLASSES
            return max(mesh[0] - level, 0), min(ahead, CLASSES - ahead), -mesh[0]

        stand_in = tuple(shown[:, level, number].tolist())
        assert rank(stand_in) == min(map(rank, meshes))
        assert stand_in == (level, number) or not held[level, number]


def test_a_build_that_holds_everything_needs_no_stand_ins():
    held = np.ones((LEVELS, BLOCKS * CLASSES), bool)
    assert (stand_ins(held, ROLES) == np.indices(held.shape)).all()


def test_poses_of_a_group_stand_in_for_no_others():
    roles = Roles(np.full(6, -1), np.zeros(6, np.uint8), np.empty(0, np.intp))
    held = np.array([[False] * 6, [True] * 6])
    levels, numbers = stand_ins(held, roles)
    assert (levels == 1).all() and (numbers == np.arange(6)).all()


def test_a_build_holds_what_its_plan_shows_and_a_class_of_all_that_is_played():
    trajectory, _ = plaza_shot(20, [1])
    gaits = trajectory.gaits
    planned = cast_of_rigs()
    built = Cast(np.array([0, 32, 0]))  # rigs cannot show the second group
    random = np.random.default_rng(1)
    shown = random.random((LEVELS, planned.first(gaits)[-1])) < 0.1
    held = hold_shown(shown, planned, built, gaits)
    owner = [each.owner(gaits) for each in (planned, built)]
    assert held[:, owner[1] == 1].all()
    for g in (0, 2):
        more = held[:, owner[1] == g] & ~shown[:, owner[0] == g]
        assert (held[:, owner[1] == g] | ~shown[:, owner[0] == g]).all()
        assert more.any(axis=0).sum() <= len(gaits.plays[g])
    block = built.roles(gaits).block
    for number in np.unique(block[block >= 0]):
        assert held[:, block == number].all(axis=0).any()
