"""What something was made of: digests of named inputs, kept with what was made.

A digest is of content. No data-block's name is in it: renaming is no edit.
docs/notes/files.md says what is read, when, and what that costs.
"""

import hashlib
import json
import zlib
from collections.abc import Callable, Container, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial

import bpy
import numpy as np

from ...crowd_lod.progress import finished
from . import mesh_data, scene_cache, scene_data
from .animation import curves_and_drivers, players_of
from .guard import handler
from .references import blocks_of
from .rig_dependencies import (
    Called,
    moved_values,
    moves_whole,
    read_columns,
    settings_of,
    setup_of,
    shape_of,
    stance,
)

MOST_WEIGHED = 20_000  # vertices of a mesh whose weights are read, evenly
WEIGHED_AT_ONCE = 2_000  # of them, between two yields
NAMED = 3  # inputs that a sentence names; it counts the others
# Data-blocks whose content is read, so that names do not count; the palette tells materials apart.
READ = bpy.types.Material | bpy.types.Action | bpy.types.Mesh | bpy.types.Armature | bpy.types.Key


@dataclass
class _Known:
    """A digest, which holds while its print is the same and none of its blocks was edited."""

    digest: str
    print: object
    blocks: frozenset[int]


_known: dict[tuple, _Known] = scene_cache.add_cache({})
changes = 0  # that Blender has reported so far, undo steps included


def differences(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Return the names of the inputs that differ, those of `now` first."""
    return [name for name in {**now, **before} if before.get(name) != now.get(name)]


def name_inputs(names: Sequence[str]) -> str:
    """Return the names of inputs in words, such as "the camera and LOD 1 of adult"."""
    listed = (
        list(names) if len(names) <= NAMED + 1 else [*names[:NAMED], f"{len(names) - NAMED} more"]
    )
    return " and ".join(filter(None, [", ".join(listed[:-1]), listed[-1]])) if listed else ""


def keep(holder: bpy.types.ID, key: str, inputs: Mapping[str, str]) -> None:
    """Keep with what was made, in a custom property, what it was made of."""
    holder[key] = json.dumps(inputs)


def read_inputs(holder: bpy.types.ID, key: str) -> dict[str, str]:
    """Return what `keep` has kept there; nothing if a script has put anything else there."""
    with suppress(TypeError, ValueError):
        return dict(json.loads(holder.get(key, "{}")))
    return {}


def is_made_of(holder: bpy.types.ID, key: str, inputs: Mapping[str, str]) -> bool:
    """Return whether `keep` has kept just these inputs there."""
    return read_inputs(holder, key) == inputs


def character_digest(
    objects: Sequence[bpy.types.Object], actions: Callable[[], list] = list
) -> str:
    """Return the digest of a character: shapes, weights, places of materials, rig, animation.

    It is the same in all frames.

    actions: returns what else it plays, to compare as text.
    """

    def read(_) -> list:
        items = sorted(objects, key=object_digest)
        palette = palette_of(items)
        materials = [[palette[slot.material] for slot in item.material_slots] for item in items]
        return [*map(object_digest, items), materials, character_motion(objects, actions)]

    return _digest_of("character", objects, read, partial(blocks_of, look=False))


def character_motion(
    objects: Sequence[bpy.types.Object], actions: Callable[[], list] = list
) -> str:
    """Return the digest of how a character is set up and moves: rig, pose, modifiers, animation.

    Its own shapes are left out. It is the same in all frames.

    actions: as for character_digest.
    """

    def read(blocks: Sequence[bpy.types.ID]) -> list:
        movers = [block for block in blocks if isinstance(block, bpy.types.Object)]
        shapes = {mover.data for mover in movers}

        def place(mover: bpy.types.Object) -> tuple[str, str]:
            """Return by what objects are sorted: a shape counts only among those alike."""
            return object_digest(mover, shapes), object_digest(mover)

        order = {mover: f"object {k:04}" for k, mover in enumerate(sorted(movers, key=place))}
        called = partial(_stand_in, order=order)
        return [stance(*objects, called=called, blocks=blocks), actions()]

    return _digest_of("motion", objects, read, partial(blocks_of, look=False))


def motion_digest(items: Sequence[bpy.types.Object]) -> str:
    """Return the digest of how objects such as cameras move, and of their data's settings.

    It is the same in all frames.
    """
    data = [
        # a camera's angles follow its lens, which may be animated
        [
            fact
            for fact in settings_of(item.data, moved_values(item), (), _nameless)
            if "angle" not in str(fact)
        ]
        for item in items
        if item.data
    ]
    return text_digest(*(stance(item, called=_nameless) for item in items), data)


def level_digest(home: bpy.types.Collection, characters: Sequence[bpy.types.Object]) -> str:
    """Return the digest of a LOD: shapes, places, modifiers, weights, places of materials, and
    what moves its objects themselves.

    Materials are told by their number among those of the character.

    home: the LOD's collection.
    characters: the objects that it was made of. Meshes that the LOD shares with them are theirs.
    """
    palette = palette_of(characters)
    shared = {item.data for item in characters}

    def read(_) -> list:
        objects = []
        for item in home.objects:
            materials = [slot.material for slot in item.material_slots]
            numbers = [
                palette.get(material, material and material.name_full) for material in materials
            ]
            motion = text_digest(setup_of(item, called=_nameless))
            objects.append((object_digest(item, shared), numbers, motion))
        return sorted(objects, key=repr)

    return text_digest(
        _digest_of("LOD", [*home.objects], read, list, *map(_uid, palette)),
        tuple(home.instance_offset),
    )


def text_digest(*values) -> str:
    """Return a SHA-256 hash of the printed form of `values`."""
    return hashlib.sha256(repr(values).encode()).hexdigest()


def palette_of(items: Sequence[bpy.types.Object]) -> dict[bpy.types.Material | None, int]:
    """Return the number of each material of the objects: the place where it is first used."""
    materials = dict.fromkeys(slot.material for item in items for slot in item.material_slots)
    return {material: number for number, material in enumerate(materials)}


def _uid(block: bpy.types.ID | None) -> int:
    return block.session_uid if block is not None else 0


def _stand_in(block: bpy.types.ID | None, order: Mapping[bpy.types.ID, str]) -> str:
    """Return what stands for a data-block in a digest, in place of its name."""
    if block is None or isinstance(block, READ):
        return ""
    return order.get(block, "another") if isinstance(block, bpy.types.Object) else block.name_full


def _nameless(block: bpy.types.ID | None) -> str:
    return _stand_in(block, {})


def _digest_of(
    kind: str,
    items: Sequence[bpy.types.Object],
    read: Callable[[Sequence[bpy.types.ID]], list],
    follow: Callable[[Sequence[bpy.types.Object]], Sequence[bpy.types.ID]],
    *more,
) -> str:
    """Return the digest of what `read` returns; the known one where nothing has changed.

    kind: of digest, of which the items have several.
    follow: items -> all data-blocks that are read, which `read` gets.
    more: what else the digest depends on.
    """
    key = kind, *(item.session_uid for item in items)
    stamp = ([_print(item) for item in items], more)
    latest = _known.get(key)
    if latest is None or latest.print != stamp:
        blocks = follow(items)
        latest = _known[key] = _Known(text_digest(read(blocks)), stamp, frozenset(_uids(blocks)))
    return latest.digest


def _uids(blocks: Sequence[bpy.types.ID]) -> Iterator[int]:
    """Yield the session_uids of data-blocks, and of what is in those of them that are objects."""
    items = [block for block in blocks if isinstance(block, bpy.types.Object)]
    inside = [
        block for item in items for block in (item.data, getattr(item.data, "shape_keys", None))
    ]
    yield from {
        block.session_uid
        for block in (*blocks, *inside, *(player.action for player in players_of(items)))
        if block
    }


def _print(item: bpy.types.Object) -> tuple:
    """Return what changes with most edits that Blender does not report; it is quick to read."""
    slots = [_uid(slot.material) for slot in item.material_slots]
    modifiers = [
        (modifier.type, modifier.show_render, modifier.show_viewport) for modifier in item.modifiers
    ]
    return _place(item), _uid(item.data), modifiers, nodes_inputs(item), slots, _points(item.data)


def _points(data: bpy.types.ID | None) -> tuple:
    if not isinstance(data, bpy.types.Mesh) or data.is_editmode:
        return ()
    points = np.empty(3 * len(data.vertices), np.float32)
    data.vertices.foreach_get("co", points)
    return len(data.loops), zlib.crc32(points)


def _place(item: bpy.types.Object) -> list[float]:
    """Return where the object stands, unless that is animated."""
    if any(map(moves_whole, curves_and_drivers(item.animation_data))):
        return []
    return np.array([*item.matrix_basis, *item.matrix_parent_inverse]).ravel().tolist()


def object_digest(item: bpy.types.Object, shared: Container[bpy.types.ID] = ()) -> str:
    """Return the digest of the object itself, without its materials and what moves it.

    shared: data that does not count.
    """
    data = "" if item.data in shared else read_shape(item)
    moved = moved_values(item)
    modifiers = [
        (modifier.show_render, modifier.show_viewport, settings_of(modifier, moved, (), _nameless))
        for modifier in item.modifiers
    ]
    groups = [group.name for group in getattr(item, "vertex_groups", ())]
    return text_digest(
        item.type,
        _place(item),
        item.parent_bone,
        modifiers,
        nodes_inputs(item),
        groups,
        data,
    )


def nodes_inputs(item: bpy.types.Object, called: Called = _nameless) -> list[tuple[str, str]]:
    """Return (RNA path, value as text) of each input of Nodes modifiers that nothing animates.

    called: returns what stands for a data-block.
    """
    modifiers = [modifier for modifier in item.modifiers if modifier.type == "NODES"]
    values = {
        m.path_from_id() + path: value
        for m in modifiers
        for path, value in scene_data.node_inputs(m).items()
    }
    moved = (
        {curve.data_path for curve in curves_and_drivers(item.animation_data)} if values else set()
    )
    texts = {
        path: called(value) if isinstance(value, bpy.types.ID) else repr(value)
        for path, value in values.items()
    }
    return sorted((path, text) for path, text in texts.items() if path not in moved)


def read_shape(item: bpy.types.Object) -> str:
    """Return the digest of the object's data; the known one while it has not changed."""
    return finished(reading_shape(item))


def reading_shape(item: bpy.types.Object) -> Generator[float, None, str]:
    """Read the object's data: yield between parts, return its digest as `read_shape` does."""
    data = item.data
    weighted = bool(len(getattr(item, "vertex_groups", ())))
    if data is None:
        return ""
    key = (data.session_uid, weighted)
    stamp = _points(data)
    latest = _known.get(key)
    if latest is None or latest.print != stamp:
        keys = getattr(data, "shape_keys", None)
        blocks = frozenset(block.session_uid for block in (data, keys) if block is not None)
        digest = yield from _reading_data(data, weighted)
        latest = _known[key] = _Known(digest, stamp, blocks)
    return latest.digest


def _reading_data(data: bpy.types.ID, weighted: bool) -> Generator[float, None, str]:
    """Read an object's data: yield between parts, return the digest.

    Of a mesh: attributes, faces, shape keys, weights. Of other data: settings and points.
    """
    hashed = hashlib.sha256()
    for attribute in getattr(data, "attributes", ()):
        if attribute.data_type in mesh_data.ATTRIBUTES and (
            attribute.name[0] != "." or attribute.name == ".corner_vert"
        ):
            name, width, kind = mesh_data.ATTRIBUTES[attribute.data_type]
            hashed.update(f"{attribute.name} {attribute.domain}".encode())
            hashed.update(read_columns(attribute.data, [(name, width, kind)])[0])
    if isinstance(data, bpy.types.Mesh):
        hashed.update(read_columns(data.polygons, [("loop_start", 1, "i4")])[0])
        if weighted:
            yield from _add_weights(hashed, data)
    else:
        hashed.update(repr([settings_of(data, called=_nameless), *shape_of(data)]).encode())
    keys = getattr(data, "shape_keys", None)
    for key in keys.key_blocks if keys is not None else ():
        placed = isinstance(data, bpy.types.Mesh | bpy.types.Lattice)
        hashed.update(
            repr((key.name, placed and read_columns(key.data, [("co", 3, "f4")]))).encode()
        )
    return hashed.hexdigest()


def _add_weights(hashed: "hashlib._Hash", mesh: bpy.types.Mesh) -> Iterator[float]:
    """Add the weights of at most MOST_WEIGHED vertices, evenly chosen; yield between parts.

    Python takes 10 microseconds to read a vertex.
    """
    vertices = mesh.vertices
    count = len(mesh.vertices)
    sample = range(0, count, -(-count // MOST_WEIGHED) or 1)
    for begin in range(0, len(sample), WEIGHED_AT_ONCE):
        table = [
            number
            for k in sample[begin : begin + WEIGHED_AT_ONCE]
            for entry in vertices[k].groups
            for number in (k, entry.group, entry.weight)
        ]
        hashed.update(np.array(table, np.float64).tobytes())
        yield 0.0


def look_afresh() -> None:
    """Read everything again when it is next asked for.

    So changes count that a script made without a word to Blender.
    """
    global changes
    changes += 1
    _known.clear()


@contextmanager
def unedited() -> Iterator[None]:
    """Keep all digests, because nothing that is read is edited inside.

    Blender names what is hidden, or linked to another collection, as it does what is edited.
    """
    global changes
    known = dict(_known)
    changes_before = changes
    try:
        yield
    finally:
        _known.clear()
        _known.update(known)
        changes = changes_before


@handler
def note_edits(_, depsgraph: bpy.types.Depsgraph) -> None:
    """Drop the digests of what was edited (depsgraph_update_post)."""
    blocks = [update.id.original for update in depsgraph.updates]
    if any(isinstance(block, bpy.types.Action) for block in blocks):  # whoever plays it
        look_afresh()
    _drop({block.session_uid for block in blocks})


@handler
def note_edits_of_frame(_, depsgraph: bpy.types.Depsgraph) -> None:
    """Drop the digests of meshes that were edited before the frame changed (frame_change_post).

    Objects and actions are named at each change of the frame.
    """
    _drop(
        {
            update.id.original.session_uid
            for update in depsgraph.updates
            if isinstance(update.id, bpy.types.Mesh)
        }
    )


@handler
def note_undo(*_) -> None:
    """Drop all digests: Blender does not say what an undo changed (undo_post, redo_post)."""
    look_afresh()


def _drop(edited: set[int]) -> None:
    global changes
    outdated = [key for key, known in _known.items() if not edited.isdisjoint(known.blocks)]
    for key in outdated:
        del _known[key]
    changes += bool(outdated)
