"""The LODs of a scene by tolerance: the candidates, and where the shot has its agents."""

from collections.abc import Iterator

import bpy
import numpy as np

from ..crowd_lod.agents import Group
from ..crowd_lod.chain import LADDER, View
from ..crowd_lod.culling import radar
from ..crowd_lod.errors import CrowdError
from ..crowd_lod.levels import LevelPolicy
from ..crowd_lod.shot import parse_frames
from .cameras import cameras_at
from .populate import bias_of, trajectory_of

MOST_FRAMES = 9  # of the shot, evenly, that are looked at


def ratios_of(settings) -> list[float]:
    """The parts of the triangles that the LODs to be made keep: those that are set, or by tolerance all candidates."""
    if settings.choice == "BY_TOLERANCE":
        LevelPolicy((0.0,), "PIXELS", tolerance=round(settings.tolerance, 6))  # refuses a wrong one
        return list(LADDER)
    ratios = [round(r, 6) for r in settings.ratios[: settings.level_count]]
    for k in range(1, len(ratios)):
        if ratios[k] >= ratios[k - 1]:
            raise CrowdError(f"The ratio of LOD {k}, {ratios[k]:g}, is not below that of LOD {k - 1}, {ratios[k - 1]:g}: lower it.")
    return ratios


def views(scene: bpy.types.Scene, groups: tuple[Group, ...]) -> Iterator[float]:
    """Of each group the views of the shot's frames, up to MOST_FRAMES; yields the part done.

    A group that none shows may be anywhere within the camera's clip range.
    """
    settings = scene.crowd_lod
    frames = parse_frames(settings.frames, settings.step)
    chosen = sorted({frames[i] for i in np.linspace(0, len(frames) - 1, MOST_FRAMES).round().astype(int)})
    trajectory = trajectory_of(scene, groups)
    bias, cameras = bias_of(settings, trajectory.world.area), cameras_at(scene, chosen)
    centre, radius = (np.array([getattr(group, name) for group in trajectory.groups]) for name in ("centre", "radius"))
    found = [[] for _ in groups]
    for done, (frame, eyes) in enumerate(zip(chosen, cameras, strict=True), start=1):
        crowd = trajectory.at(frame)
        visible, distance = radar(crowd, eyes, centre, radius)
        if bias is not None:
            distance = distance * bias.at(crowd.x, crowd.y)
        for g, each in enumerate(found):
            own = distance[visible & (crowd.group == g)]
            if len(own):
                each.append(View(eyes[0], float(own.min()), float(own.max())))
        yield done / len(chosen)
    return [each or [View(eyes[0], eyes[0].near, eyes[0].far) for eyes in cameras] for each in found]
