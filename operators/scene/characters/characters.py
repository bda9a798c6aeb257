"""The character groups of a scene, the parts that their agents wear, and those that glow."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import bpy

from ....crowd_lod.crowd.agents import MOST_GROUPS, Group
from ....crowd_lod.errors import CrowdError
from ....crowd_lod.messages import Message, MessageKind
from ...blender import scene_data
from ...blender.character_objects import WITHOUT_FACES, is_stage, may_have_faces, parts
from ...blender.materials import emits
from ...blender.ownership import OWNED
from ...blender.references import closure_of
from ...settings.crowds import check_stored, crowds_of
from ..machine import scene_world
from .character_place import carriers_of, is_shape, place_of, place_of_members
from .given_lods import CharacterGroup, GivenLod, Owner, label_of, with_given_lods
from .rig_needs import Characters
from .wardrobe import wardrobe_of

# of a character's height: its collection's Instance Offset may be so far from where it stands
BESIDE_OFFSET = 0.1
# custom property of a LOD's collection of one character group: the group's name
GROUP = "crowd_lod_group"


class Character(NamedTuple):
    """A character group, or a part that its agents wear.

    objects: those with a shape.
    origin: world meters.
    variant_of: of a part the group's name, "" for a group.
    chance, slot, excludes: of a part, see wardrobe.Part.
    given_lods: LODs that an artist made of it, the finer ones first.
    """

    name: str
    objects: list[bpy.types.Object]
    origin: tuple[float, float, float]
    variant_of: str = ""
    chance: float = 1.0
    given_lods: tuple[GivenLod, ...] = ()
    slot: str = ""
    excludes: tuple[str, ...] = ()


def characters_of(
    scene: bpy.types.Scene,
) -> list[tuple[str, list[bpy.types.Object], tuple[float, float, float]]]:
    """Return (name, objects, origin) of each of `all_characters`."""
    return [character[:3] for character in all_characters(scene)]


def all_characters(scene: bpy.types.Scene) -> list[Character]:
    """Return the character groups of `scene`, sorted by name, each with its parts.

    A group is a child collection of the characters' collection, or one of its objects with all that
    is parented to it. What is_stage is left out. CrowdError if there is no usable group.
    """
    check_stored(scene.crowd_lod)
    top = scene.crowd_lod.characters
    if top is None:
        raise CrowdError(
            f"The scene {scene.name} has no characters: choose a collection in the Crowd panel "
            f"whose children are the characters."
        )
    groups = sorted(groups_in(scene, top), key=lambda group: group.owner.name.casefold())
    if not groups:
        state = "holds lamps, cameras and empties alone" if top.all_objects else "is empty"
        raise CrowdError(
            f"The collection {top.name} {state}: put the characters in it, one child collection "
            f"or object each."
        )
    members = []
    for group in groups:
        members += _family(top, group)
    names = [character.name for character in members]
    for name in names:
        if names.count(name) > 1:
            raise CrowdError(
                f"Two character groups in {top.name} are called {name}: rename one of them."
            )
    if len(members) > MOST_GROUPS:
        raise CrowdError(
            f"The collection {top.name} holds {len(members)} character groups; use at most "
            f"{MOST_GROUPS}."
        )
    return members


def _family(top: bpy.types.Collection, group: CharacterGroup) -> Iterator[Character]:
    """Yield a character group in `top`, then the parts that its agents wear."""
    owner = group.owner
    shapes = parts(owner, group.members)
    if not any(map(may_have_faces, shapes)):
        raise CrowdError(
            f"The character group {owner.name} in {top.name} holds no mesh with faces: give it "
            f"one, or take it out."
        )
    body, wardrobe = wardrobe_of(owner, group.members, shapes)
    lods = [GivenLod(parts(owner, lod.objects), lod.offset) for lod in group.lods]
    worn = [item for item in shapes if item not in body]
    of_body = _lods_of(lods, lambda item: item not in worn and _stem(item) not in _stems(worn))
    yield Character(owner.name, body, group.origin, given_lods=of_body)
    for part in wardrobe:
        of_part = _lods_of(
            lods, lambda item, worn=part.objects: item not in worn and _stem(item) in _stems(worn)
        )
        yield Character(
            part.name,
            part.objects,
            group.origin,
            owner.name,
            part.chance,
            of_part,
            part.slot,
            part.excludes,
        )


def _lods_of(
    lods: Sequence[GivenLod], belongs: Callable[[bpy.types.Object], bool]
) -> tuple[GivenLod, ...]:
    """Return the given LODs with those of their objects that belong to a body, or to a part."""
    given = [lod._replace(objects=list(filter(belongs, lod.objects))) for lod in lods]
    return tuple(lod for lod in given if lod.objects_with_faces())


def _stem(item: bpy.types.Object) -> str:
    return label_of(item.name).stem


def _stems(objects: Sequence[bpy.types.Object]) -> set[str]:
    """Return the names of objects without the numbers of their LODs."""
    return set(map(_stem, objects))


def groups_in(scene: bpy.types.Scene, top: bpy.types.Collection) -> list[CharacterGroup]:
    """Return the groups in the characters' collection `top`."""
    return with_given_lods(list(_groups_as_they_lie(scene, top)))


def _groups_as_they_lie(
    scene: bpy.types.Scene, top: bpy.types.Collection
) -> Iterator[tuple[Owner, list[bpy.types.Object], tuple]]:
    """Yield (owner, objects, origin) of each child of `top`; LODs of one may be several."""
    ground = scene_world.grounds_of(crowds_of(scene.crowd_lod))
    for child in top.children:
        if not is_stage(child.all_objects) and not ground.issuperset(child.all_objects[:] or [top]):
            members = list(child.all_objects)
            yield child, members, _origin_of(child, members)
    own = set(top.objects)
    for root in top.objects:
        if own.isdisjoint(carriers_of(root)):
            # LODs hang on the same armature
            below = (item for item in root.children_recursive if not item.get(OWNED))
            carried = (item for item in top.objects if root in carriers_of(item))
            members = list(dict.fromkeys([root, *below, *carried]))
            if not is_stage(members) and root not in ground:
                yield root, members, tuple(place_of(root, filter(is_shape, members)))


def _origin_of(home: bpy.types.Collection, members: Sequence[bpy.types.Object]) -> tuple:
    """Return where the character in a collection stands, at the height of its Instance Offset."""
    place = place_of_members(members)
    return tuple(home.instance_offset) if place is None else (*place.xy, home.instance_offset.z)


def notes_on_places(scene: bpy.types.Scene, groups: Sequence[Group]) -> Iterator[Message]:
    """Yield messages on collections whose Instance Offset is not where their character stands.

    groups: as just measured.
    """
    height = {group.name: group.height for group in groups}
    for owner, _, origin, _ in groups_in(scene, scene.crowd_lod.characters):
        if isinstance(owner, bpy.types.Collection):
            beside = math.dist(owner.instance_offset, origin)
            if beside > BESIDE_OFFSET * height[owner.name]:
                facts = {"beside": float(beside * scene_data.meters(scene))}
                yield Message(MessageKind.BESIDE_OFFSET, owner.name, facts)


def notes_on_left_out(scene: bpy.types.Scene) -> Iterator[Message]:
    """Yield messages on what renders show of the characters and no crowd does, because it has no
    faces.
    """
    members = [
        item for group in groups_in(scene, scene.crowd_lod.characters) for item in group.members
    ]
    for item in sorted(members, key=lambda item: item.name):
        if item.type in WITHOUT_FACES and not item.hide_render:
            what = WITHOUT_FACES[item.type]
            yield Message(MessageKind.WITHOUT_FACES, item.name, {"what": what})


def notes_on_unsaved(characters: Characters) -> Iterator[Message]:
    """Yield messages on objects that the characters are made of and that Blender drops when it
    saves the file.
    """
    shapes = [item for _, objects, _ in characters for item in objects]
    for item in sorted(closure_of(shapes), key=lambda item: item.name):
        if not item.users and item.library is None:
            yield Message(MessageKind.UNSAVED, item.name)


def check_measured(members: Sequence[tuple], groups: Sequence[Group]) -> None:
    """Raise CrowdError if `members`, the scene's characters, are not the measured groups."""
    if [each[0] for each in members] != [group.name for group in groups]:
        raise CrowdError(
            "The character groups, their props or slots have changed: press Populate, then Make "
            "LOD Meshes."
        )


# rays that meet light
LIT_BY = (
    "visible_diffuse",
    "visible_glossy",
    "visible_transmission",
    "visible_volume_scatter",
)


def glowing(scene: bpy.types.Scene) -> dict[str, list[bpy.types.Material]]:
    """Return the materials that light others, of each character group that wears any."""
    lights_by_group = {}
    for name, objects, _ in characters_of(scene):
        worn = {
            slot.material
            for item in objects
            if any(getattr(item, ray) for ray in LIT_BY)
            for slot in item.material_slots
        }
        lights = [material for material in worn - {None} if emits(material.node_tree)]
        if lights:
            lights_by_group[name] = sorted(lights, key=lambda material: material.name_full)
    return lights_by_group


def notes_on_glow(scene: bpy.types.Scene) -> Iterator[Message]:
    """Yield messages on characters whose materials light others."""
    for name, materials in glowing(scene).items():
        facts = {"material": materials[0].name, "stays": scene.crowd_lod.shadows}
        yield Message(MessageKind.GLOWS, name, facts)
