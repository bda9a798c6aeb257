"""Context managers that remove data-blocks or restore settings afterwards."""

from collections.abc import Container, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import bpy

from .collection_caches import renew
from .console import quiet
from .unfinished import blocks_now, made_since


@contextmanager
def scratch() -> Iterator[None]:
    """Remove all data-blocks made inside, of any kind, at the end or after an error.

    What the user makes while a step runs stays.
    """
    before = blocks_now()
    try:
        yield
    finally:
        bpy.data.batch_remove(made_since(before))
        renew()  # no collection may remember what is gone


@contextmanager
def all_or_nothing() -> Iterator[None]:
    """Remove all data-blocks made inside if the block raises or is closed early.

    What the user makes while a step runs stays.
    """
    before = blocks_now()
    try:
        yield
    except BaseException:
        bpy.data.batch_remove(made_since(before))
        renew()
        raise


@contextmanager
def removed_on_failure(blocks: Iterable[bpy.types.ID]) -> Iterator[None]:
    """Remove all that `blocks` holds by then if the code inside raises or is closed early."""
    try:
        yield
    except BaseException:
        bpy.data.batch_remove(list(blocks))
        raise


@contextmanager
def restore_settings(
    *owners: bpy.types.bpy_struct, only: Container[str] | None = None
) -> Iterator[None]:
    """Restore the settings of `owners` at the end.

    Restored are each owner's own writable properties, except collections.

    only: names of those to restore; None for all.
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
    try:
        yield
    finally:
        for _ in range(2):  # which values one of them may have depends on others
            for owner, name, value in before:
                if _plain(getattr(owner, name)) != value:
                    with suppress(TypeError):
                        setattr(owner, name, value)


def _plain(value) -> Any:
    return (
        tuple(value)
        if hasattr(value, "__len__") and not isinstance(value, str | set | bpy.types.bpy_struct)
        else value
    )
