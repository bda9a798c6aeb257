"""Props: objects that some agents of a character group have, and the variants that they make."""

from collections.abc import Iterator, Sequence
from itertools import product
from math import prod
from typing import NamedTuple

import bpy

from ...crowd_lod.errors import CrowdError
from . import stored_values
from .character_objects import may_have_faces

# custom property of an object: the chance that an agent has it, and all that is parented to it
PROP = "prop"
JOINT = " + "  # in a variant's name, between the group and its props
MOST_PROPS = 3  # of a group, which are eight variants


class Variant(NamedTuple):
    """A character group with some of its props.

    name: the group's own for that without props.
    objects: with a shape.
    chance: that an agent of the group is this one.
    """

    name: str
    objects: list[bpy.types.Object]
    chance: float


def group_of(name: str) -> str:
    """Return the name of the group that a variant called `name` is of."""
    return name.partition(JOINT)[0]


def variants_of(
    name: str, members: Sequence[bpy.types.Object], shapes: Sequence[bpy.types.Object]
) -> Iterator[Variant]:
    """Yield the variants of the character group `name`, the one without props first.

    members: all of its objects.
    shapes: those that have a shape and are shown.

    CrowdError if a prop cannot be used.
    """
    of = {item: _prop_of(item) for item in shapes}
    chances = {item: _chance(item) for item in members if PROP in item and not item.hide_render}
    for item in chances:
        if _prop_of(item) is item and not any(
            may_have_faces(each) for each, prop in of.items() if prop is item
        ):
            raise CrowdError(
                f"The prop {item.name} of the character group {name} has no mesh with faces: give "
                f"it one, or remove its custom "
                f'property "{PROP}".'
            )
    props = sorted(
        {prop for prop in of.values() if prop is not None and 0 < chances.get(prop, 1) < 1},
        key=_called,
    )
    if len(props) > MOST_PROPS:
        raise CrowdError(
            f"The character group {name} has {len(props)} props "
            f"({', '.join(map(_called, props))}), and {2 ** len(props)} variants "
            f"of it: use at most {MOST_PROPS}, or make it several groups."
        )
    for worn in product((False, True), repeat=len(props)):
        left = {prop for prop, has in zip(props, worn, strict=True) if not has} | {
            prop for prop in chances if not chances[prop]
        }
        objects = [item for item in shapes if of[item] not in left]
        if not any(map(may_have_faces, objects)) and any(map(may_have_faces, shapes)):
            raise CrowdError(
                f"All meshes of the character group {name} are props: leave it one that all its "
                f"agents have."
            )
        with_props = JOINT.join(
            [name, *(_called(prop) for prop, has in zip(props, worn, strict=True) if has)]
        )
        yield Variant(
            with_props,
            objects,
            prod(chances[p] if has else 1 - chances[p] for p, has in zip(props, worn, strict=True)),
        )


def _called(prop: bpy.types.Object) -> str:
    return prop.name


def _prop_of(item: bpy.types.Object) -> bpy.types.Object | None:
    """Return the outermost prop that the object is, or is parented to; None if it is of no prop."""
    prop = None
    while item is not None:
        prop = item if PROP in item else prop
        item = item.parent
    return prop


def _chance(item: bpy.types.Object) -> float:
    remedy = "set the chance that an agent has this prop, or remove it"
    return round(float(stored_values.read(item, PROP, float, remedy, bounds=(0, 1))), 6)
