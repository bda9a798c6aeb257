"""The worst that a viewer may notice in a shot, in a line."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..culling.camera import Camera
from ..format import counted, number
from .survey import Cause, Survey
from .switches import NOTHING, largest


@dataclass(frozen=True)
class LargestSwitch:
    """The largest switch in sight: pixels by which it changes the picture, and where it is."""

    pixels: float
    frame: int
    agent: int

    @property
    def sentence(self) -> str:
        return f"Worst change in sight: {number(self.pixels)} px, frame {self.frame}."


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
        return f"{counted(self.agents, 'agent')} {verb} at once {where}, frame {self.frame}."


@dataclass(frozen=True)
class Verdict:
    """The worst that a viewer may notice; None where there is no such thing."""

    change: LargestSwitch | None = None
    clipped: Clipped | None = None

    @property
    def sentence(self) -> str:
        change = self.change.sentence if self.change else "No LOD changes in sight."
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
