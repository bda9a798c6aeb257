"""What plan.json tells of a scene and its crowd: all that is needed to repeat a run."""

import hashlib
import json
import platform
from collections.abc import Generator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...crowd_lod import __version__
from ...crowd_lod.behavior.walk import walks_of
from ...crowd_lod.format import printable
from ...crowd_lod.levels.budget_fit import Budget
from ...crowd_lod.messages import from_json
from ...crowd_lod.output import tables
from ...crowd_lod.progress import run_in_thread
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import cameras, scene_data
from ..lods.make_lods import TINTS
from ..scene.machine import scene_world
from ..scene.machine.scene_world import machine_of
from ..scene.scene_crowd import SceneCrowd
from ..scene.stuck_agents import find
from ..settings.messages import in_words
from ..settings.stored_figures import budget_of, budget_words


def scene_json(
    crowd: SceneCrowd,
    scene: bpy.types.Scene,
    command: list[str],
    last: int,
    characters: list[dict],
) -> Generator[float, None, dict[str, Any]]:
    """Make what plan.json tells of a scene and its crowd: yield between the steps, return the dict.

    crowd: that of `scene`, or of a copy of it whose settings count.
    command: the command line of the run.
    last: frame of the timeline.
    characters: of lod_table.tables.
    """
    first = crowd.settings.crowds[0]
    trajectory = crowd.trajectory
    meters = scene_data.meters(crowd.scene)
    troubles = yield from run_in_thread(lambda: find(trajectory, meters))
    return {
        "version": tables.PLAN_VERSION,
        "command": command,
        "made_with": {
            "crowd_lod": __version__,
            "blender": bpy.app.version_string,
            "python": platform.python_version(),
            "numpy": np.__version__,
        },
        "scene": _scene_of(scene),
        "crowd": crowd_json(crowd),
        "map": _map_of(first, trajectory),
        "height": {
            "image": first.height_image.name if first.height_image else None,
            "scale": first.height_scale * meters,
            "tilt": first.tilt,
            "terrain": [item.name for item in scene_world.objects_of(first)],
        },
        "machine": json.loads(machine_of(first).text) if walks_of(trajectory) else None,
        "trouble": troubles.rows,
        "trouble_says": troubles.sentence,
        "camera": cameras.bound_camera(scene, scene_data.remap(scene.render, last)).name,
        "levels": _levels_of(crowd, characters),
    }


def _map_of(first, trajectory: Trajectory) -> dict[str, Any] | None:
    walks = walks_of(trajectory)
    if not walks:
        return None
    labels = walks[0].world.labels
    return {
        "image": first.map_image.name if first.map_image else None,
        "cells": list(labels.shape[::-1]),
        "sha256": hashlib.sha256(labels.tobytes()).hexdigest(),
    }


def _scene_of(scene: bpy.types.Scene) -> dict[str, Any]:
    file = Path(bpy.data.filepath) if bpy.data.filepath else None
    return {
        "name": scene.name,
        "file": printable(file) if file else None,
        "sha256": hashlib.sha256(file.read_bytes()).hexdigest()
        if file and file.is_file()
        else None,
    }


def crowd_json(crowd: SceneCrowd) -> dict[str, Any]:
    """Return what plan.json tells of the first crowd and of the area of all, as plain data."""
    settings = crowd.settings
    first = settings.crowds[0]
    trajectory = crowd.trajectory
    area = trajectory.area
    meters = scene_data.meters(crowd.scene)
    return {
        "count": len(trajectory.parts[0].start),
        "seed": first.seed,
        "spawn_on": first.spawn_on,
        "area": {
            "x": [area.x_min * meters, area.x_max * meters],
            "y": [area.y_min * meters, area.y_max * meters],
            "z": area.z * meters,
        },
        "forward": settings.forward,
        "first_frame": first.first_frame,
        "frames_per_second": 1 / trajectory.seconds_per_frame,
        "groups": [asdict(group) for group in crowd.groups_in_meters],
    }


def _levels_of(crowd: SceneCrowd, characters: list[dict]) -> dict[str, Any]:
    settings = crowd.settings
    policy = crowd.policy
    return {
        "margin": policy.margin and policy.margin * scene_data.meters(crowd.scene),
        "tolerance": policy.tolerance,
        "budget": budget_words(settings) if budget_of(settings) != Budget() else None,
        "pixels": cameras.image_size(crowd.scene.render),
        "ratios": [round(r, 6) for r in settings.ratios[: policy.count]]
        if policy.tolerance is None
        else None,
        "thresholds": list(policy.thresholds) if policy.tolerance is None else None,
        "group_thresholds": [list(own) for own in policy.group_thresholds],
        "tints": TINTS[: policy.count],
        "characters": characters,
        "dropped": [
            line.sentence for message in from_json(settings.dropped) for line in in_words([message])
        ],
    }
