"""What a build's rigs play: by this it is told whether they still play as the crowd's agents do."""

from collections.abc import Generator, Sequence

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


def inputs(
    homes: Sequence[bpy.types.Collection], trajectory: Trajectory
) -> Generator[float, None, list]:
    """Read all that rigs play: how, and the actions that states name.

    Yields between the LODs, and returns it to compare as text.

    homes: the collections of the LODs.
    """
    if not any(trajectory.gaits.actions):
        return numbers(trajectory)
    groups = {group.name: group for group in trajectory.groups}
    digests = []
    for home in homes:
        name = home.get(GROUP, home.name)
        if name in groups:
            act = named_actions.group_performance(groups[name], list(home.objects))
            digests.append(performance.digest(act.parts))
            yield 0.0
    return [*numbers(trajectory), actions(trajectory), *digests]
