"""Runs work in Blender's main thread.

A render in a window asks for its frames from its own thread. If that thread makes, changes or
removes data while the main thread draws it, Blender may crash.
"""

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.progress import Made
from .guard import guard

PAUSE = 0.01  # seconds between two looks at what there is to do
# seconds; the main thread may itself wait for the render to end, when it is stopped
PATIENCE = 20.0
_waiting: queue.SimpleQueue[tuple[Future, Callable]] = queue.SimpleQueue()


def on_main_thread(work: Callable[[], Made]) -> Made:
    """Run `work()` in the main thread and return its result, or raise its error.

    CrowdError if the main thread does not start it within PATIENCE seconds.
    """
    if threading.current_thread() is threading.main_thread():
        return work()
    task: Future[Made] = Future()
    _waiting.put((task, work))
    try:
        return task.result(PATIENCE)
    except TimeoutError:
        if task.cancel():
            raise CrowdError(
                "Blender was too busy to follow the render: render again, with Lock Interface on."
            ) from None
        return task.result()


@guard(failed=PAUSE)
def do_waiting() -> float:
    """Do what other threads wait for; return the seconds until the next look."""
    while not _waiting.empty():
        task, work = _waiting.get()
        if task.set_running_or_notify_cancel():
            try:
                task.set_result(work())
            except BaseException as error:  # it belongs to the thread that waits
                task.set_exception(error)
    return PAUSE


def register() -> None:
    if not bpy.app.background:  # there all renders run in the main thread
        bpy.app.timers.register(do_waiting, persistent=True)


def unregister() -> None:
    if bpy.app.timers.is_registered(do_waiting):
        bpy.app.timers.unregister(do_waiting)
