"""The LODs of a scene by tolerance: where the shot has its agents, and what is left of the ladder of candidates."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import bpy
import numpy as np

from ..crowd_lod.agents import Group
from ..crowd_lod.chain import LADDER, View, choose
from ..crowd_lod.culling import radar
from ..crowd_lod.errors import CrowdError
from ..crowd_lod.frame import deviations
from ..crowd_lod.levels import LevelPolicy
from ..crowd_lod.shot import parse_frames
from ..crowd_lod.steps import standing
from . import scene as io
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


def check(scene: bpy.types.Scene, groups: tuple[Group, ...]) -> None:
    """CrowdError if the shot cannot be looked at: said before the candidates are made, which takes minutes."""
    _shot(scene, groups)


def _shot(scene: bpy.types.Scene, groups: tuple[Group, ...]) -> tuple:
    """(the trajectory of the groups, the detail map or None, the frames looked at, the cameras of each)."""
    settings = scene.crowd_lod
    frames = parse_frames(settings.frames, settings.step)
    chosen = sorted({frames[i] for i in np.linspace(0, len(frames) - 1, MOST_FRAMES).round().astype(int)})
    trajectory = trajectory_of(scene, groups)
    return trajectory, bias_of(settings, trajectory.world.area), chosen, cameras_at(scene, chosen)


def views(scene: bpy.types.Scene, groups: tuple[Group, ...]) -> Iterator[float]:
    """Of each group the views of the shot's frames, up to MOST_FRAMES; yields the part done.

    A group that none shows may be anywhere within the camera's clip range.
    """
    trajectory, bias, chosen, cameras = _shot(scene, groups)
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


def chosen(scene: bpy.types.Scene, groups: Sequence[Group], progress: float) -> Iterator[float]:
    """(of each group the candidates to keep, why the others are dropped, a sentence each); yields `progress`."""
    seen = yield from standing(views(scene, tuple(groups)), progress)
    keep, said, tolerance = [], [], round(scene.crowd_lod.tolerance, 6)
    for group, each in zip(groups, seen, strict=True):
        policy = LevelPolicy(
            (0.0,) * (len(group.bounds) - 1), "PIXELS", tolerance=tolerance, shading=scene.crowd_lod.shading_counts
        )
        off = replace(group, bounds=tuple(deviations((group,), policy)[0].tolist()))
        kept, reasons = choose(off, tolerance, each, io.metres(scene))
        keep.append(kept)
        said += [f"{group.name}: {reason}" for reason in dict.fromkeys(reasons)]
    return keep, said
