"""A context manager that restores settings afterwards."""

from collections.abc import Container, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import bpy

from .console import quiet
from .removal import is_there


@contextmanager
def restore_settings(
    *owners: bpy.types.bpy_struct, only: Container[str] | None = None
) -> Iterator[None]:
    """Restore the settings of `owners` at the end.

    Restored are each owner's own writable properties, except collections.

    only: names of those to restore; None for all.

    Those of a data-block that is gone by then are left out: to read them would crash Blender.
    """
    with quiet():  # asked for its device, Cycles looks for all that there are, and says so
        pointers = ((owner, prop) for owner in owners for prop in owner.bl_rna.properties)
        names = [
            (owner, prop.identifier)
            for owner, prop in pointers
            if not prop.is_readonly
            and prop.type != "COLLECTION"
            and (only is None or prop.identifier in only)
        ]
        before = [(owner, name, _plain(getattr(owner, name))) for owner, name in names]
        blocks = [owner.id_data for owner, _ in names]
    try:
        yield
    finally:
        for _ in range(2):  # which values one of them may have depends on others
            for block, (owner, name, value) in zip(blocks, before, strict=True):
                if is_there(block) and _plain(getattr(owner, name)) != value:
                    with suppress(TypeError):
                        setattr(owner, name, value)


def _plain(value) -> Any:
    return (
        tuple(value)
        if hasattr(value, "__len__") and not isinstance(value, str | set | bpy.types.bpy_struct)
        else value
    )
