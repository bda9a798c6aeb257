"""What benchmarks in a Blender's window share: a session of steps between which Blender draws."""

import sys
from collections.abc import Iterator
from types import ModuleType

import bpy

EVERY = 0.5  # seconds from one step to the next


def overlay() -> ModuleType:
    """Return the enabled extension's module of the overlay, whatever its repository is called."""
    return next(
        module
        for name, module in sys.modules.items()
        if name.endswith(".operators.viewport.viewport_overlay")
    )


def begin(session: Iterator) -> None:
    """Take the session's steps once Blender has drawn its window, then quit."""

    def tick() -> float | None:
        try:
            next(session)
            return EVERY
        except StopIteration:
            bpy.ops.wm.quit_blender()
            return None

    bpy.context.preferences.view.show_splash = False
    bpy.app.timers.register(tick, first_interval=1.0, persistent=True)
