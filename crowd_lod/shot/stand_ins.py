"""What a live build holds of a planned shot, and what stands in for the rest.

A build that follows a plan holds the meshes that the plan's frames show: LODs of characters, each
of which is a phase class of what a group plays. Other frames may ask for any mesh.
"""

import numpy as np

from ..animation.phase_classes import Cast, Gaits, Roles
from ..crowd.agents import CLASSES


def hold_shown(shown: np.ndarray, planned: Cast, cast: Cast, gaits: Gaits) -> np.ndarray:
    """Return the meshes that a build holds, (K, N) bool: K LODs of N characters.

    shown: (K, L) bool, the meshes that the plan's frames show, numbered by the Cast `planned`.
    cast: the Cast of the build, with N characters. It may pose groups that the plan takes for
        rigged: of these it holds all poses.

    Besides, one class of all that a group plays has all LODs. So other frames than the plan's show
    no agent coarser than they ask for.
    """
    roles = cast.roles(gaits)
    first = cast.first(gaits)
    is_held = np.ones((len(shown), first[-1]), bool)
    for g in np.flatnonzero(cast.posed == 0):
        of_group = slice(*planned.first(gaits)[g : g + 2])
        is_held[:, first[g] : first[g + 1]] = shown[:, of_group]
    for block in np.unique(roles.block[roles.block >= 0]):
        (members,) = np.nonzero(roles.block == block)
        is_held[:, members[is_held[:, members].sum(axis=0).argmax()]] = True
    return is_held


def stand_ins(is_held: np.ndarray, roles: Roles) -> np.ndarray:
    """Return which mesh a build shows for each, (2, K, N) intp: its LOD and its character.

    is_held: (K, N) bool, the meshes that the build has.
    roles: what the N characters play.

    A mesh that the build has stands for itself. For any other a mesh of the same block stands in
    that is no coarser: of these one with the nearest phase class, and then the coarsest. Where all
    are coarser, the finest of them stands in.
    """
    count, characters = is_held.shape
    stand_in = np.indices(is_held.shape)
    # poses are not stood in for by other poses
    block = np.where(roles.block < 0, -1 - np.arange(characters), roles.block)
    levels = np.arange(count)
    for own in np.unique(block[~is_held.all(axis=0)]):
        (members,) = np.nonzero(block == own)
        level, place = np.nonzero(is_held[:, members])
        if not len(level):
            continue
        classes = roles.phase_class[members].astype(np.intp)
        ahead = (classes[place] - classes[:, None]) % CLASSES
        apart = np.minimum(ahead, CLASSES - ahead)
        coarser = np.maximum(level - levels[:, None], 0)[:, None, :]
        finer = np.maximum(levels[:, None] - level, 0)[:, None, :]
        # (K, members, meshes), the last key first
        best = np.lexsort(np.broadcast_arrays(finer, apart, coarser))[..., 0]
        stand_in[:, :, members] = level[best], members[place[best]]
    return stand_in
