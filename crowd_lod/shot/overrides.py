"""Art direction: overrides of the shot plan, or of distance, for some agents and frames.

They act in the order of their list: where two concern the same agent in the same frame, the later
one holds.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import CrowdError
from ..frame.frame import Frame
from ..frame.planned import HIDDEN, OVERRIDDEN, PINNED, with_row
from .survey import SEEN, Cause, Survey, at_once

TYPES = ("NEVER_COARSER", "ALWAYS", "HIDE")
NEVER_COARSER, ALWAYS, HIDE = TYPES
NO_LIMIT = 255  # as the coarsest LOD


@dataclass(frozen=True)
class LodOverride:
    """An override of the LODs of some agents.

    type: NEVER_COARSER than the LOD `level`, ALWAYS that LOD, or HIDE.
    agents: (m,) intp, their indices.
    selection: how they were chosen, in words.
    first, last: the frames of the timeline for which it holds, both included; None for no limit.
    """

    name: str
    type: str
    level: int
    agents: np.ndarray
    selection: str = ""
    first: int | None = None
    last: int | None = None

    def holds(self, number: int) -> bool:
        """Return whether it holds in this frame of the timeline."""
        return (self.first is None or self.first <= number) and (
            self.last is None or number <= self.last
        )

    @property
    def as_json(self) -> dict[str, Any]:
        """What plan.json says of it."""
        return {
            "name": self.name,
            "type": self.type,
            "lod": None if self.type == HIDE else self.level,
            "chosen": self.selection,
            "agents": len(self.agents),
            "first": self.first,
            "last": self.last,
        }


def parse_agents(text: str, count: int, name: str, ids: np.ndarray | None = None) -> np.ndarray:
    """Return the agents that `text` names, such as "12, 40-50", increasing, (m,) intp.

    After "#" stand the numbers of a file's own, such as "#1007, #1020-1030". Of these, some may be
    missing: points come and go.

    count: agents of the crowd.
    name: of the override.
    ids: (n,) int64, Trajectory.ids.
    CrowdError if it names none, an index that is not there, numbers of a file of which none is
    there, or a range that runs backwards.
    """
    if not text.strip():
        raise CrowdError(
            f"The override {name} names no agents: write their numbers, such as 12, 40-50."
        )
    is_chosen = np.zeros(count, bool)
    file_ids = np.empty(0, np.int64) if ids is None or "#" not in text else ids
    order = np.argsort(file_ids, kind="stable")
    file_ids = file_ids[order]
    for part in text.split(","):
        match = re.fullmatch(r"\s*(#?)(\d{1,18})\s*(?:-\s*(\d{1,18})\s*)?", part)
        if match is None:
            raise CrowdError(
                f"The override {name} names agents by {part.strip()!r}: write numbers and "
                f"ranges, such as 12, 40-50."
            )
        mark = match[1]
        first = int(match[2])
        last = int(match[3] or match[2])
        if first > last:
            raise CrowdError(
                f"The override {name} has agents {mark}{first}-{last}, a range that runs "
                f"backwards: write {mark}{last}-{first}."
            )
        if mark:
            begin, end = np.searchsorted(file_ids, (first, last + 1)).tolist()
            is_chosen[order[begin:end]] = True
            continue
        if last >= count:
            raise CrowdError(
                f"The override {name} names agent {last}: the crowd has {count:,}, numbered from "
                f"0 on."
            )
        is_chosen[first : last + 1] = True
    if not is_chosen.any():
        raise CrowdError(
            f"The override {name} names {text.strip()}: no agent has that number in its file or "
            f"object."
        )
    return np.flatnonzero(is_chosen)


def agents_text(agents: np.ndarray, ids: np.ndarray | None = None) -> str:
    """Return the text by which `parse_agents` finds these `agents` (m,), increasing.

    An agent is named by the number of its file if no other has the same, so that it is found again
    when the file has changed; else by its index.

    ids: (n,) int64, Trajectory.ids.
    """
    file_ids = np.full(len(agents), -1) if ids is None else ids[agents].copy()
    if ids is not None:
        known, counts = np.unique(ids, return_counts=True)
        file_ids[counts[np.searchsorted(known, file_ids)] > 1] = -1
    return ", ".join(
        [*_ranges(np.sort(file_ids[file_ids >= 0]), "#"), *_ranges(agents[file_ids < 0], "")]
    )


def _ranges(numbers: np.ndarray, mark: str) -> list[str]:
    """Return increasing `numbers` as texts, those that follow one another as one."""
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1)
    return [f"{mark}{run[0]}" + f"-{run[-1]}" * (len(run) > 1) for run in runs if len(run)]


def check_level(
    override: LodOverride,
    count: int,
    finest: Sequence[int],
    group: np.ndarray,
    names: Sequence[str],
) -> None:
    """Raise CrowdError if an agent does not have the LOD that the override asks for.

    count: the number of LODs.
    finest: for each group the finest LOD that it has; () if each has all.
    group: (n,) uint8, of each agent.
    names: of the groups.
    """
    name = override.name
    level = override.level
    if override.type == HIDE:
        return
    if level >= count:
        has = f"LODs 0 to {count - 1}" if count > 1 else "LOD 0 alone"
        raise CrowdError(f"The override {name} asks for LOD {level}: the crowd has {has}.")
    lacks = [
        g
        for g in np.unique(group[override.agents]).tolist()
        if level < (finest[g] if finest else 0)
    ]
    if lacks:
        raise CrowdError(
            f"The override {name} asks for LOD {level} of {names[lacks[0]]}, which "
            f"Character Memory leaves out: ask for LOD "
            f"{finest[lacks[0]]}, or raise that limit and make the LOD meshes again."
        )


def in_force(overrides: Sequence[LodOverride], number: int, count: int) -> np.ndarray:
    """Return the index of the override that holds for each agent in a frame, (count,) intp; -1 for
    none.
    """
    index_of = np.full(count, -1, np.intp)
    for index, each in enumerate(overrides):
        if each.holds(number):
            index_of[each.agents] = index
    return index_of


def lod_limits(
    overrides: Sequence[LodOverride], number: int, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what overrides allow `count` agents in the frame `number` of the timeline.

    Returns (the finest LOD (count,) uint8, the coarsest (count,) uint8, who is hidden (count,)
    bool).
    """
    index = in_force(overrides, number, count)
    # the last entry is for agents without one
    finest = [each.level * (each.type == ALWAYS) for each in overrides]
    coarsest = [NO_LIMIT if each.type == HIDE else each.level for each in overrides]
    hidden = [each.type == HIDE for each in overrides]
    return (
        np.array([*finest, 0], np.uint8)[index],
        np.array([*coarsest, NO_LIMIT], np.uint8)[index],
        np.array([*hidden, False])[index],
    )


def override_survey(survey: Survey, overrides: Sequence[LodOverride]) -> Survey:
    """Return the survey with the overrides; its arrays are changed.

    Whom one hides counts as culled. Who appears in sight when one ends has entered.
    """
    if not overrides:
        return survey
    finest = np.zeros_like(survey.kind)
    limit = np.zeros_like(survey.kind)
    was_hidden = np.zeros(len(survey.group), bool)  # hidden in the frame before, and otherwise seen
    for f, number in enumerate(survey.numbers.tolist()):
        least, most, hidden = lod_limits(overrides, number, len(survey.group))
        agents, cells = survey.cells.in_frame(f)
        finest[cells] = least[agents]
        limit[cells] = most[agents]
        shows = np.zeros(len(hidden), bool)
        shows[agents] = survey.kind[cells] == SEEN
        appears = np.flatnonzero(was_hidden & shows & ~hidden & (not survey.cuts[f]))
        entered = survey.entered[f]
        entered = entered[~hidden[entered["agent"]]]
        appears = np.setdiff1d(appears, entered["agent"])
        entered = np.append(entered, at_once(appears, Cause.OVERRIDE))
        survey.entered[f] = entered[np.argsort(entered["agent"])]
        gone = survey.left[f]
        survey.left[f] = gone[~(hidden | was_hidden)[gone["agent"]]]
        was_hidden = shows & hidden
        hidden_cells = cells[hidden[agents]]
        for column in (survey.kind, survey.coarsest, survey.scale, survey.character):
            column[hidden_cells] = 0  # the kind CULLED is 0
        seen = cells[(shows & ~hidden)[agents]]
        survey.coarsest[seen] = np.clip(survey.coarsest[seen], finest[seen], limit[seen])
    return replace(survey, finest=finest, limit=limit)


def override_frame(frame: Frame, overrides: Sequence[LodOverride], number: float) -> Frame:
    """Return `frame`, which has no shot plan, with the overrides that hold in it.

    number: of the frame on the timeline; the part of a frame counts as the frame.
    """
    number = int(np.floor(number + 1e-6))
    index = in_force(overrides, number, len(frame.crowd))
    asked = index >= 0
    if not asked.any():
        return frame
    most = np.array(
        [*(NO_LIMIT if each.type == HIDE else each.level for each in overrides), NO_LIMIT],
        np.uint8,
    )[index]
    levels = np.minimum(frame.levels, most) | np.where(frame.levels > most, OVERRIDDEN, 0).astype(
        np.uint8
    )
    return replace(with_row(frame, override_levels(levels, number, overrides)), by_plan=False)


def override_levels(
    levels: np.ndarray, number: int, overrides: Sequence[LodOverride]
) -> np.ndarray:
    """Return what a plan stores of a frame (see planned.with_row).

    These are `levels` (n,) uint8 with what overrides pin and hide.

    number: of the frame on the timeline.
    """
    index = in_force(overrides, number, len(levels))
    if not (index >= 0).any():
        return levels
    pinned, hidden = (
        np.array([*(entry.type == kind for entry in overrides), False])[index]
        for kind in (ALWAYS, HIDE)
    )
    level = np.array([*(entry.level for entry in overrides), 0], np.uint8)[index]
    return np.where(pinned, level | PINNED | OVERRIDDEN, levels) | np.where(
        hidden, HIDDEN, 0
    ).astype(np.uint8)
