"""How large the open file, or what a render of it needs, is on disk without a scene's build.

It is written into a temporary folder, and weighed.
"""

from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy

from ...crowd_lod.errors import CrowdError
from ..blender.ownership import OWNED
from .hidden_characters import hides_characters, shows_characters

SCENE = 8_000  # bytes of a scene and its settings, compressed
# of a window, which no other file takes: Blender 4.5 crashes when it writes one to a library
OF_WINDOWS = bpy.types.WindowManager, bpy.types.WorkSpace, bpy.types.Screen


def weigh_file(scene: bpy.types.Scene) -> int:
    """Return the bytes of the open file, compressed, as if `scene` had no build.

    CrowdError if there is no room to write it.
    """
    left_out = _with_users({scene, *_build_blocks(scene.crowd_lod.build)})
    blocks = {block for block in bpy.data.user_map() if not block.library} - left_out
    return _weigh({block for block in blocks if not isinstance(block, OF_WINDOWS)})


def weigh_what_renders(scene: bpy.types.Scene, levels: Iterable[bpy.types.Object]) -> int:
    """Return the bytes of a file of `scene` with the meshes of `levels`, else without its crowd.

    See bake.keep_what_renders. CrowdError if there is no room to write it.
    """
    settings = scene.crowd_lod
    crowd = {item for top in (settings.levels, settings.build) if top for item in top.all_objects}
    if hides_characters(scene) or not shows_characters(scene):
        crowd |= {*settings.characters.all_objects}
    blocks = {item for other in bpy.data.scenes for item in other.objects} - _with_users(crowd)
    blocks |= {item.data for item in levels if item.type == "MESH"}
    blocks |= {scene.world} - {None}
    return _weigh({block for block in blocks if not block.library})


def _weigh(blocks: set[bpy.types.ID]) -> int:
    """Return the bytes of a compressed file of a scene with the `blocks` and what they use."""
    try:
        with TemporaryDirectory(dir=bpy.app.tempdir) as folder:
            path = Path(folder, "weighed.blend")
            bpy.data.libraries.write(str(path), blocks, compress=True)
            return SCENE + path.stat().st_size
    except (OSError, RuntimeError) as error:
        raise CrowdError(
            f"The size of the file is found by writing it to {bpy.app.tempdir}, which failed: make "
            f"room there, or set another folder in Preferences, File Paths, Temporary Files."
        ) from error


def _build_blocks(build: bpy.types.Collection | None) -> set[bpy.types.ID]:
    """Return the blocks that Crowd LOD made for the `build` and that nothing else uses."""
    if build is None:
        return set()
    inside = {build, *(block for block in build.children_recursive if block.get(OWNED))}
    inside |= {item for item in build.all_objects if item.get(OWNED)}
    users = bpy.data.user_map()
    owned = {block for block in users if block.get(OWNED) and users[block]} - inside
    while more := {block for block in owned if users[block] <= inside}:
        inside |= more
        owned -= more
    return inside


def _with_users(blocks: set[bpy.types.ID]) -> set[bpy.types.ID]:
    """Return the `blocks` and all that refers to them, which a file has only along with them."""
    users = bpy.data.user_map()
    reached = set(blocks)
    newest = reached
    while newest := {user for block in newest for user in users.get(block, ())} - reached:
        reached |= newest
    return reached
