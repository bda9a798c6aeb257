"""The baked characters of each scene, kept for the overlay.

They are baked outside drawing, and again when their sources have changed.
"""

import hashlib
import time as clock
import traceback
import zlib
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from functools import partial

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ..blender import named_actions, performance, scene_cache
from ..blender.animation import armatures_of, curves_of, players_of
from ..blender.guard import guard
from ..blender.image_data import LOOK_AGAIN
from ..blender.material_colors import Looks
from ..blender.rig_dependencies import KEYS, read_columns
from ..blender.steps import at_work
from ..characters.characters import GROUP
from ..lod_meshes.cast_digest import cast_digest
from ..machine.scene_world import actions_named
from . import redraw
from .skinned_characters import Character, bake_character


@dataclass
class Casting:
    """A scene's characters, baked or being baked.

    key: digest of everything they are baked from.
    painted: checksum of the pixels of their images.
    looked: time in seconds when key and painted were last compared.
    characters: those baked so far.
    baking: the generator that bakes the next character, or None.
    progress: 0 to 1.
    ready: whether baking has ended, also after an error.
    notes: sentences for the user.
    """

    key: bytes
    painted: int
    looked: float
    characters: tuple[Character, ...] = ()
    baking: Generator[float, None, Character] | None = None
    progress: float = 0.0
    ready: bool = False
    notes: tuple[str, ...] = ()

    def give_up(self, why: str) -> None:
        """Bake no more, and show no characters."""
        self.characters = ()
        self.baking = None
        self.ready = True
        self.notes = (why,)


WAIT = 0.2  # seconds until bake_some looks again whether a step is at work
_castings: dict[int, Casting] = scene_cache.add_cache({}, by_scene=True)


def casting_of(scene: bpy.types.Scene) -> Casting | None:
    """Return the characters of the scene's LOD meshes, or None without LOD meshes.

    If they are not baked yet, a timer starts to bake them.
    """
    levels = scene.crowd_lod.levels
    if levels is None or not levels.children or not levels.children[0].children:
        _castings.pop(scene.session_uid, None)
        return None
    casting = _castings.get(scene.session_uid)
    now = clock.monotonic()
    if casting is None or now > casting.looked + LOOK_AGAIN:
        key, appearance = cache_key(scene)
        # reading pixels takes milliseconds
        reads_images = casting is None or scene.crowd_lod.overlay_color == "MATERIAL"
        painted = _painted(appearance.sources) if reads_images else casting.painted
        if casting is None or (casting.key, casting.painted) != (key, painted):
            casting = _castings[scene.session_uid] = Casting(key, painted, now)
        casting.looked = now
    if not casting.ready and not bpy.app.timers.is_registered(bake_some):
        bpy.app.timers.register(bake_some)
    return casting


def read(scene: bpy.types.Scene) -> Iterator[float]:
    """Bake the characters of the scene's LOD meshes now; yield the progress, 0 to 1.

    Call it outside drawing.
    """
    key, looks = cache_key(scene)
    casting = _castings[scene.session_uid] = Casting(
        key, _painted(looks.sources), clock.monotonic()
    )
    while not casting.ready:
        _bake_on(scene, casting)
        yield casting.progress


def drop(scene: bpy.types.Scene) -> None:
    """Drop the scene's baked characters."""
    _castings.pop(scene.session_uid, None)


@guard
def bake_some() -> float | None:
    """Timer: bake a few frames.

    Baking adds and removes data-blocks, which must not be done while Blender draws. It waits for
    the end of a step that is at work.
    """
    if at_work():
        return WAIT
    for scene in bpy.data.scenes:
        casting = _castings.get(scene.session_uid)
        if casting is not None and not casting.ready:
            try:
                for group in scene.crowd_lod.groups:
                    actions_named(scene, group.name)
            except CrowdError:
                # The state machine has an error, which the overlay shows. Once it is mended, the
                # next drawing starts this timer again.
                continue
            _bake_on(scene, casting)
            redraw.viewports()
            return 0.0
    return None


def _bake_on(scene: bpy.types.Scene, casting: Casting) -> None:
    """Bake some frames of the casting's next character."""
    levels = scene.crowd_lod.levels
    counts = set() if levels is None else {len(level.children) for level in levels.children}
    number = len(casting.characters)
    of = max(counts, default=0)
    if len(counts) != 1 or number >= of:  # the user has put collections in, or taken them out
        casting.characters = ()
        casting.ready = True
        return
    groups = scene.crowd_lod.groups
    home = levels.children[0].children[number]
    name = home.get(GROUP) or (groups[number].name if number < len(groups) else home.name)
    try:
        find = partial(_homes, scene.session_uid, number)
        casting.baking = casting.baking or bake_character(name, find, actions_named(scene, name))
        casting.progress = (number + next(casting.baking)) / of
    except StopIteration as end:
        casting.characters += (end.value,)
        casting.notes += (end.value.note,) if end.value.note else ()
        casting.baking = None
        casting.progress = (number + 1) / of
        casting.ready = number + 1 == of
    except (
        CrowdError
    ) as error:  # what the user can mend, such as a state that names no action of the file
        casting.give_up(str(error))
    except Exception as error:
        traceback.print_exc()
        casting.give_up(
            f"The overlay cannot draw the LOD meshes of {name} ({error}): see the console for "
            f"details."
        )


def _homes(scene: int, number: int) -> list[bpy.types.Collection]:
    """Return the collections of a group's LODs.

    scene: the scene's session_uid.
    number: index of the character group.
    """
    levels = next(each for each in bpy.data.scenes if each.session_uid == scene).crowd_lod.levels
    return [level.children[number] for level in levels.children]


def cache_key(scene: bpy.types.Scene) -> tuple[bytes, Looks]:
    """Return (digest of the characters' sources, looks of their materials).

    The pixels of the looks' images are left out. Weights are slow to read: they count as changed
    when an object enters or leaves a painting or edit mode.
    """
    digest = hashlib.sha256()
    appearance = Looks()
    actions_read = set()
    named_read = set()
    homes = [home for level in scene.crowd_lod.levels.children for home in level.children]
    digest.update(cast_digest(item for home in homes for item in home.all_objects).encode())
    for home in homes:
        appearance.ramp = None
        items = [item for item in home.all_objects if item.type == "MESH"]
        digest.update(
            repr((home.session_uid, home.get(GROUP), tuple(home.instance_offset))).encode()
        )
        for item in items:
            materials = [appearance.of(slot.material) for slot in item.material_slots]
            modifiers = [(m.type, m.show_viewport) for m in item.modifiers]
            sizes = len(item.data.vertices), len(item.data.polygons)
            digest.update(
                repr(
                    (
                        item.session_uid,
                        item.data.session_uid,
                        item.mode,
                        sizes,
                        materials,
                        modifiers,
                    )
                ).encode()
            )
            points = np.empty(3 * sizes[0], np.float32)
            item.data.vertices.foreach_get("co", points)
            digest.update(points)
        rigs = armatures_of(items)
        for player in players_of([*items, *rigs]):
            action = player.action, player.action_slot_handle
            if action not in actions_read:
                actions_read.add(action)
                digest.update(
                    repr((action[0].session_uid, action[1], tuple(action[0].frame_range))).encode()
                )
                for curve in curves_of(player):
                    digest.update(b"".join(read_columns(curve.keyframe_points, KEYS)))
        group = home.get(GROUP, home.name)
        names = actions_named(scene, group)
        movers = group, *rigs, *filter(None, (item.data.shape_keys for item in items))
        if names and movers not in named_read:  # LODs that the same rigs move play the same
            named_read.add(movers)
            digest.update(repr(_digest_actions(group, items, names)).encode())
        digest.update(repr(appearance.ramp).encode())
    return digest.digest(), appearance


def _digest_actions(
    group: str, items: list[bpy.types.Object], names: tuple[str, ...]
) -> list | str:
    """Return a value that changes with the actions `names` of the `group`, or the error's text."""
    try:
        return performance.digest(named_actions.performance_of(group, items, names).parts)
    except CrowdError as error:
        return str(error)


def _painted(images: list[bpy.types.Image]) -> int:
    """Return a checksum of the images' pixels."""
    total = 0
    for image in images:
        values = np.empty(len(image.pixels), np.float32)
        image.pixels.foreach_get(values)
        total = zlib.crc32(values, total)
    return total
