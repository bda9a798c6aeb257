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
    levels: (F, n) uint8.
    radius: (G,) float64 meters, of the groups' bounding spheres.

    frame: on the timeline. agent: its number. before, after: the LODs; NOTHING before an
    entry and after an exit. size: pixels that the bounding sphere is wide, at most. change: pixels
    by which the picture changes there, at most; for an entry and an exit the size.
    """
    survey = shot.survey
    parts = []
    for f, number in enumerate(survey.numbers.tolist()):
        agents, change = switched(shot, levels, f)
        # seen at the frame's own time, not only at another of the shutter
        entered = survey.entered[f][survey.scale[f, survey.entered[f]] > 0]
        left = survey.left[f][survey.scale[f - 1, survey.left[f]] > 0]
        rows = np.empty(len(agents) + len(entered) + len(left), ROW)
        rows["frame"] = number
        rows["agent"] = np.concatenate([agents, entered, left])
        gone = slice(len(rows) - len(left), None)
        at_once = slice(len(agents), None)
        rows["before"] = levels[f - 1, rows["agent"]]
        rows["before"][len(agents) : gone.start] = NOTHING
        rows["after"] = levels[f, rows["agent"]]
        rows["after"][gone] = NOTHING
        scale = survey.scale[f, rows["agent"]].astype(np.float64)
        scale[gone] = survey.scale[f - 1, left]
        rows["size"] = scale * 2 * radius[survey.group[rows["agent"]]]
        rows["change"][: len(agents)] = change
        rows["change"][at_once] = rows["size"][at_once]
        parts.append(rows[rows["agent"].argsort()])
    return np.concatenate(parts)


def largest(found: np.ndarray, most: int) -> np.ndarray:
    """Return the `most` rows of ROW with the largest change; of equal ones the first."""
    return found[np.argsort(-found["change"], kind="stable")[:most]]
