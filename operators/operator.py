"""What every operator does alike."""

import time as clock

from ..crowd_lod.errors import FAULTS, sentence
from ..crowd_lod.steps import finished

TICK = 0.1  # seconds of work between two drawings of the window


class Reporting:
    """Mix-in: `run(context)` does the work and returns the message for the status bar; an ordinary fault is
    reported and the operator is cancelled."""

    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context):
        try:
            message = self.run(context)
        except FAULTS as fault:
            self.report({"ERROR"}, sentence(fault))
            return {"CANCELLED"}
        self.report({"INFO"}, message)
        return {"FINISHED"}


class Stepwise(Reporting):
    """Mix-in for work of more than two seconds: `steps(context)` is a generator that yields its progress from 0 to 1
    and returns the message. In a window it runs a step at each timer tick, with a progress bar, and Esc ends it: the
    generator's own clean-up must leave the scene as it was. Without a window it runs in one go."""

    def run(self, context):
        return finished(self.steps(context))

    def invoke(self, context, event):
        self._steps = self.steps(context)
        self._timer = context.window_manager.event_timer_add(0.01, window=context.window)
        context.window_manager.progress_begin(0, 100)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set(f"{self.bl_label}: Esc to cancel")
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC":
            self._end(context)
            self.report({"WARNING"}, f"{self.bl_label} was cancelled; nothing was changed.")
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
        context.window_manager.progress_update(100 * progress)
        context.workspace.status_text_set(f"{self.bl_label}: {100 * progress:.0f} %, Esc to cancel")
        return {"RUNNING_MODAL"}

    def _end(self, context):
        self._steps.close()
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)
