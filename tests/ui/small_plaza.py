"""A small crowd in a saved file that has all that our buttons need, for undo_keys.py and
panel_states.py.
"""

import bpy
import robot
from undo_sequences import named, quicken

AGENTS = 100
REST = 0.05  # seconds, after each key
worked: set[str] = set()  # the buttons that did their work, or at least began it


def pressed(name: str):
    """Press a button of ours in the window; Esc ends what waits for the mouse, and closes a
    message.
    """
    status = yield from robot.press(
        f"crowd_lod.{name}", escape_after=0.2 if name == "inspect" else None, **named(name)
    )
    if status in ("FINISHED", "MODAL"):
        worked.add(name)
    robot.key("ESC")
    yield from robot.drawn(REST)


def opened(path: str):
    with robot.over():
        bpy.ops.wm.open_mainfile(filepath=path, load_ui=False)
    yield from robot.until(lambda: robot.overlay().latest(robot.scene()), often=REST)


def saved(path: str, folder: str):
    """Save a small plaza with all that our buttons need, whose shot plan and previews are in the
    folder.
    """
    yield from robot.sample("plaza")
    settings = robot.settings()
    settings.count = AGENTS
    settings.choice = "BY_DISTANCE"
    settings.level_count = 2
    settings.agent = 7
    for group in settings.characters.children[2:]:
        settings.characters.children.unlink(group)
    quicken(robot.scene(), folder)
    needed = (
        "add_row",
        "populate",
        "make_levels",
        "override_agent",
        "plan_shot",
        "build",
    )
    for button in needed:
        yield from pressed(button)
    assert settings.shot_plan and settings.build, "a button that prepares the file failed"
    bpy.ops.wm.save_as_mainfile(filepath=path)
    yield from robot.drawn()
