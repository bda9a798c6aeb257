"""What a shot needs, and what it does not: LODs, characters and agents that no frame shows."""

import numpy as np

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
