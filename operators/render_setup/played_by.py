"""What a build's rigs play: by this it is told whether they still play as the crowd's agents do."""

import numpy as np

from ...crowd_lod.sources.trajectory import Trajectory


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
