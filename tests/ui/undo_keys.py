"""Buttons, Ctrl-Z and Ctrl-Shift-Z in random orders: blender --python undo_keys.py -- FOLDER FIRST_SEED COUNT.

The steps are those of tests/faults/undo_sequences.py. They are taken in a saved file of the plaza that has a build, with
the overlay on, after Render Viewport Image and Preview. A crash ends Blender before results.json is written.
"""

import sys
from pathlib import Path

import bpy

HERE = Path(__file__).parent
sys.path += map(str, (HERE, HERE.parent, HERE.parent / "faults"))
import robot  # noqa: E402
import rough  # noqa: E402
import undo_sequences  # noqa: E402

FOLDER, FIRST, COUNT = sys.argv[sys.argv.index("--") + 1 :]
FOLDER = Path(FOLDER)
AGENTS = 200
results = {"held": []}


class Hands:
    """Presses buttons and keys in the window."""

    def press(self, name: str, properties: dict):
        yield from robot.press(f"crowd_lod.{name}", **properties)
        yield from robot.dismiss()  # the message of what is missing

    def undo(self):
        robot.key("Z", ctrl=True)
        yield from robot.drawn()

    def redo(self):
        robot.key("Z", ctrl=True, shift=True)
        yield from robot.drawn()


def session():
    """Yields the seconds to wait before going on."""
    path = str(FOLDER / "undo.blend")
    yield from saved(path)
    for seed in range(int(FIRST), int(FIRST) + int(COUNT)):
        with robot.over():
            bpy.ops.wm.open_mainfile(filepath=path, load_ui=False)
        yield 1.0
        for button in ("render_viewport", "preview"):
            yield from robot.press(f"crowd_lod.{button}")
        yield from undo_sequences.sequence(seed, Hands())
        results["held"].append(seed)
    yield from robot.picture("30_after_undo")


def saved(path: str):
    """A small plaza with a build, played through its camera, in a file."""
    rough.use(robot.MODULE)
    yield from robot.press("crowd_lod.sample", name="plaza")
    settings = robot.settings()
    settings.count, settings.frames, settings.width, settings.folder = AGENTS, "1,5", 64, str(FOLDER / "undo_preview")
    settings.way, settings.choice = "PRECISE", "BY_RATIO"
    robot.scene().frame_end = 5
    for button in ("populate", "make_levels", "build"):
        yield from robot.press(f"crowd_lod.{button}")
    settings.overlay = True
    bpy.ops.wm.save_as_mainfile(filepath=path)
    yield 1.0


robot.perform(session(), results, FOLDER)
