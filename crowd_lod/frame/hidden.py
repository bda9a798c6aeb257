"""Agents in the picture that scenery hides (culling/occlusion.py)."""

import time as clock
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..culling.camera import Camera, as_pictured
from ..culling.occluders import Occluders
from ..culling.occlusion import OcclusionMap
from .frame import Frame
from .planned import with_levels
from .stages import moments

Maps = tuple[OcclusionMap, ...]  # of a moment's eyes


def can_hide(eyes: Sequence[Camera]) -> bool:
    """Return whether the cameras have maps: lens blur and panoramas see past what is before."""
    return all(eye.kind != "PANO" and not (eye.pad or eye.turn) for eye in eyes)


def hide(frame: Frame, occluders: Occluders | None) -> tuple[Frame, list[Maps]]:
    """Return (`frame` without the agents that scenery hides, the maps of its moments).

    An agent is hidden if no eye sees it at any moment. A pure function of the arguments.

    occluders: what stands still while the shutter is open. None, or a camera that cannot have a
        map, hides nobody: there are then no maps.
    """
    if occluders is None:
        return frame, []
    begun = clock.perf_counter()
    maps = _maps_of(frame, occluders) if can_hide(frame.eyes) else []
    hidden = np.zeros(len(frame.crowd), bool)
    if maps and not any(film.is_empty for films in maps for film in films):
        hidden[_hidden_agents(frame, maps)] = True
        frame = with_levels(frame, frame.buckets.among(~hidden), frame.known_levels)
    milliseconds = frame.milliseconds | {"occlusion": 1000 * (clock.perf_counter() - begun)}
    return replace(frame, hidden=hidden, milliseconds=milliseconds), maps


def _maps_of(frame: Frame, occluders: Occluders) -> list[Maps]:
    """Return the maps of the frame's moments.

    With motion blur a map holds from one sample of the shutter to the next.
    """
    films = [frame.eyes, *(eyes for _, eyes in frame.shutter)]
    # spheres are not grown for the camera's motion: the maps hold between the samples
    films = [tuple(replace(eye, pad=0.0, turn=0.0) for eye in as_pictured(eyes)) for eyes in films]
    if len(frame.shutter) < 2:
        return [tuple(OcclusionMap(occluders, eye) for eye in eyes) for eyes in films]
    maps = [
        tuple(OcclusionMap(occluders, *pair) for pair in zip(eyes, later, strict=True))
        for eyes, later in zip(films[1:-1], films[2:], strict=True)
    ]
    times = np.array([time for time, _ in frame.shutter])
    steps = np.searchsorted(times[1:-1], [frame.time, *times], side="right")
    return [maps[step] for step in steps.tolist()]


def _hidden_agents(frame: Frame, maps: Sequence[Maps]) -> np.ndarray:
    """Return those of the visible agents that all maps hide, (m,)."""
    trajectory = frame.trajectory
    agents = np.sort(frame.buckets.order)
    for moment, films in zip(moments(trajectory, frame), maps, strict=True):
        crowd = frame.crowd if moment.time == frame.time else trajectory.at(moment.time)
        for film in films:
            points = np.stack(crowd.places(trajectory.spheres.center, agents), axis=1)
            group = crowd.group[agents]
            radius = moment.radius[group]
            girth = trajectory.spheres.girth[group] + radius - trajectory.spheres.reach[group]
            agents = agents[film.hides_agents(points, radius, girth)]
    return agents


def hidden_wholly(frame: Frame) -> int:
    """Return how many agents scenery hides with their shadows and mirror images."""
    if frame.hidden is None:
        return 0
    hidden = frame.hidden.copy()
    for unseen in (frame.shadow, frame.mirrored):
        if unseen is not None:
            hidden[unseen.order] = False
    return int(hidden[: len(frame.trajectory.bare.start)].sum())
