"""LODs that artists made: recognized by the names of objects, of their parents and collections.

Man_LOD1, man.lod1, LOD1 and LOD1_Man are of LOD 1, and so is the x1_Man of flight simulators. A
custom property "lod" that is a whole number says it as well.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

import bpy

from ...blender.character_objects import GEOMETRY, may_have_faces

PROPERTY = "lod"  # custom property of an object: of which LOD it is
NUMBER = re.compile(r"^x(\d{1,2})_(?=.)|(?:(?<![A-Za-z])lod|LOD|Lod)[ _-]?(\d{1,2})(?!\d)")
SEPARATORS = " _.-"

Owner = bpy.types.Collection | bpy.types.Object
Numbered = dict[int, list[bpy.types.Object]]  # number of a LOD -> its objects


class Label(NamedTuple):
    """What a name says of LODs.

    stem: the name without the number, in small letters.
    number: of the LOD, None if the name says nothing.
    """

    stem: str
    number: int | None


class GivenLod(NamedTuple):
    """A LOD that an artist made.

    objects: with a shape.
    offset: world meters, from where it stands to where its character does.
    """

    objects: list[bpy.types.Object]
    offset: tuple[float, float, float]

    def objects_with_faces(self) -> list[bpy.types.Object]:
        return [item for item in self.objects if item.type in GEOMETRY and may_have_faces(item)]


class CharacterGroup(NamedTuple):
    """What a character group is made of.

    owner: the collection or object that names it.
    members: all objects of its finest LOD.
    origin: world meters.
    lods: members of each LOD that was given, and its offset; the finer ones first.
    """

    owner: Owner
    members: list[bpy.types.Object]
    origin: tuple[float, float, float]
    lods: tuple[GivenLod, ...] = ()


def label_of(name: str) -> Label:
    match = NUMBER.search(name)
    if match is None:
        return Label(name.casefold(), None)
    before = name[: match.start()].rstrip(SEPARATORS)
    after = name[match.end() :]
    return Label((before + after).lstrip(SEPARATORS).casefold(), int(match[1] or match[2]))


def with_given_lods(
    groups: Sequence[tuple[Owner, list[bpy.types.Object], tuple]],
) -> list[CharacterGroup]:
    """Return character groups, in which LODs of one character are together.

    groups: (owner, members, origin) of each, where LODs may be among the members, or groups of
        their own.
    """
    numbered = [_by_number(owner, members) for owner, members, _ in groups]
    families = _families(
        [(owner, lods) for (owner, *_), lods in zip(groups, numbered, strict=True)]
    )
    return [_group_of([(groups[k], numbered[k]) for k in family]) for family in families]


def _group_of(family: Sequence[tuple[tuple, Numbered]]) -> CharacterGroup:
    """Return the group of (owner, members, origin), LODs by number; the finest comes first."""
    (owner, _, origin), lods = family[0]
    finest = min(lods)
    given = {}
    for (_, _, place), others in family:
        offset = tuple(here - there for here, there in zip(origin, place, strict=True))
        given |= {number: GivenLod(items, offset) for number, items in others.items()}
    coarser = sorted(number for number in given if number > finest)
    return CharacterGroup(owner, lods[finest], origin, tuple(given[number] for number in coarser))


def _by_number(owner: Owner, members: Sequence[bpy.types.Object]) -> Numbered:
    """Return the members of each LOD that names tell of; all of them as LOD 0 if they tell of none.

    What has no number, such as a rig, is in each. If nothing is of LOD 0, meshes without a number
    are.
    """
    together = set(members)
    numbers = {item: _number(item, owner, together) for item in members}
    shapes = [item for item in members if item.type in GEOMETRY and may_have_faces(item)]
    stems = {label_of(item.name).stem for item in shapes if numbers[item] is not None}
    no_finest = 0 not in [numbers[item] for item in shapes]
    for item in shapes:
        if numbers[item] is None and (no_finest or label_of(item.name).stem in stems):
            numbers[item] = 0
    found = sorted({numbers[item] for item in shapes} - {None})
    return {
        number: [item for item in members if numbers[item] in (None, number)] for number in found
    } or {0: list(members)}


def _number(item: bpy.types.Object, owner: Owner, members: set[bpy.types.Object]) -> int | None:
    """Return of which LOD an object of a character is, as it, its parents or collections say."""
    said = item.get(PROPERTY)
    if isinstance(said, int):
        return said
    inside = () if isinstance(owner, bpy.types.Object) else owner.children_recursive
    names = [item.name, *(home.name for home in inside if item in home.objects[:])]
    above = item.parent
    while above is not None and above in members:
        names.append(above.name)
        above = above.parent
    if item.type in GEOMETRY:  # rigs are of all LODs
        names.append(owner.name)
    numbers = (label_of(name).number for name in names)
    return next((number for number in numbers if number is not None), None)


def _families(groups: Sequence[tuple[Owner, Numbered]]) -> list[list[int]]:
    """Return which groups are LODs of one character, as numbers of groups; the finest first.

    A group that is one LOD belongs to the finer one whose objects have the same names but for the
    numbers.
    """
    finest = [min(lods) for _, lods in groups]
    families: list[list[int]] = []
    for k in sorted(range(len(groups)), key=lambda k: finest[k]):
        stems = _stems(*groups[k])
        fitting = (
            family
            for family in families
            if finest[k] not in [finest[other] for other in family]
            and stems & _stems(*groups[family[0]])
        )
        home = next(fitting, None) if finest[k] > 0 and len(groups[k][1]) == 1 else None
        if home is None:
            families.append([k])
        else:
            home.append(k)
    return sorted(families)


def _stems(owner: Owner, lods: Numbered) -> set[str]:
    shapes = [item for item in lods[min(lods)] if item.type in GEOMETRY]
    return {label_of(block.name).stem for block in (owner, *shapes)} - {""}
