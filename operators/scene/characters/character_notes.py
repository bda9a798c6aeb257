"""What is to be said of characters: root motion, feet that slide, textures that are missing."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import bpy
import numpy as np

from ....crowd_lod.crowd.agents import Action, Group
from ....crowd_lod.crowd.state_machine import StateMachine
from ....crowd_lod.crowd.strides import BY_STRIDE, Plays
from ....crowd_lod.format import printable
from ....crowd_lod.messages import Message, MessageKind
from ...blender import scene_data
from ...blender.materials import images_of
from ...blender.named_actions import find_action
from ...settings.crowds import crowds_of
from ..machine.scene_world import machine_of
from .rig_needs import Characters
from .strides import speeds_of

SLIDES = 0.01  # meters in a cycle: feet that slide less do not count


def notes_on_actions(scene: bpy.types.Scene, groups: Sequence[Group]) -> Iterator[Message]:
    """Yield messages on the characters' own actions, and on those that states of the crowds name.

    groups: as just measured.
    """
    machines = [
        machine_of(crowd) for crowd in crowds_of(scene.crowd_lod) if crowd.source == "MACHINE"
    ]
    for group in groups:
        if group.variant_of:
            continue
        own = Action("", group.stride, group.period, way=group.way, plays=group.plays)
        for action in (own, *group.actions):
            yield from _root_motion(scene, group, action)
        for action in group.actions:
            yield from _slides(scene, group, action, machines)


def _root_motion(scene: bpy.types.Scene, group: Group, action: Action) -> Iterator[Message]:
    """Yield a message on how far an action moves the group, and whether that is its stride."""
    if not action.way:
        return
    way = float(action.way * scene_data.meters(scene))
    facts = {"action": _title(group, action) if action.name else "", "way": way}
    if action.plays in BY_STRIDE:
        yield Message(MessageKind.ROOT_MOTION, group.name, facts)
        return
    speeds = sorted({speed for speed in speeds_of(scene, group.name, action.name) if speed})
    why = {
        "aside": scene.crowd_lod.forward if action.plays is Plays.ASIDE else "",
        "speeds": speeds,
    }
    period = {"period": float(action.period)}
    yield Message(MessageKind.NO_STRIDE, group.name, facts | period | why)


def _slides(
    scene: bpy.types.Scene, group: Group, action: Action, machines: Sequence[StateMachine]
) -> Iterator[Message]:
    speeds = {
        (machine.states[s], float(speed))
        for machine in machines
        for s, name in enumerate(machine.actions)
        if name == action.name
        for speed in np.unique(np.hypot(*machine.velocity[s].T))
    }
    walks = sorted((speed, state) for state, speed in speeds if speed)
    if not walks or not action.period:
        return
    speed, state = walks[-1]
    slide = abs((action.stride or speed * action.period) - action.feet)
    meters = scene_data.meters(scene)
    if slide * meters > SLIDES:
        feet = action.feet * meters
        facts = {
            "state": state,
            "action": _title(group, action),
            "slide": float(slide * meters),
            "stride": bool(action.stride),
            "fits": float(feet if action.stride else feet / action.period),
        }
        yield Message(MessageKind.FEET_SLIDE, group.name, facts)


def _title(group: Group, action: Action) -> str:
    found = find_action(group.name, action.name)
    return found.name if found else action.name


def notes_on_images(characters: Characters) -> Iterator[Message]:
    """Yield messages on the characters' images whose files are missing."""
    for name, objects, _ in characters:
        missing = filter(_is_missing, images_of(objects))
        if paths := sorted(printable(_path_of(image)) for image in missing):
            yield Message(MessageKind.IMAGE_MISSING, name, {"paths": paths})


def _path_of(image: bpy.types.Image) -> Path:
    return Path(bpy.path.abspath(image.filepath, library=image.library))


def _is_missing(image: bpy.types.Image) -> bool:
    is_file = image.source == "FILE" and not image.packed_files
    return is_file and not image.has_data and not _path_of(image).is_file()
