"""Base classes of the operators, and what a window may do while one of them works."""

import time as clock
from collections.abc import Callable, Generator

import bpy
import numpy as np

from ...crowd_lod.errors import FAULTS, sentence
from ...crowd_lod.progress import TimeLeft, finished
from .evaluation import is_stepped
from .labeled_properties import CONTEXT
from .steps import Slices, Step, at_work, leave_edit_mode

MOVING = {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE", "WINDOW_DEACTIVATE"}
NAVIGATION = {
    *("MIDDLEMOUSE", "MOUSEROTATE", "MOUSESMARTZOOM", "TRACKPADPAN", "TRACKPADZOOM"),
    *("WHEELUPMOUSE", "WHEELDOWNMOUSE", "WHEELINMOUSE", "WHEELOUTMOUSE"),
    *("WHEELLEFTMOUSE", "WHEELRIGHTMOUSE"),
}
# of a 3D mouse, but its menu and its keys
NDOF = "NDOF_MOTION", "NDOF_BUTTON_"
NDOF_KEYS = "NDOF_BUTTON_MENU", "NDOF_BUTTON_SAVE_"
# of a 3D viewport alone: elsewhere some of them change the field under the mouse
VIEW_KEYS = {
    *(f"NUMPAD_{number}" for number in range(10)),
    *("NUMPAD_PERIOD", "NUMPAD_PLUS", "NUMPAD_MINUS", "HOME"),
}


def only_looks(window: bpy.types.Window, event: bpy.types.Event) -> bool:
    """Return whether the event, of the window, changes at most what the user looks at.

    With Ctrl or Alt most change something: Alt and the wheel the frame, Ctrl and the wheel the
    field under the mouse, Ctrl Numpad 0 the camera. So does all navigation through a camera that
    is locked to the view.
    """
    kind = event.type
    if kind in MOVING or kind.startswith("TIMER"):
        return True
    is_dolly = kind == "MIDDLEMOUSE" and not event.alt
    if event.oskey or (event.alt or event.ctrl) and not is_dolly:
        return False
    viewport = _viewport_under(window, event)
    if viewport is not None and _moves_camera(viewport):
        return False
    is_3d_mouse = kind.startswith(NDOF) and not kind.startswith(NDOF_KEYS)
    return kind in NAVIGATION or is_3d_mouse or (kind in VIEW_KEYS and viewport is not None)


def _viewport_under(
    window: bpy.types.Window, event: bpy.types.Event
) -> bpy.types.SpaceView3D | None:
    """Return the 3D viewport under the mouse; None in its sidebar and headers, or elsewhere."""
    for area in window.screen.areas:
        over = [
            region.type
            for region in area.regions
            if 0 <= event.mouse_x - region.x < region.width
            and 0 <= event.mouse_y - region.y < region.height
        ]
        if area.type == "VIEW_3D" and set(over) == {"WINDOW"}:
            return area.spaces.active
    return None


def _moves_camera(viewport: bpy.types.SpaceView3D) -> bool:
    views = viewport.region_3d, *viewport.region_quadviews
    return viewport.lock_camera and any(view.view_perspective == "CAMERA" for view in views)


def stop_playback() -> None:
    """Stop the animation that any window plays."""
    for window in bpy.context.window_manager.windows:
        if window.screen.is_animation_playing:
            with bpy.context.temp_override(window=window, screen=window.screen):
                bpy.ops.screen.animation_cancel(restore_frame=False)


# Seconds of work between two drawings of the window, by the seconds that the last one took: as many
# where that is quick, so that 0.3 s pass between two looks at the user's events; half as many where
# it is slow, or drawings would take most of the time. Steps change data, after which Blender draws
# all of the window: 0.1 to 0.2 s on software OpenGL, a few ms on a card.
TICKS = (0.04, 0.1, 0.2, 2.0), (0.04, 0.1, 0.1, 1.0)
BUSY = 0.1  # at most so many of them are processor time of Blender's own thread
# Seconds between two texts on the progress. Software OpenGL takes 40 ms to draw one in the sidebar
# and the status bar.
SHOWN_EVERY = 0.5
# jobs of Blender that read the file in threads of their own
JOBS = ("RENDER", "OBJECT_BAKE", "COMPOSITE")
# beginnings of the names of modal operators beside which a step goes on: they look
LOOKING = ("CROWD_LOD_OT_", "VIEW3D_OT_", "VIEW2D_OT_")


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
        if at_work():
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

    `work(scene)` is a generator that yields its progress, 0 to 1, and returns the message. In a
    window its steps run in a timer, while the user looks around and touches nothing. Without a
    window they run in one go.

    The step ends early if the user presses Esc, or if a script undoes, saves, opens a file, or
    changes what it rests on. The generator's own cleanup then leaves the scene as it was.

    remains: what such an end leaves, in words; `work` sets it where parts of the work stay.
    renders: whether it renders pictures of the scene, at other frames than the user's.
    """

    remains = "nothing was changed"
    renders = False

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        """Do the step for `scene`, which windows may leave meanwhile."""
        raise NotImplementedError

    def steps(self, context) -> Generator[float, None, str]:
        """Yield the progress and return the message; between two steps anything may happen."""
        return iter(self._begin(context.scene))

    def run(self, context) -> str:
        self._leave_edit_mode(context.scene)
        return finished(self.work(context.scene))

    def invoke(self, context, event) -> set[str]:
        stop_playback()
        try:
            slices = self._begin(context.scene)
        except FAULTS as fault:
            self.report({"ERROR"}, sentence(fault))
            return {"CANCELLED"}
        self._started = self._rested = clock.monotonic()
        self._shown = 0.0
        self._left = TimeLeft()
        self._step = Step(type(self).bl_idname, slices, self.renders, context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event) -> set[str]:
        if event.type == "ESC":
            self._step.end("was canceled")
        if self._step.dropped:
            self.report({"WARNING"}, f"{self.bl_label} {self._step.dropped}; {self.remains}.")
            return {"CANCELLED"}
        _watch_windows(context.window)
        if event.type == "TIMER" and not _others_at_work():
            return self._take_slice()
        looks = only_looks(context.window, event)
        return {"PASS_THROUGH"} if looks else {"RUNNING_MODAL"}

    def cancel(self, context) -> None:
        """End the step when Blender's window closes."""
        self._step.end("was canceled")

    def _begin(self, scene: bpy.types.Scene) -> Slices:
        self._leave_edit_mode(scene)
        return Slices(self.bl_label, scene, self.work)

    def _leave_edit_mode(self, scene: bpy.types.Scene) -> None:
        if names := leave_edit_mode(scene):
            self.report({"WARNING"}, f"Edit Mode was left: {', '.join(names)}.")

    def _take_slice(self) -> set[str]:
        """Take steps for as long as the window was drawn since the last ones."""
        drawing = clock.monotonic() - self._rested
        until = clock.monotonic() + np.interp(drawing, *TICKS)
        busy_until = clock.thread_time() + BUSY
        try:
            self._step.slices.take(
                lambda: clock.monotonic() >= until or clock.thread_time() >= busy_until
            )
        except StopIteration as end:
            self._step.end()
            self.report({"INFO"}, end.value)
            return {"FINISHED"}
        except FAULTS as fault:
            self._step.end()
            self.report({"ERROR"}, sentence(fault))
            return {"CANCELLED"}
        except BaseException:
            self._step.end()
            raise
        self._show()
        self._rested = clock.monotonic()
        return {"PASS_THROUGH"}

    def _show(self) -> None:
        """Show the progress, now and then."""
        now = clock.monotonic()
        if now < self._shown + SHOWN_EVERY:
            return
        self._shown = now
        slices = self._step.slices
        left = self._left.words(slices.progress, now - self._started)
        scene = slices.scene
        frame = f", at frame {scene.frame_current}" if is_stepped(scene) else ""
        done = f"{self.bl_label}: {slices.progress:.0%}{left}{frame}"
        self._step.show(f"{done}. You can look around; Esc cancels")


class CROWDLOD_OT_look(bpy.types.Operator):
    """Allow view navigation in another window while a step is at work"""

    bl_idname = "crowd_lod.look"
    bl_label = "Look Around"
    bl_options = {"INTERNAL"}
    bl_translation_context = CONTEXT

    @classmethod
    def poll(cls, context) -> bool:
        cls.poll_message_set("No step is at work")
        return at_work() is not None

    def invoke(self, context, event) -> set[str]:
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event) -> set[str]:
        step = at_work()
        if step is None:
            return {"FINISHED", "PASS_THROUGH"}
        if event.type == "ESC":
            step.end("was canceled")
            return {"FINISHED"}
        looks = only_looks(context.window, event)
        return {"PASS_THROUGH"} if looks else {"RUNNING_MODAL"}


def _watch_windows(own: bpy.types.Window) -> None:
    """Let events that do more than look through in no window but the step's `own`."""
    for window in bpy.context.window_manager.windows:
        names = {each.bl_idname for each in window.modal_operators}
        if window != own and "CROWD_LOD_OT_look" not in names:
            with bpy.context.temp_override(window=window):
                bpy.ops.crowd_lod.look("INVOKE_DEFAULT")


def _others_at_work() -> bool:
    """Return whether a job of Blender reads the file now, or an operator edits it.

    A step that changed data meanwhile could crash Blender.
    """
    windows = bpy.context.window_manager.windows
    names = [each.bl_idname for window in windows for each in window.modal_operators]
    return any(map(bpy.app.is_job_running, JOBS)) or not all(
        name.startswith(LOOKING) for name in names
    )


CLASSES = (CROWDLOD_OT_look,)
