"""The new file that tests start in."""

import bpy


def open_empty_file() -> None:
    """Open a new file. LODs are by distance: making those by tolerance takes longer.

    Previews leave out the pictures of LODs: test_lod_table.py alone looks at them.
    """
    # The first brings a new window manager. The old one has all that was to be drawn in a window,
    # and Blender looks through it whenever something is removed: soon a third of the tests' time.
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    settings = bpy.context.scene.crowd_lod
    settings.choice = "BY_DISTANCE"
