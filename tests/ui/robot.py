"""Eyes and hands of session.py: presses buttons and keys in Blender's window, takes pictures,
compares.
"""

import faulthandler
import gc
import json
import os
import shutil
import subprocess
import sys
import time
import traceback
from contextlib import contextmanager
from pathlib import Path

import bpy
from support.coarse_characters import coarsen

MODULE = "bl_ext.user_default.crowd_lod"
PATIENCE = 900.0  # seconds until a button's work counts as hung, on a machine with much else to do
KINDS = (
    "actions armatures cameras collections images lights materials meshes node_groups objects "
    "scenes texts worlds"
).split()
pictures = []
# one for each drawing of a viewport's header: the last of it, also where overlays are hidden
_draws = []


class Counted:
    """How many draw handlers are in the viewport; Blender does not tell."""

    def __init__(self):
        self.count = 0
        space = bpy.types.SpaceView3D
        add = space.draw_handler_add
        remove = space.draw_handler_remove

        def counted_add(*arguments):
            self.count += 1
            return add(*arguments)

        def counted_remove(*arguments):
            remove(*arguments)
            self.count -= 1

        space.draw_handler_add = counted_add
        space.draw_handler_remove = counted_remove


def start(folder):
    global draw_handlers, _folder
    faulthandler.enable()
    _folder = folder
    bpy.context.preferences.view.show_splash = False
    # software OpenGL draws sixteen samples a pixel otherwise
    bpy.context.preferences.system.viewport_aa = "OFF"
    bpy.ops.preferences.addon_disable(module=MODULE)
    bpy.types.SpaceView3D.draw_handler_add(lambda: _draws.append(1), (), "HEADER", "POST_PIXEL")
    draw_handlers = Counted()
    bpy.ops.preferences.addon_enable(module=MODULE)


def perform(steps, results: dict, folder: Path):
    """Take the `steps`, each after the seconds that the one before yields.

    Then write `results` to the folder, and quit.
    """

    def tick():
        try:
            return next(steps)
        except StopIteration:
            pass
        except BaseException:
            results["traceback"] = traceback.format_exc()
        results["pictures"] = pictures
        (folder / "results.json").write_text(json.dumps(results, indent=1), encoding="utf-8")
        bpy.ops.wm.quit_blender()

    start(folder)
    bpy.app.timers.register(tick, first_interval=1.0, persistent=True)


def windows() -> list[bpy.types.Window]:
    return [*bpy.context.window_manager.windows]


def window() -> bpy.types.Window:
    return windows()[0]


def scene() -> bpy.types.Scene:
    return window().scene


def settings():
    return scene().crowd_lod


def overlay():
    """The extension's module."""
    return sys.modules[f"{MODULE}.operators.viewport.viewport_overlay"]


def display():
    """The module that makes what a viewport shows."""
    return sys.modules[f"{MODULE}.operators.viewport.display"]


def count_displays() -> int:
    """Count the scenes whose display is kept in memory."""
    gc.collect()
    return sum(isinstance(thing, display().Display) for thing in gc.get_objects())


def window_of(image) -> bpy.types.Window | None:
    """The window that shows the image, or None."""
    editors = (
        (w, area.spaces.active)
        for w in bpy.context.window_manager.windows
        for area in w.screen.areas
    )
    return next(
        (w for w, space in editors if space.type == "IMAGE_EDITOR" and space.image == image), None
    )


def close_window_of(image):
    """Wait until a window shows the image, and close it."""
    yield from until(lambda: window_of(image))
    with bpy.context.temp_override(window=window_of(image)):
        bpy.ops.wm.window_close()
    yield 0.5


def view_3d() -> bpy.types.Area:
    return next(area for area in window().screen.areas if area.type == "VIEW_3D")


def sidebar(area) -> bpy.types.Region:
    return next(region for region in area.regions if region.type == "UI")


@contextmanager
def over(kind="WINDOW"):
    """The context of a mouse over the viewport (WINDOW) or its sidebar (UI)."""
    area = view_3d()
    region = next(region for region in area.regions if region.type == kind)
    with bpy.context.temp_override(window=window(), area=area, region=region):
        yield


def press(button: str, /, escape_after: float | None = None, **properties):
    """Press the button of the operator; wait until its work is done, or press Esc after some
    seconds.

    Returns FINISHED or CANCELLED, MODAL where Blender keeps to itself how it ended, or what it
    raised.
    """
    module, function = button.split(".")
    try:
        with over():
            status = getattr(getattr(bpy.ops, module), function)(
                "INVOKE_DEFAULT", True, **properties
            )
    except RuntimeError as error:
        return f"CANCELLED: {error}"
    began = time.monotonic()
    escaped = False
    while button in (
        f"{o.bl_idname.replace('_OT_', '.').lower()}" for o in window().modal_operators
    ):
        if escape_after is not None and not escaped and time.monotonic() - began > escape_after:
            key("ESC")
            escaped = True
        if time.monotonic() - began > PATIENCE:
            raise TimeoutError(button)
        yield 0.1
    return "MODAL" if "RUNNING_MODAL" in status else next(iter(status))


def sample(name: str):
    """Press Sample Scene for the scene of this name; its characters are coarse, to draw quickly."""
    status = yield from press("crowd_lod.sample", name=name)
    coarsen(settings())
    return status


def until(condition, limit: float = 30.0, often: float = 0.2):
    """Wait until the condition holds, and look every `often` seconds.

    At the limit go on, the results will tell.
    """
    began = time.monotonic()
    while not condition() and time.monotonic() - began < limit:
        yield often


def drawn(rest: float = 0.5):
    """Have the viewport drawn anew.

    Wait until that is done, and what it left to a timer, however slow the machine.
    """
    before = len(_draws)
    view_3d().tag_redraw()
    yield from until(lambda: len(_draws) > before, often=min(rest, 0.2))
    yield rest  # a later round of Blender's loop than the drawing: its timers have run


def key(name: str, **held: bool):
    """Type a key with the mouse over the viewport; `held`: ctrl, shift, alt."""
    area = view_3d()
    x = area.x + area.width // 4
    y = area.y + area.height // 2
    window().event_simulate(type=name, value="PRESS", x=x, y=y, **held)
    window().event_simulate(type=name, value="RELEASE", x=x, y=y)


def dismiss():
    """Close a message box, if there is one."""
    key("ESC")
    yield 0.3


def scroll(notches: int):
    """Turn the wheel over the sidebar: down, or up where negative."""
    region = sidebar(view_3d())
    x = region.x + region.width // 3
    y = region.y + region.height // 2
    window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=y)
    yield 0.3
    for _ in range(abs(notches)):
        window().event_simulate(
            type="WHEELDOWNMOUSE" if notches > 0 else "WHEELUPMOUSE", value="PRESS", x=x, y=y
        )
    yield 0.3


def undo():
    with over():
        bpy.ops.ed.undo()


def redo():
    with over():
        bpy.ops.ed.redo()


def toggle():
    """Disable the extension and enable it again."""
    bpy.ops.preferences.addon_disable(module=MODULE)
    bpy.ops.preferences.addon_enable(module=MODULE)


def picture(name: str):
    """Save a picture of the window, or, where there is no ImageMagick, the one that Blender takes
    of itself.
    """
    yield 0.4
    path = _folder / f"{name}.png"
    if shutil.which("import") and os.environ.get("DISPLAY"):
        subprocess.call(["import", "-window", "root", str(path)])
    else:
        with over():
            bpy.ops.screen.screenshot(filepath=str(path))
    pictures.append(path.name)


def snapshot() -> dict[str, list]:
    """The file's data-blocks by kind and name, and the settings of the scene and its crowds."""
    found = {kind: sorted(block.name for block in getattr(bpy.data, kind)) for kind in KINDS}
    settings = window().scene.crowd_lod
    found["settings"] = [
        f"{name}: {_value(owner, name)}"
        for owner in (settings, *settings.crowds)
        for name in owner.bl_rna.properties.keys()
    ]
    return found


def _value(settings, name: str) -> str:
    value = getattr(settings, name)
    return str([*value] if hasattr(value, "__len__") and not isinstance(value, str) else value)


def changes(before: dict[str, list]) -> dict[str, list]:
    """What is new or gone since the snapshot."""
    after = snapshot()
    return {k: sorted(set(before[k]) ^ set(after[k])) for k in before if before[k] != after[k]}


def memory() -> int | None:
    """Bytes that the process has in memory, where the system tells."""
    path = Path("/proc/self/statm")
    return int(path.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if path.exists() else None


def leftovers() -> dict[str, int]:
    """Counts of all that an add-on could leave on Blender."""
    handlers = {name: getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)}
    handlers = {name: value for name, value in handlers.items() if isinstance(value, list)}
    return {
        **{name: len(functions) for name, functions in handlers.items()},
        "draw handlers": draw_handlers.count,
        "operators": len(dir(bpy.ops.crowd_lod)),
        "panels": len([name for name in dir(bpy.types) if name.startswith("CROWDLOD_PT_")]),
        "scene properties": len(bpy.types.Scene.bl_rna.properties),
    }
