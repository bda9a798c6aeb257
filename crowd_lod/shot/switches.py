"""What a viewer may notice in a shot: switches of LODs in sight, and characters that appear or
vanish at once; and the worst of it in a line.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..culling.camera import Camera
from ..format import counted, number
from .shot_cost import Shot, switched
from .survey import Cause, Survey

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


@dataclass(frozen=True)
class LargestSwitch:
    """The largest switch in sight: pixels by which it changes the picture, and where it is."""

    pixels: float
    frame: int
    agent: int

    @property
    def sentence(self) -> str:
        return f"Largest visible pop: {number(self.pixels)} px at frame {self.frame}."


@dataclass(frozen=True)
class Clipped:
    """The frame in which most agents appear, or vanish, at once.

    appear: whether they appear. cause: the name of the Cause of most of them. reach: meters from
        the camera to its clip, where one is the cause.
    """

    agents: int
    appear: bool
    cause: str
    reach: float | None
    frame: int

    @property
    def sentence(self) -> str:
        verb = ("appear" if self.appear else "vanish") + ("s" if self.agents == 1 else "")
        where = "where an override ends"
        if self.reach is not None:
            where = f"at the {self.cause} clip ({number(self.reach)} m)"
        return f"{counted(self.agents, 'agent')} {verb} at once {where} at frame {self.frame}."


@dataclass(frozen=True)
class Verdict:
    """The worst that a viewer may notice; None where there is no such thing."""

    change: LargestSwitch | None = None
    clipped: Clipped | None = None

    @property
    def notable(self) -> bool:
        """Whether there is anything that a viewer may notice."""
        return self.change is not None or self.clipped is not None

    @property
    def sentence(self) -> str:
        change = self.change.sentence if self.change else "No visible LOD switches."
        return f"{change} {self.clipped.sentence}" if self.clipped else change


def read_verdict(values: Mapping[str, Any]) -> Verdict:
    """Return the verdict that plan.json tells; LookupError or TypeError if it is none."""
    change = values["change"]
    clipped = values["clipped"]
    return Verdict(change and LargestSwitch(**change), clipped and Clipped(**clipped))


def verdict_of(
    survey: Survey, noticed: np.ndarray, cameras: Sequence[Camera], meters: float
) -> Verdict:
    """Return the verdict on the switches, entries and exits of a shot.

    noticed: (s,) of switches.ROW.
    cameras: one for each frame of the survey.
    meters: that a unit is.
    """
    by_clip = (noticed["before"] == NOTHING) | (noticed["after"] == NOTHING)
    switches = largest(noticed[~by_clip], 1)
    change = None
    if len(switches):
        (row,) = switches
        change = LargestSwitch(float(row["change"]), int(row["frame"]), int(row["agent"]))
    return Verdict(change, _clipped(survey, noticed[by_clip], cameras, meters))


def _clipped(
    survey: Survey, rows: np.ndarray, cameras: Sequence[Camera], meters: float
) -> Clipped | None:
    if not len(rows):
        return None
    appears = rows["before"] == NOTHING
    events, counts = np.unique(np.stack([rows["frame"], appears]), axis=1, return_counts=True)
    frame, appear = events[:, counts.argmax()].tolist()
    agents = rows["agent"][(rows["frame"] == frame) & (appears == appear)]
    f = int(np.searchsorted(survey.numbers, frame))
    found = survey.entered[f] if appear else survey.left[f]
    causes = found["cause"][np.isin(found["agent"], agents)]
    cause = Cause(int(np.bincount(causes).argmax()))
    clips = {Cause.NEAR: cameras[f].near, Cause.FAR: cameras[f].far}
    reach = meters * clips[cause] if cause in clips else None
    return Clipped(len(agents), bool(appear), cause.name.lower(), reach, frame)
