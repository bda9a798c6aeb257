"""Overrides in a scene of the small crowd, whom they mean, and plans that keep to them."""

import json
from pathlib import Path

import bpy
import numpy as np
from crowd_lod_extension.crowd_lod.shot import plan_file

from .objects import box_mesh, placed
from .scene_frames import frame_now

FRAMES = range(1, 13)


def add(scene, name="Hero", frames=(), **settings):
    """Add an override, of all frames or of those from the first to the last of `frames`."""
    entry = scene.crowd_lod.overrides.add()
    entry.name = name
    if frames:
        entry.all_frames = False
        entry.first_frame, entry.last_frame = frames
    for key, value in settings.items():
        setattr(entry, key, str(value) if key == "agents" else value)
    return entry


def press(scene, agent: int, *types: str) -> None:
    """Pick the agent, and press the buttons of these overrides."""
    scene.crowd_lod.agent = agent
    for type_ in types:
        assert bpy.ops.crowd_lod.override_agent(type=type_) == {"FINISHED"}


def cube(low=(-5, -8, -1), high=(9, 0, 1), name="Region"):
    """A mesh whose box is the world's from `low` to `high`."""
    mesh = box_mesh(name, (-1, -1, -1), (1, 1, 1))
    item = placed(name, mesh, location=(np.array(low) + high) / 2, scale=(np.array(high) - low) / 2)
    bpy.context.view_layer.update()
    return item


def inside(crowd, low=(-5, -8), high=(9, 0)) -> list[int]:
    """The agents in a box seen from above: that of `cube`, if no other is given."""
    place = np.stack([crowd.x, crowd.y], axis=1)
    return np.flatnonzero(((place >= low) & (place <= high)).all(axis=1)).tolist()


def planned(scene, folder: Path):
    """Press Plan Shot; the levels of the frames (F, n), and plan.json."""
    settings = scene.crowd_lod
    settings.frames = "1:12"
    settings.output_folder = str(folder)
    assert bpy.ops.crowd_lod.plan_shot() == {"FINISHED"}
    stored = plan_file.read(folder / "plan" / "plan.npz")
    rows = [stored.row(f, settings.count) for f in range(12)]
    return np.array(rows), json.loads((folder / "plan" / "plan.json").read_text())


def frame_at(scene, number: int):
    scene.frame_set(number)
    return frame_now(scene, bpy.context.evaluated_depsgraph_get())


def seen_at(scene, level: int) -> list[int]:
    """The agents that are seen with this LOD in all frames."""
    frames = [frame_at(scene, number) for number in FRAMES]
    seen = [frame.visible & (frame.levels == level) for frame in frames]
    return np.flatnonzero(np.logical_and.reduce(seen)).tolist()
