"""Base classes of the operators."""

import time as clock
from collections.abc import Callable
from typing import Any

import bpy
import numpy as np

from ...crowd_lod.errors import FAULTS, sentence
from ...crowd_lod.progress import finished
from ...crowd_lod.time_left import TimeLeft
from . import collection_caches, sidebars, unfinished
from .guard import handler
from .labeled_properties import CONTEXT

# Seconds of work between two drawings of the window, by the seconds that the last one took: as many
# where that is quick, so that 0.3 s pass between two looks at the user's events; half as many where
# it is slow, or drawings would take most of the time. Steps change data, after which Blender draws
# all of the window: 0.1 to 0.2 s on software OpenGL, a few ms on a card.
TICKS = (0.04, 0.1, 0.2, 2.0), (0.04, 0.1, 0.1, 1.0)
BUSY = 0.1  # at most so many of them are processor time of Blender's own thread
# Seconds between two texts on the progress. Software OpenGL takes 40 ms to draw one in the sidebar
# and the status bar.
SHOWN_EVERY = 0.5
# by the bl_idname of an operator at work: its progress, 0 to 1
at_work: dict[str, float] = {}
# functions of a scene that return what steps rest on; registration fills the list
RESTS_ON: list[Callable[[bpy.types.Scene], Any]] = []
# jobs of Blender that read the file in threads of their own
JOBS = ("RENDER", "OBJECT_BAKE", "COMPOSITE")
# beginnings of the names of operators beside which a step goes on: they look, or scrub
LOOKING = ("CROWD_LOD_OT_", "VIEW3D_OT_", "VIEW2D_OT_", "ANIM_OT_change_frame")
_running: list["Stepwise"] = []


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
        if at_work:
            cls.poll_message_set("Another step is at work: wait for its end, or press Esc")
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
    window the steps run in a timer, while the user looks around and scrubs. Without a window they
    run in one go.

    The steps are dropped if the user presses Esc or clicks the progress, undoes, opens a file, or
    changes what the steps rest on. The generator's own cleanup then leaves the scene as it was.

    remains: what such an end leaves, in words; steps set it where parts of the work stay.
    """

    remains = "nothing was changed"

    def run(self, context) -> str:
        return finished(self.steps(context))

    def invoke(self, context, event) -> set[str]:
        self._steps = self.steps(context)
        self._scene = context.scene
        self._started = self._rested = clock.monotonic()
        self._shown = 0.0
        self._left = TimeLeft()
        self._dropped = ""
        self._status = ""
        self._rests_on = _inputs_of(context.scene)
        self._state = unfinished.state()
        self._timer = context.window_manager.event_timer_add(0.01, window=context.window)
        context.window_manager.progress_begin(0, 100)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set(f"{self.bl_label}: Esc to cancel")
        at_work[type(self).bl_idname] = 0.0
        _running.append(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event) -> set[str]:
        if event.type == "ESC":
            self.drop("was canceled")
        if event.type == "TIMER" and not self._dropped and not _others_at_work():
            return self._take_steps(context)
        if self._dropped:
            self._end(context)
            self.report({"WARNING"}, f"{self.bl_label} {self._dropped}; {self.remains}.")
            return {"CANCELLED"}
        return {"PASS_THROUGH"}

    def drop(self, reason: str) -> None:
        """Close the steps; `modal` ends the operator and reports the reason."""
        self._steps.close()
        unfinished.end(self._scene)
        self._dropped = self._dropped or reason

    def _take_steps(self, context) -> set[str]:
        """Take steps for as long as the window was drawn since the last ones."""
        drawing = clock.monotonic() - self._rested
        try:
            if _inputs_of(self._scene) != self._rests_on:  # by the user, since the last steps
                self.drop("was stopped, as settings, characters or the camera were changed")
                return {"PASS_THROUGH"}
            before = unfinished.note_users(self._state)
            until = clock.monotonic() + np.interp(drawing, *TICKS)
            busy_until = clock.thread_time() + BUSY
            while True:  # small steps together
                progress = next(self._steps)
                if clock.monotonic() >= until or clock.thread_time() >= busy_until:
                    break
            self._state = unfinished.note(self._scene, before)
            self._rests_on = _inputs_of(self._scene)  # steps may set some for a while
        except StopIteration as end:
            self._end(context)
            self.report({"INFO"}, end.value)
            return {"FINISHED"}
        except ReferenceError:
            self.drop("was stopped, as something that it read was deleted")
            return {"PASS_THROUGH"}
        except FAULTS as fault:
            self._end(context)
            self.report({"ERROR"}, sentence(fault))
            return {"CANCELLED"}
        except BaseException:
            self._end(context)
            raise
        self._show(context, progress)
        self._rested = clock.monotonic()
        return {"PASS_THROUGH"}

    def _show(self, context, progress: float) -> None:
        """Show the progress, now and then, where its text is another than before."""
        now = clock.monotonic()
        if now < self._shown + SHOWN_EVERY:
            return
        self._shown = now
        left = self._left.words(progress, now - self._started)
        status = f"{self.bl_label}: {100 * progress:.0f}%{left}, Esc to cancel"
        if status != self._status:
            self._status = status
            at_work[type(self).bl_idname] = progress
            sidebars.redraw()
            context.window_manager.progress_update(100 * progress)
            context.workspace.status_text_set(status)

    def cancel(self, context) -> None:
        """End the steps when Blender's window closes; no scene is left to clean up."""
        self._end(context)

    def _end(self, context) -> None:
        at_work.clear()
        _running.clear()
        self._steps.close()
        unfinished.end(self._scene)
        collection_caches.renew()  # the work removed data-blocks that collections may remember
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)
        sidebars.redraw()


def _inputs_of(scene: bpy.types.Scene) -> list[Any]:
    return [read(scene) for read in RESTS_ON]


def _others_at_work() -> bool:
    """Return whether a job of Blender reads the file now, or an operator edits it.

    A step that changed data meanwhile could crash Blender.
    """
    windows = bpy.context.window_manager.windows
    names = [each.bl_idname for window in windows for each in window.modal_operators]
    return any(map(bpy.app.is_job_running, JOBS)) or not all(
        name.startswith(LOOKING) for name in names
    )


@handler
def stop_for_undo(*_) -> None:
    """Drop the steps before data changes under them (undo_pre, redo_pre handler)."""
    for step in _running:
        step.drop("was stopped by the undo")


@handler
def stop_for_file(*_) -> None:
    """Drop the steps before another file is opened (load_pre handler)."""
    for step in _running:
        step.drop("was stopped, as another file was opened")


class CROWDLOD_OT_stop(bpy.types.Operator):
    """Stop the step that is at work; nothing is changed"""

    bl_idname = "crowd_lod.stop"
    bl_label = "Stop"
    bl_options = {"INTERNAL"}
    bl_translation_context = CONTEXT

    @classmethod
    def poll(cls, context) -> bool:
        cls.poll_message_set("No step is at work")
        return bool(at_work)

    def execute(self, context) -> set[str]:
        for step in _running:
            step.drop("was canceled")
        return {"FINISHED"}


CLASSES = (CROWDLOD_OT_stop,)
