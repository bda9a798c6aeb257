"""The work that a scene does not need, each part with its reason.

A plan without it is the same as the full pipeline's, bit for bit.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class LeftOut:
    """A part of the pipeline's `stage` that a scene does not need, and why."""

    stage: str
    reason: str


STATIC = LeftOut("plan", "Neither an agent nor the camera moves: the plan made before holds.")
STILL = LeftOut(
    "behavior",
    "No agent ever moves or changes its state: behavior ran once, and only the action plays on.",
)
BLOCKS = LeftOut(
    "culling",
    "Agents are in blocks: those of a block outside the picture, or inside and in one LOD, are "
    "not tested.",
)

# Of the agents that the camera does not see (frame/shadows.py).
NO_SHADOWS = LeftOut(
    "surroundings",
    "No light casts shadows: agents outside the picture are not searched for shadows in it.",
)
NO_MIRRORS = LeftOut(
    "surroundings",
    "No mirrors are chosen: agents outside the picture are not searched for reflections in it.",
)
NO_SKY = LeftOut(
    "surroundings",
    "No sky lights the picture, for the world is black or the engine is not Cycles: agents beside "
    "the picture are not kept for that light.",
)
SKY_NOT_WANTED = LeftOut(
    "surroundings",
    "Sky Light is off: agents beside the picture are not kept for the light that they take from "
    "it.",
)
NOT_WANTED = LeftOut(
    "surroundings",
    "Shadows and Reflections is off: agents that the camera does not see are left out.",
)
WORKBENCH = LeftOut(
    "surroundings",
    "Workbench draws no shadows of lights and no reflections: agents that the camera does not see "
    "are left out.",
)
