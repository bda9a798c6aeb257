"""Props: objects that some agents of a character group have."""

import bpy

# custom property of an object: the chance that an agent has it, and all that is parented to it
PROP = "prop"
JOINT = " + "  # in a part's name, between the group and what its agents wear


def group_of(name: str) -> str:
    """Return the name of the group whose agents wear the part called `name`; of a group its own."""
    return name.partition(JOINT)[0]


def prop_of(item: bpy.types.Object | None) -> bpy.types.Object | None:
    """Return the outermost prop that the object is, or is parented to; None if it is of no prop."""
    prop = None
    while item is not None:
        prop = item if PROP in item else prop
        item = item.parent
    return prop
