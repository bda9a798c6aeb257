"""Functions of ours that Blender calls: handlers, timers, updates; and work in its main thread.

An exception of ours in such a call would be Blender's: it would print it at every redraw or frame.
The guard says it once, in a sentence: on stderr, and in the sidebar until a call succeeds.
"""

import functools
import queue
import sys
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import bpy

from ...crowd_lod.errors import FAULTS, CrowdError, sentence
from ...crowd_lod.progress import Made

# By the scene's session_uid (0 for all scenes) and the function's name: what its last call raised.
troubles: dict[tuple[int, str], str] = {}


def handler(function: Callable) -> Callable:
    """Decorate a handler for bpy.app.handlers: guarded, and kept when a file is loaded."""
    return bpy.app.handlers.persistent(guard(function))


def guard(function: Callable | None = None, failed: Any = None) -> Callable:
    """Decorate a function that Blender calls: no exception leaves it.

    failed: what it returns after an exception; for a timer the seconds to its next call, or None to
        end it.

    The first argument may be a scene or part of one. The trouble is then told of that scene alone.
    """
    if function is None:
        return functools.partial(guard, failed=failed)

    @functools.wraps(function)
    def call(*arguments) -> Any:
        scene = getattr(arguments[0], "id_data", None) if arguments else None
        scene = scene if isinstance(scene, bpy.types.Scene) else None
        key = (
            scene.session_uid if scene is not None else 0,
            f"{function.__module__}.{function.__qualname__}",
        )
        try:
            result = function(*arguments)
        except Exception as error:
            _tell(key, scene, error)
            return failed
        troubles.pop(key, None)
        return result

    return call


def troubles_of(scene: bpy.types.Scene) -> list[str]:
    """Return sentences on what failed when it was last called, for this scene or for all."""
    return list(
        dict.fromkeys(
            told for (owner, _), told in troubles.items() if owner in (0, scene.session_uid)
        )
    )


def clear_troubles(scene: bpy.types.Scene) -> None:
    """Forget what failed in the scene; what still fails is told again."""
    for key in [key for key in troubles if key[0] == scene.session_uid]:
        del troubles[key]


def _tell(key: tuple[int, str], scene: bpy.types.Scene | None, error: Exception) -> None:
    """Note what a call raised, and print it unless the call before raised the same."""
    if isinstance(error, FAULTS):
        message = sentence(error)
    else:
        message = (
            f"{key[1].rpartition('.')[2].strip('_')} failed in Crowd LOD ({type(error).__name__}: "
            f"{error}): "
            "the console has the details; save the file, start Blender again, and report it."
        )
    if troubles.get(key) == message:
        return
    troubles[key] = message
    if not isinstance(error, FAULTS):
        traceback.print_exception(error)
    where = f", frame {scene.frame_current}" if scene is not None else ""
    print(f"Crowd LOD{where}: {message}", file=sys.stderr)


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
