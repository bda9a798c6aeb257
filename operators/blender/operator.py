"""Base classes of the operators."""

import time as clock
from collections.abc import Callable

import bpy

from ...crowd_lod.errors import FAULTS, sentence
from ...crowd_lod.progress import finished
from . import collection_caches, sidebars
from .labeled_properties import CONTEXT

TICK = 0.1  # seconds of work between two drawings of the window
# by the bl_idname of an operator at work: its progress, 0 to 1
at_work: dict[str, float] = {}


def left_words(progress: float, seconds: float) -> str:
    """Return a text with the estimated time left, or "" in the first two seconds.

    progress: 0 to 1, reached in `seconds`; "" at 0 too.
    """
    if seconds < 2 or not progress > 0:
        return ""
    left = seconds * (1 - progress) / progress
    unit, words = next(
        each
        for each in ((3600, "h"), (60, "min"), (1, "s"))
        if left >= 1.5 * each[0] or each[0] == 1
    )
    return f", about {left / unit:,.0f} {words} left"


class Needing:
    """Mix-in for operators that need something of a scene.

    needs: functions that return a sentence on what a scene lacks, or "". The tooltip of the grayed
        button says it.
    """

    bl_translation_context = CONTEXT
    needs: tuple[Callable[[bpy.types.Scene], str], ...] = ()

    @classmethod
    def poll(cls, context) -> bool:
        if context.scene is None:  # a window that closes
            return False
        lack = next(filter(None, (need(context.scene) for need in cls.needs)), "")
        if lack:
            cls.poll_message_set(lack)
        return not lack


class Reporting(Needing):
    """Mix-in for operators that report their result or an error.

    `run(context)` does the work and returns the message for the status bar. One of FAULTS is
    reported, and the operator is canceled.
    """

    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context) -> set[str]:
        try:
            message = self.run(context)
        except FAULTS as fault:
            self.report({"ERROR"}, sentence(fault))
            return {"CANCELLED"}
        self.report({"INFO"}, message)
        return {"FINISHED"}


class Stepwise(Reporting):
    """Mix-in for operators that take more than two seconds.

    `steps(context)` is a generator that yields its progress, 0 to 1, and returns the message. In a
    window the steps run in a timer, with a progress bar, and Esc cancels. The generator's own
    cleanup must then leave the scene as it was. Without a window the steps run in one go.

    remains: what a cancel leaves, in words; steps set it where parts of the work stay.
    """

    remains = "nothing was changed"

    @classmethod
    def poll(cls, context) -> bool:
        if at_work:
            cls.poll_message_set("Another step is at work: wait for its end, or press Esc")
            return False
        return super().poll(context)

    def run(self, context) -> str:
        return finished(self.steps(context))

    def invoke(self, context, event) -> set[str]:
        self._steps = self.steps(context)
        self._started = clock.monotonic()
        self._timer = context.window_manager.event_timer_add(0.01, window=context.window)
        context.window_manager.progress_begin(0, 100)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set(f"{self.bl_label}: Esc to cancel")
        at_work[type(self).bl_idname] = 0.0
        return {"RUNNING_MODAL"}

    def modal(self, context, event) -> set[str]:
        if event.type == "ESC":
            self._end(context)
            self.report({"WARNING"}, f"{self.bl_label} was canceled; {self.remains}.")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"RUNNING_MODAL"}
        try:
            until = clock.monotonic() + TICK
            while True:  # small steps together: each tick draws the window
                progress = next(self._steps)
                if clock.monotonic() >= until:
                    break
        except StopIteration as end:
            self._end(context)
            self.report({"INFO"}, end.value)
            return {"FINISHED"}
        except FAULTS as fault:
            self._end(context)
            self.report({"ERROR"}, sentence(fault))
            return {"CANCELLED"}
        except BaseException:
            self._end(context)
            raise
        at_work[type(self).bl_idname] = progress
        sidebars.redraw()
        context.window_manager.progress_update(100 * progress)
        left = left_words(progress, clock.monotonic() - self._started)
        context.workspace.status_text_set(
            f"{self.bl_label}: {100 * progress:.0f} %{left}, Esc to cancel"
        )
        return {"RUNNING_MODAL"}

    def cancel(self, context) -> None:
        """End the steps when Blender's window closes; no scene is left to clean up."""
        self._end(context)

    def _end(self, context) -> None:
        at_work.clear()
        self._steps.close()
        collection_caches.renew()  # the work removed data-blocks that collections may remember
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)
