"""Reads and checks values that Crowd LOD stored in a file.

A script, a user or another version may have put anything there.
"""

from collections.abc import Sequence
from operator import attrgetter
from typing import Any

import bpy
from idprop.types import IDPropertyArray, IDPropertyGroup

from ...crowd_lod.errors import CrowdError
from .contents import kind_of

NUMBERS = {"INT": "a whole number", "FLOAT": "a number"}
INF = float("inf")


def read(
    block: bpy.types.ID | IDPropertyGroup,
    key: str,
    kind: type,
    remedy: str,
    counts: Sequence[int] = (),
    bounds=(-INF, INF),
) -> Any:
    """Return the custom property `key` of `block`.

    CrowdError if it is missing or not as asked.

    kind: str, int, float or bool.
    remedy: what the user can do; ends the error message.
    counts: allowed lengths of a list of values; () for a single value.
    bounds: least and greatest number allowed.
    """
    value = block.get(key)
    values = value.to_list() if isinstance(value, IDPropertyArray) else value
    if not counts and _is(values, kind, bounds):
        return values
    if (
        counts
        and isinstance(values, list)
        and len(values) in counts
        and all(_is(each, kind, bounds) for each in values)
    ):
        return values
    kinds = {str: "a text", int: "whole numbers", float: "numbers", bool: "true or false"}[kind]
    many = f", {' or '.join(map(str, counts))} of them" if counts else ""
    raise CrowdError(
        f'The custom property "{key}" of {block.name} is '
        f"{'missing' if value is None else repr(values)}, and must be "
        f"{kinds}{_range(*bounds)}{many}: {remedy}."
    )


def _is(value, kind: type, bounds: tuple[float, float]) -> bool:
    allowed = {float: (int, float), int: int}.get(kind, kind)
    if not isinstance(value, allowed) or isinstance(value, bool) != (kind is bool):
        return False
    return kind in (str, bool) or bounds[0] <= value <= bounds[1]


def _range(least: float, most: float) -> str:
    return (
        f" from {least:g} to {most:g}"
        if most < 1e30
        else f" of at least {least:g}"
        if least > -1e30
        else ""
    )


def check(settings: bpy.types.PropertyGroup, names: Sequence[str] = ()) -> None:
    """Raise CrowdError if a setting has a value that Blender does not allow.

    Such a value is out of range, NaN, not a choice of the enum, or data of a wrong type. What was
    measured of the groups is not checked here: see stored_groups.groups_of.

    names: the settings to check; () for all.
    """
    known = settings.bl_rna.properties
    for setting in [known[name] for name in names] or known[1:]:  # the first is Blender's own
        where = f"The setting {setting.name} of {settings.id_data.name}"
        try:
            value = getattr(settings, setting.identifier)
        except UnicodeDecodeError:
            raise CrowdError(f"{where} holds bytes that are not text: set it again.") from None
        if setting.type == "ENUM" and value not in setting.enum_items:
            raise CrowdError(
                f"{where} has no known value: choose one of "
                f"{', '.join(item.name for item in setting.enum_items)}."
            )
        elif setting.type in NUMBERS:
            bounds = setting.hard_min, setting.hard_max
            for number in value if setting.is_array else (value,):
                if not bounds[0] <= number <= bounds[1]:
                    raise CrowdError(
                        f"{where} is {number:g}: set it to "
                        f"{NUMBERS[setting.type]}{_range(*bounds)}."
                    )
        elif setting.type == "POINTER" and not isinstance(
            value, (type(None), getattr(bpy.types, setting.fixed_type.identifier))
        ):
            raise CrowdError(
                f"{where} is {value!r}: choose one of the kind {setting.fixed_type.name}."
            )


def contents_of(settings: bpy.types.PropertyGroup) -> tuple:
    """Return the values of all properties, those of collections too, and the lines of texts."""
    kind = kind_of(settings.bl_rna)
    return (
        attrgetter(*kind.values, *kind.flags)(settings),
        [tuple(getattr(settings, name)) for name in kind.arrays],
        [_pointed(getattr(settings, name)) for name in kind.pointers],
        [[contents_of(entry) for entry in getattr(settings, name)] for name in kind.collections],
    )


def _pointed(value: bpy.types.ID | None) -> str | int | None:
    return value.as_string() if isinstance(value, bpy.types.Text) else value and value.session_uid
