"""What something was made of: digests of named inputs, kept with what was made.

A digest is of content. No data-block's name is in it: renaming is no edit.
docs/notes/files.md says what is read, when, and what that costs.
"""

import hashlib
import json
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import bpy
import numpy as np

from . import scene_cache
from .animation import curves_and_drivers, moves_whole
from .callbacks import handler
from .contents import READ, Content, custom_properties, read_content, still_inputs
from .removal import is_there

MADE_OF = "crowd_lod_made_of"  # custom property of what was made
NAMED = 3  # inputs that a sentence names; it counts the others
# What LODs and the ground follow without being made of it.
OUTSIDE = bpy.types.Object, bpy.types.Collection, bpy.types.NodeTree
Read = Callable[[bpy.types.ID], Content]


@dataclass
class _Known:
    """A content, which holds while its print is the same and none of its blocks was edited."""

    content: Content
    print: object
    blocks: frozenset[int]


_known: dict[int, _Known] = scene_cache.add_cache({})  # by session_uid
_told: dict[tuple, str] = scene_cache.add_cache({})  # see known_digest
changes = 0  # that Blender has reported so far, undo steps included
_listening = True  # whether Blender's reports count, see unedited


def differences(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Return the names of the inputs that differ, those of `now` first."""
    return [name for name in {**now, **before} if before.get(name) != now.get(name)]


def name_inputs(names: Sequence[str]) -> str:
    """Return the names of inputs in words, such as "the camera and LOD 1 of adult"."""
    listed = (
        list(names) if len(names) <= NAMED + 1 else [*names[:NAMED], f"{len(names) - NAMED} more"]
    )
    return " and ".join(filter(None, [", ".join(listed[:-1]), listed[-1]])) if listed else ""


def keep(holder: bpy.types.ID, inputs: Mapping[str, str]) -> None:
    """Keep with what was made, in a custom property, what it was made of."""
    holder[MADE_OF] = json.dumps(inputs)


def read_inputs(holder: bpy.types.ID, key: str = MADE_OF) -> dict[str, str]:
    """Return what `keep` has kept there; nothing if a script has put anything else there."""
    with suppress(TypeError, ValueError):
        return dict(json.loads(holder.get(key, "{}")))
    return {}


def is_made_of(holder: bpy.types.ID, inputs: Mapping[str, str]) -> bool:
    """Return whether `keep` has kept just these inputs there."""
    return read_inputs(holder) == inputs


def content_of(block: bpy.types.ID) -> Content:
    """Return what the data-block holds; the known one while it has not changed."""
    stamp = _print(block)
    known = _known.get(block.session_uid)
    if known is None or known.print != stamp or not all(map(is_there, known.content.others)):
        content = read_content(block)
        uids = frozenset(each.session_uid for each in (block, *content.others))
        known = _known[block.session_uid] = _Known(content, stamp, uids)
    return known.content


def character_digest(objects: Sequence[bpy.types.Object]) -> str:
    """Return the digest of a character: shapes, weights, places of materials, rig, animation.

    It is the same in all frames.
    """
    items = _sorted(objects)
    palette = palette_of(items)
    looks = [
        ([palette[slot.material] for slot in item.material_slots], custom_properties(item))
        for item in items
    ]
    return text_digest(digest_of(items), looks)


def character_motion(objects: Sequence[bpy.types.Object]) -> str:
    """Return the digest of how a character is set up and moves: rig, pose, modifiers, animation.

    Its own shapes are left out. It is the same in all frames.
    """
    return text_digest([row for _, row in _setup_of(_sorted(objects))])


def source_digest(item: bpy.types.Object) -> str:
    """Return the digest of what an object's LODs take over besides its shape, read afresh.

    The objects that it follows are told by name: its LODs follow just these.
    """
    found = _setup_of([item], read_content)
    names = [block.name_full for block, _ in found if isinstance(block, bpy.types.Object)]
    return text_digest([row for _, row in found], names, custom_properties(item))


def _setup_of(
    items: Sequence[bpy.types.Object], read: Read = content_of
) -> list[tuple[bpy.types.ID, tuple]]:
    """Return what `_found` yields of the objects, without their own shapes."""
    shapes = {item.data for item in items if item.type != "ARMATURE"} - {None}
    keys = dict.fromkeys(getattr(item.data, "shape_keys", None) for item in items)
    return [*_found([*items, *filter(None, keys)], shapes, read=read)]


def _sorted(objects: Sequence[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return the objects in an order that follows from what they hold, as far as that differs."""
    return sorted(objects, key=lambda item: content_of(item).digest)


def level_digest(home: bpy.types.Collection, characters: Sequence[bpy.types.Object]) -> str:
    """Return the digest of a LOD: shapes, places, modifiers, weights, places of materials, and
    what moves its objects themselves.

    Materials are told by their number among those of the character.

    home: the LOD's collection.
    characters: the objects that it was made of. Meshes that the LOD shares with them are theirs.
    """
    palette = palette_of(characters)
    shared = {item.data for item in characters}
    objects = []
    for item in home.objects:
        materials = [slot.material for slot in item.material_slots]
        numbers = [palette.get(material, material and material.name_full) for material in materials]
        objects.append((object_digest(item, shared), numbers, custom_properties(item)))
    return text_digest(sorted(objects, key=repr), tuple(home.instance_offset))


def object_digest(
    item: bpy.types.Object, shared: Collection[bpy.types.ID | None] = frozenset()
) -> str:
    """Return the digest of the object and its data, without other objects.

    shared: data that does not count.
    """
    return digest_of([item], shared, OUTSIDE)


def digest_of(
    items: Sequence[bpy.types.ID],
    without: Collection[bpy.types.ID | None] = frozenset(),
    outside: tuple[type, ...] = (),
    read: Read = content_of,
) -> str:
    """Return the digest of data-blocks and of all that they depend on, in the order given.

    Data-blocks are told by their number in the order in which they are found, not by name. It is
    the same in all frames.

    without: what does not count, and what depends on nothing else.
    outside: the kinds of data-blocks that count by their kind alone.
    read: read_content reads afresh; of little, such as cameras.
    """
    return text_digest([row for _, row in _found(items, without, outside, read)])


def _found(
    items: Sequence[bpy.types.ID],
    without: Collection[bpy.types.ID | None] = frozenset(),
    outside: tuple[type, ...] = (),
    read: Read = content_of,
) -> Iterator[tuple[bpy.types.ID, tuple]]:
    """Yield each data-block that digest_of finds, and what it holds and refers to."""
    numbers = {item: number for number, item in enumerate(items)}
    found = list(items)
    for block in found:  # which grows
        content = read(block)
        others = []
        for other in content.others:
            if other in without or (isinstance(other, outside) and other not in numbers):
                is_tree = isinstance(other, bpy.types.NodeTree)
                others.append(other.name_full if is_tree else other.id_type)
            elif other.id_type in READ:
                if other not in numbers:
                    numbers[other] = len(found)
                    found.append(other)
                others.append(numbers[other])
            else:
                others.append(other.name_full)
        yield block, (content.digest, others)


def text_digest(*values) -> str:
    """Return a SHA-256 hash of the printed form of `values`."""
    return hashlib.sha256(repr(values).encode()).hexdigest()


def palette_of(items: Sequence[bpy.types.Object]) -> dict[bpy.types.Material | None, int]:
    """Return the number of each material of the objects: the place where it is first used."""
    materials = dict.fromkeys(slot.material for item in items for slot in item.material_slots)
    return {material: number for number, material in enumerate(materials)}


def known_digest(key: tuple, read: Callable[[], object]) -> str:
    """Return the digest of what `read` returns, the known one of this key until `look_afresh`."""
    if key not in _told:
        _told[key] = text_digest(read())
    return _told[key]


def _print(block: bpy.types.ID) -> tuple:
    """Return what changes with most edits that Blender does not report; it is quick to read."""
    if isinstance(block, bpy.types.Mesh) and not block.is_editmode:
        points = np.empty(3 * len(block.vertices), np.float32)
        block.vertices.foreach_get("co", points)
        return len(block.loops), zlib.crc32(points)
    if isinstance(block, bpy.types.Object):
        modifiers = [(m.type, m.show_render, m.show_viewport) for m in block.modifiers]
        data = block.data and block.data.session_uid
        return _place(block), data, modifiers, repr(still_inputs(block))
    return ()


def _place(item: bpy.types.Object) -> list[float]:
    """Return where the object stands, unless that is animated."""
    if any(map(moves_whole, curves_and_drivers(item.animation_data))):
        return []
    return np.array([*item.matrix_basis, *item.matrix_parent_inverse]).ravel().tolist()


def look_afresh() -> None:
    """Read everything again when it is next asked for.

    So changes count that a script made without a word to Blender.
    """
    global changes
    changes += 1
    _known.clear()
    _told.clear()


@contextmanager
def unedited() -> Iterator[None]:
    """Keep all digests, because nothing that is read is edited inside.

    Blender names what is hidden, or linked to another collection, as it does what is edited.
    """
    global _listening
    _listening = False
    try:
        yield
    finally:
        _listening = True


@handler
def note_edits(_, depsgraph: bpy.types.Depsgraph) -> None:
    """Drop the digests of what was edited (depsgraph_update_post)."""
    blocks = [update.id.original for update in depsgraph.updates]
    if _listening and any(isinstance(block, bpy.types.Action) for block in blocks):
        look_afresh()  # whoever plays it
    _drop(blocks)


@handler
def note_edits_of_frame(_, depsgraph: bpy.types.Depsgraph) -> None:
    """Drop the digests of meshes that were edited before the frame changed (frame_change_post).

    Objects and actions are named at each change of the frame.
    """
    blocks = [update.id.original for update in depsgraph.updates]
    _drop([block for block in blocks if isinstance(block, bpy.types.Mesh)])


@handler
def note_undo(*_) -> None:
    """Drop all digests: Blender does not say what an undo changed (undo_post, redo_post)."""
    look_afresh()


def _drop(blocks: Sequence[bpy.types.ID]) -> None:
    global changes
    edited = {block.session_uid for block in blocks} if _listening else set()
    outdated = [uid for uid, known in _known.items() if not edited.isdisjoint(known.blocks)]
    for uid in outdated:
        del _known[uid]
    changes += bool(outdated)
