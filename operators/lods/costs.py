"""What the work of Make LOD Meshes costs."""

from dataclasses import dataclass, replace

import bpy

from ...crowd_lod.levels.assignment import deviations
from ..blender.mesh_data import count_triangles
from ..scene.characters.characters import Character, all_characters
from ..scene.characters.stored_groups import groups_of
from ..scene.scene_crowd import policy_of

# Seconds on a slow machine: of reading a character, for each thousand of its triangles; of work on
# one of its LODs, for the square root of these thousands.
LOAD = 0.01  # its meshes as they are
READ = 0.11  # its meshes in all poses
SEARCH = 2.3  # finding the LOD of a length
MAKE = 0.4  # making the LOD of a ratio, and measuring it
LOOK = 0.07  # looking at the LOD of a ratio between the poses
LOOK_SEARCHED = 1.0  # looking at the LODs that a character's searches have found
FURTHER = 0.35  # searches that the result of a search calls for, on average


@dataclass(frozen=True)
class LodCosts:
    """What the work on one character costs.

    triangles: that it has; searched: whether its LODs are of lengths, not of ratios; count: of its
    LODs by distance.
    """

    triangles: int = 0
    searched: bool = False
    count: int = 0

    @property
    def load(self) -> float:
        """That of reading the character as it is."""
        return LOAD * self.triangles / 1000

    @property
    def read(self) -> float:
        """That of reading the character in its poses."""
        return READ * self.triangles / 1000

    @property
    def make(self) -> float:
        """That of making and measuring one LOD."""
        return self._size * (SEARCH if self.searched else MAKE)

    @property
    def further(self) -> float:
        """That of further searches, while there are some."""
        return self._size * SEARCH * FURTHER if self.searched else 0.0

    @property
    def look(self) -> float:
        """That of looking at all LODs between the poses."""
        return self._size * (LOOK_SEARCHED if self.searched else LOOK * self.count)

    @property
    def expected(self) -> float:
        """That of all work after reading, as far as is known before it."""
        return self.look + (self.make + self.further) * (1 if self.searched else self.count - 1)

    @property
    def _size(self) -> float:
        return (self.triangles / 1000) ** 0.5


def costs_before(character: Character, settings) -> LodCosts:
    """Return what the work on a character will cost, as its meshes tell without being evaluated."""
    triangles = sum(map(_triangles_before, character.objects))
    return LodCosts(triangles, settings.choice == "BY_TOLERANCE", settings.level_count)


def lacking_seconds(scene: bpy.types.Scene) -> float:
    """Return about how many seconds making or measuring the LODs that `scene` lacks will take."""
    settings = scene.crowd_lod
    if settings.levels is None:
        return lod_seconds(scene)
    if deviations(groups_of(settings), policy_of(settings)) is not None:
        return 0.0
    costs = [costs_before(character, settings) for character in all_characters(scene)]
    return sum(each.read + replace(each, searched=False).expected for each in costs)


def lod_seconds(scene: bpy.types.Scene) -> float:
    """Return about how many seconds making all LODs of `scene` will take."""
    costs = [costs_before(character, scene.crowd_lod) for character in all_characters(scene)]
    return sum(each.load + each.read + each.expected for each in costs)


def _triangles_before(item: bpy.types.Object) -> int:
    """Return about how many triangles the object will have; 0 of one without a mesh of its own."""
    if item.type != "MESH":
        return 0
    levels = sum(each.levels for each in item.modifiers if each.type in ("SUBSURF", "MULTIRES"))
    return count_triangles(item.data) * 4**levels
