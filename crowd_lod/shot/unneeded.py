"""What a shot needs, and what it does not: LODs, characters and agents that no frame shows."""

import numpy as np

from ..levels.cost_model import NAMES, Work, price
from .shot_cost import Shot
from .survey import CULLED, MIRRORED, SHADOW


def unneeded(shot: Shot, shown: np.ndarray, names: list[str]) -> list[str]:
    """Return a sentence on each thing that the shot does not need, with its reason and what it
    saves.

    shown: (F, K, L), seen agents of each LOD of each character.
    names: of the G groups.
    """
    survey = shot.survey
    meshes = shot.meshes
    needed = needed_meshes(shot, shown)
    found = []
    for group, name in enumerate(names):
        own = np.flatnonzero(survey.owner == group)
        each = meshes.triangles[group]
        if not needed[:, own].any():
            found.append(
                f"{name}: no frame shows it, its shadow or its mirror image; "
                f"{_saves(shot, len(own) * each.sum())}."
            )
            continue
        repeated = np.diff(each, prepend=-1) == 0  # the last LOD of a group that has fewer
        for k in np.flatnonzero(~needed[:, own].any(axis=1) & ~repeated):
            found.append(
                f"LOD {k} of {name}: no frame shows it; {_saves(shot, len(own) * each[k])}."
            )
        if idle := int((~needed[:, own].any(axis=0)).sum()):
            found.append(
                f"{idle:,} of {name}'s {len(own):,} poses: no frame shows "
                f"{'it' if idle == 1 else 'them'}; "
                f"{_saves(shot, idle * each.sum())}."
            )
    if never := int((survey.kind == CULLED).all(axis=0).sum()):
        found.append(
            f"{never:,} of {len(survey.group):,} agents: outside of all frames, with no shadow or "
            f"mirror image in them."
        )
    return found


def needed_meshes(shot: Shot, shown: np.ndarray) -> np.ndarray:
    """Return which LODs of which characters the frames show, (K, L) bool.

    shown: (F, K, L), seen agents of each. Unseen agents that cast shadows into the picture or that
    mirrors show count, too.
    """
    survey = shot.survey
    needed: np.ndarray = shown.any(axis=0)
    for f in range(len(survey.kind)):
        agents = np.flatnonzero((survey.kind[f] == SHADOW) | (survey.kind[f] == MIRRORED))
        needed[survey.coarsest[f, agents], survey.character[f, agents]] = True
    return needed


def _saves(shot: Shot, triangles: float) -> str:
    memory = price(Work(posed=float(triangles)), shot.costs).memory
    return f"saves {triangles:,.0f} triangles, {memory / 1e6:.3g} MB in {NAMES[shot.costs.engine]}"
