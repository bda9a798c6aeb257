"""Sample scenes, made by scripts: deterministic, and small.

"chapter" is the scene of the chapter's figure 1.5. "plaza" is a town square with walls and a flying
camera. "station" is a concourse of two floors, whose people were simulated. "stand" is an audience.
"""

# No bpy up here: the plaza's plan, NumPy alone, is tested without Blender.
from ..crowd_lod.errors import CrowdError

NAMES = ("chapter", "plaza", "station", "stand")


def make(name: str, scene) -> None:
    """Fill the new, empty `scene` with the sample scene `name`.

    It gets objects, characters, camera, world, timeline and the crowd's settings. Nothing else in
    the file changes.
    CrowdError if there is no sample scene of this name.
    """
    if name not in NAMES:
        raise CrowdError(f"There is no sample scene {name!r}; there are {', '.join(NAMES)}.")
    from . import chapter, plaza, stand, station

    samples = {"chapter": chapter, "plaza": plaza, "station": station, "stand": stand}
    samples[name].make(scene)
