"""What a viewer may notice in a shot: switches of LODs in sight, and characters that appear at
once.
"""

import numpy as np

from .shot_cost import Shot, switched

NOTHING = -1  # the LOD before an entry: none
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
    """Return all switches in sight and all entries, (s,) ROW, by frame and then by agent.

    An entry is an agent that the near or far clip hid in the frame before.
    levels: (F, n) uint8.
    radius: (G,) float64 meters, of the groups' bounding spheres.

    frame: on the timeline. agent: its number. before, after: the LODs; `before` is NOTHING for an
    entry. size: pixels that the bounding sphere is wide, at most. change: pixels by which the
    picture changes there, at most; for an entry its size.
    """
    survey = shot.survey
    parts = []
    for f, number in enumerate(survey.numbers.tolist()):
        agents, change = switched(shot, levels, f)
        entered = survey.entered[f]
        entered = entered[
            survey.scale[f, entered] > 0
        ]  # seen at the frame's own time, not only at another of the shutter
        rows = np.empty(len(agents) + len(entered), ROW)
        rows["frame"] = number
        rows["agent"] = np.concatenate([agents, entered])
        rows["before"] = np.concatenate([levels[f - 1, agents], np.full(len(entered), NOTHING)])
        rows["after"] = levels[f, rows["agent"]]
        rows["size"] = (
            survey.scale[f, rows["agent"]].astype(np.float64)
            * 2
            * radius[survey.group[rows["agent"]]]
        )
        rows["change"] = np.concatenate([change, rows["size"][len(agents) :]])
        parts.append(rows[rows["agent"].argsort()])
    return np.concatenate(parts)


def largest(found: np.ndarray, most: int) -> np.ndarray:
    """Return the `most` rows of ROW with the largest change; of equal ones the first."""
    return found[np.argsort(-found["change"], kind="stable")[:most]]
