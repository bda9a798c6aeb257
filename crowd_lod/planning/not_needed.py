"""What a planned shot does not need, and what a build saves without it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from ..crowd.agents import Group
from ..levels.cost_model import MEMORY
from .shot_cost import Bill, Shot
from .survey import CULLED


@dataclass(frozen=True)
class NotNeeded:
    """One thing that no frame of the shot shows.

    what: a name. reason: a sentence.
    megabytes: of a render's memory; triangles: posed in each frame; agents: that no frame needs.
    """

    what: str
    reason: str
    megabytes: float = 0.0
    triangles: int = 0
    agents: int = 0

    @property
    def as_json(self) -> dict[str, str | float | int]:
        """Return plain data."""
        return asdict(self)


def not_needed(shot: Shot, found: Bill, groups: Sequence[Group]) -> list[NotNeeded]:
    """List the LODs, groups, characters and agents that no frame of the shot shows.

    found: the bill of the plan.
    """
    survey, count = shot.survey, shot.meshes.count
    frames = f"{survey.numbers[0]} to {survey.numbers[-1]}"
    # of casters and mirrored agents, too
    used = np.zeros((count, len(survey.owner)), bool)
    used |= found.shown.any(axis=0)
    for f in range(len(survey.times)):
        others = np.flatnonzero(survey.kind[f] > 1)
        used[survey.coarsest[f, others], survey.character[f, others]] = True
    each, parts = MEMORY[shot.engine]["posed"] / 1e6, []
    for g, group in enumerate(groups):
        mine = survey.owner == g
        if not used[:, mine].any():
            triangles = int(shot.meshes.triangles[g].sum()) * int(mine.sum())
            parts.append(NotNeeded(f"group {group.name}", f"No agent of it is needed in the frames {frames}.", triangles * each, triangles))
            continue
        for k in range(count):
            unused = mine & ~used[k] & used.any(axis=0)
            triangles = int(shot.meshes.triangles[g, k] * unused.sum())
            if triangles:
                whose = "no agent" if unused.sum() == (mine & used.any(axis=0)).sum() else f"no agent in {unused.sum()} of its phases"
                reason = f"In the frames {frames} {whose} is shown at this LOD."
                parts.append(NotNeeded(f"LOD {k} of {group.name}", reason, triangles * each, triangles))
        idle = mine & ~used.any(axis=0)
        if idle.any():
            triangles = int(shot.meshes.triangles[g].sum() * idle.sum())
            reason = f"No frame shows these {idle.sum()} of its {mine.sum()} phases."
            parts.append(NotNeeded(f"phases of {group.name}", reason, triangles * each, triangles))
    unseen = int((survey.kind == CULLED).all(axis=0).sum())
    if unseen:
        reason = f"In the frames {frames} they are never in the picture, nor in a mirror, nor do they cast a shadow into it."
        parts.append(NotNeeded("agents", reason, agents=unseen))
    return parts
