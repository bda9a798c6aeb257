"""What a viewer may notice in a shot: switches of LODs in sight, and characters that appear or
vanish at once.
"""

import numpy as np

from .shot_cost import Shot, switched

NOTHING = -1  # the LOD before an entry and after an exit: none
WORST = 3  # of the largest changes, which the report shows
ROW = np.dtype(
    [
        ("frame", np.int64),
        ("agent", np.int64),
        ("before", np.int8),
        ("after", np.int8),
        ("size", np.float64),
        ("change", np.float64),
    ]
)


def noticed(shot: Shot, levels: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Return all switches in sight, entries and exits, (s,) ROW, by frame and then by agent.

    An entry is an agent that the near or far clip hid in the frame before, an exit one that it
    hides from this frame on.
    levels: (N,) uint8.
    radius: (G,) float64 meters, of the groups' bounding spheres.

    frame: on the timeline. agent: its number. before, after: the LODs; NOTHING before an
    entry and after an exit. size: pixels that the bounding sphere is wide, at most. change: pixels
    by which the picture changes there, at most; for an entry and an exit the size.
    """
    survey = shot.survey
    cells = survey.cells
    scale = survey.scale
    parts = [np.empty(0, ROW)]
    for (block,) in cells.tables():
        frame, agents, change = switched(shot, levels, block)
        now = cells.at(frame, agents)
        rows = _rows(frame, agents, scale[now])
        rows["before"] = levels[cells.at(frame - 1, agents)]
        rows["after"] = levels[now]
        rows["change"] = change
        parts.append(rows)
    for f, (entered, left) in enumerate(zip(survey.entered, survey.left, strict=True)):
        for found, shown_in, absent in ((entered, f, "before"), (left, f - 1, "after")):
            agents = found["agent"]
            at = cells.at(shown_in, agents)
            rows = _rows(np.full(len(at), f), agents, scale[at])
            rows["before"] = rows["after"] = levels[at]
            rows[absent] = NOTHING
            # seen at the frame's own time, not only at another of the shutter
            parts.append(rows[rows["size"] > 0])
    rows = np.concatenate(parts)
    rows["size"] *= 2 * radius[survey.group[rows["agent"]]]
    is_at_once = (rows["before"] == NOTHING) | (rows["after"] == NOTHING)
    rows["change"][is_at_once] = rows["size"][is_at_once]
    rows = rows[np.lexsort((rows["agent"], rows["frame"]))]
    rows["frame"] = survey.numbers[rows["frame"]]
    return rows


def _rows(frame: np.ndarray, agents: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return rows of ROW of `agents` (m,), without their LODs."""
    rows = np.zeros(len(agents), ROW)
    rows["frame"] = frame
    rows["agent"] = agents
    rows["size"] = size
    return rows


def largest(found: np.ndarray, most: int) -> np.ndarray:
    """Return the `most` rows of ROW with the largest change; of equal ones the first."""
    return found[np.argsort(-found["change"], kind="stable")[:most]]
