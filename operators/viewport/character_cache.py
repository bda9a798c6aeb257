"""The baked characters of each scene, kept for the overlay.

They are baked outside drawing, and again when their sources have changed.
"""

import time as clock
import traceback
import zlib
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from functools import partial

import bpy
import numpy as np

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.progress import Workload
from ..blender import scene_cache, sidebars
from ..blender.callbacks import guard
from ..blender.colors import Looks
from ..blender.image_data import LOOK_AGAIN
from ..blender.provenance import text_digest, unedited
from ..blender.steps import at_work
from ..scene.characters.character_provenance import character_inputs, is_known
from ..scene.characters.characters import GROUP
from ..scene.machine.scene_world import actions_named
from .skinned_characters import SkinnedCharacter, bake_character


@dataclass
class ReadCharacters:
    """A scene's characters, read or being read.

    key: digest of everything they are baked from.
    painted: checksum of the pixels of their images.
    looked: time in seconds when key and painted were last compared.
    characters: those baked so far.
    baking: the generator that bakes the next character, or None.
    work: on all characters; progress: of it, 0 to 1.
    ready: whether baking has ended, also after an error.
    notes: sentences for the user.
    """

    key: str
    painted: int
    looked: float
    characters: tuple[SkinnedCharacter, ...] = ()
    baking: Generator[float, None, SkinnedCharacter] | None = None
    work: Workload = field(default_factory=Workload)
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
_read: dict[int, ReadCharacters] = scene_cache.add_cache({}, by_scene=True)


def has_characters(scene: bpy.types.Scene) -> bool:
    """Return whether the scene has LOD meshes to read characters of."""
    levels = scene.crowd_lod.levels
    return levels is not None and bool(levels.children) and bool(levels.children[0].children)


def read_characters_of(scene: bpy.types.Scene) -> ReadCharacters | None:
    """Return the characters of the scene's LOD meshes, or None without LOD meshes.

    None as well in a file just opened, until its characters are known. If they are not baked yet, a
    timer starts to bake them.
    """
    if not has_characters(scene):
        _read.pop(scene.session_uid, None)
        return None
    read = _read.get(scene.session_uid)
    now = clock.monotonic()
    if read is None or now > read.looked + LOOK_AGAIN:
        if not is_known(scene):
            return read
        key, appearance = cache_key(scene)
        # reading pixels takes milliseconds
        reads_images = read is None or scene.crowd_lod.overlay_color == "MATERIAL"
        painted = _painted(appearance.sources) if reads_images else read.painted
        if read is None or (read.key, read.painted) != (key, painted):
            read = _read[scene.session_uid] = ReadCharacters(key, painted, now)
        read.looked = now
    if not read.ready and not bpy.app.timers.is_registered(bake_some):
        bpy.app.timers.register(bake_some)
    return read


def read(scene: bpy.types.Scene) -> Iterator[float]:
    """Bake the characters of the scene's LOD meshes now; yield the progress, 0 to 1.

    Call it outside drawing.
    """
    key, looks = cache_key(scene)
    read = _read[scene.session_uid] = ReadCharacters(
        key, _painted(looks.sources), clock.monotonic()
    )
    while not read.ready:
        _bake_on(scene, read)
        yield read.progress


def drop(scene: bpy.types.Scene) -> None:
    """Drop the scene's baked characters."""
    _read.pop(scene.session_uid, None)


@guard
def bake_some() -> float | None:
    """Timer: bake a few frames.

    Baking adds and removes data-blocks, which must not be done while Blender draws. It waits for
    the end of a step that is at work.
    """
    if at_work():
        return WAIT
    for scene in bpy.data.scenes:
        read = _read.get(scene.session_uid)
        if read is not None and not read.ready:
            try:
                for group in scene.crowd_lod.groups:
                    actions_named(scene, group.name)
            except CrowdError:
                # The state machine has an error, which the overlay shows. Once it is mended, the
                # next drawing starts this timer again.
                continue
            _evaluate_windows()
            with unedited():  # else the sidebar would look at no change until all is baked
                _bake_on(scene, read)
                _evaluate_windows()
            sidebars.redraw_viewports()
            return 0.0
    return None


def _evaluate_windows() -> None:
    """Have Blender name now what was edited in the scenes that windows show."""
    for window in bpy.context.window_manager.windows:
        window.view_layer.update()


def _bake_on(scene: bpy.types.Scene, read: ReadCharacters) -> None:
    """Bake some frames of the next character."""
    levels = scene.crowd_lod.levels
    counts = set() if levels is None else {len(level.children) for level in levels.children}
    number = len(read.characters)
    of = max(counts, default=0)
    if len(counts) != 1 or number >= of:  # the user has put collections in, or taken them out
        read.characters = ()
        read.ready = True
        return
    groups = scene.crowd_lod.groups
    home = levels.children[0].children[number]
    name = home.get(GROUP) or (groups[number].name if number < len(groups) else home.name)
    try:
        find = partial(_homes, scene.session_uid, number)
        if read.baking is None:
            read.work.announce(of - number)
            baking = bake_character(name, find, actions_named(scene, name))
            read.baking = read.work.take(baking, 1)
        read.progress = next(read.baking)
    except StopIteration as end:
        read.characters += (end.value,)
        read.notes += (end.value.note,) if end.value.note else ()
        read.baking = None
        read.ready = number + 1 == of
    except (
        CrowdError
    ) as error:  # what the user can mend, such as a state that names no action of the file
        read.give_up(str(error))
    except Exception as error:
        traceback.print_exc()
        read.give_up(
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


def cache_key(scene: bpy.types.Scene) -> tuple[str, Looks]:
    """Return (digest of the characters' sources, looks of their materials).

    The pixels of the looks' images are left out.
    """
    appearance = Looks()
    facts: list[object] = sorted(character_inputs(scene).items())
    for home in (home for level in scene.crowd_lod.levels.children for home in level.children):
        appearance.ramp = None
        facts.append((home.session_uid, home.get(GROUP)))
        for item in home.all_objects:
            if item.type == "MESH":
                materials = [appearance.of(slot.material) for slot in item.material_slots]
                facts.append((item.session_uid, item.data.session_uid, item.mode, materials))
        facts.append(repr(appearance.ramp))
    return text_digest(facts), appearance


def _painted(images: list[bpy.types.Image]) -> int:
    """Return a checksum of the images' pixels."""
    total = 0
    for image in images:
        values = np.empty(len(image.pixels), np.float32)
        image.pixels.foreach_get(values)
        total = zlib.crc32(values, total)
    return total
