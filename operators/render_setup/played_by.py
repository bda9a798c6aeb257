"""What a build's rigs play: by this it is told whether they still play as the crowd's agents do."""

from collections.abc import Sequence

import bpy
import numpy as np

from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import named_actions, performance
from ..characters.characters import GROUP


def numbers(trajectory: Trajectory) -> list[float]:
    """Return the numbers on which rigs depend that play as agents of `trajectory` do."""
    gaits = trajectory.gaits
    own = trajectory.seconds_per_frame, gaits.classes, *np.concatenate(gaits.distinct)
    return [float(each) for each in own]


def actions(trajectory: Trajectory) -> str:
    """Return the names of the actions that rigs play, a line for each group.

    "" if all play their own alone.
    """
    names = trajectory.gaits.actions
    return (
        "\n".join(", ".join(names[k] for k, _ in own) for own in trajectory.gaits.plays)
        if any(names)
        else ""
    )


def inputs(homes: Sequence[bpy.types.Collection], trajectory: Trajectory) -> list:
    """Return all that rigs play, to compare as text: how, and the actions that states name.

    homes: the collections of the LODs.
    """
    if not any(trajectory.gaits.actions):
        return numbers(trajectory)
    groups = {group.name: group for group in trajectory.groups}
    named = ((home.get(GROUP, home.name), list(home.objects)) for home in homes)
    acts = [
        named_actions.group_performance(groups[name], own) for name, own in named if name in groups
    ]
    return [
        *numbers(trajectory),
        actions(trajectory),
        *(performance.digest(act.parts) for act in acts),
    ]
