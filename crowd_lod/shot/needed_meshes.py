"""Which meshes the frames of a shot show: what a shot does not need, what a live build holds of it,
and what stands in for the rest.

A build that follows a plan holds the meshes that the plan's frames show: LODs of characters, each
of which is a phase class of what a group plays. Other frames may ask for any mesh.
"""

import numpy as np

from ..animation.phase_classes import Cast, Gaits, Roles
from ..crowd.agents import CLASSES
from ..levels.cost_model import NAMES, Work, price
from .shot_cost import Shot
from .survey import CULLED, MIRRORED, SEEN, SHADOW, Survey


def unneeded(shot: Shot, agents: np.ndarray, names: list[str]) -> list[str]:
    """Return a sentence on each thing that the shot does not need, with its reason and what it
    saves.

    agents: (F, K, L), seen agents of each LOD of each character.
    names: of the G groups.
    """
    survey = shot.survey
    meshes = shot.meshes
    needed = needed_meshes(shot, agents)
    sentences = []
    for group, name in enumerate(names):
        characters = np.flatnonzero(survey.owner == group)
        triangles = meshes.triangles[group]
        if not needed[:, characters].any():
            sentences.append(
                f"{name}: no frame shows it, its shadow or its mirror image; "
                f"{_saves(shot, len(characters) * triangles.sum())}."
            )
            continue
        repeated = np.diff(triangles, prepend=-1) == 0  # the last LOD of a group that has fewer
        for k in np.flatnonzero(~needed[:, characters].any(axis=1) & ~repeated):
            saved = _saves(shot, len(characters) * triangles[k])
            sentences.append(f"LOD {k} of {name}: no frame shows it; {saved}.")
        if idle := int((~needed[:, characters].any(axis=0)).sum()):
            sentences.append(
                f"{idle:,} of {name}'s {len(characters):,} poses: no frame shows "
                f"{'it' if idle == 1 else 'them'}; "
                f"{_saves(shot, idle * triangles.sum())}."
            )
    is_absent = np.ones(len(survey.group), bool)
    for block, kind in survey.cells.tables(survey.kind):
        is_absent[block.agents] = (kind == CULLED).all(axis=0)
    if never := int(is_absent.sum()):
        behind = " or behind scenery" if survey.hidden.any() else ""
        sentences.append(
            f"{never:,} of {len(survey.group):,} agents: outside of all frames{behind}, with no "
            f"shadow or mirror image in them."
        )
    return sentences


def needed_meshes(shot: Shot, seen_agents: np.ndarray) -> np.ndarray:
    """Return which LODs of which characters the frames show, (K, L) bool.

    seen_agents: (F, K, L), of each. Unseen agents that cast shadows into the picture or that
    mirrors show count, too.
    """
    survey = shot.survey
    needed: np.ndarray = seen_agents.any(axis=0)
    is_unseen = (survey.kind == SHADOW) | (survey.kind == MIRRORED)
    needed[survey.coarsest[is_unseen], survey.character[is_unseen]] = True
    return needed


def seen_characters(survey: Survey) -> np.ndarray:
    """Return which characters an agent shows in sight, (L,) bool."""
    is_seen = np.zeros(len(survey.owner), bool)
    for _, character, kind in survey.cells.tables(survey.character, survey.kind):
        is_seen[character[kind == SEEN]] = True
    return is_seen


def _saves(shot: Shot, triangles: float) -> str:
    memory = price(Work(posed=float(triangles)), shot.costs).memory
    return f"saves {triangles:,.0f} triangles, {memory / 1e6:.3g} MB in {NAMES[shot.costs.engine]}"


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
