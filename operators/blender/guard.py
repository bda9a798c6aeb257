"""The guard around every function of ours that Blender calls: handlers, timers, updates.

Whatever such a function raises, Blender would print as a traceback at each call, and show nowhere.
The guard says it once, in a sentence: on stderr, and in the sidebar until a call succeeds.
"""

import functools
import sys
import traceback
from collections.abc import Callable
from typing import Any

import bpy

from ...crowd_lod.errors import FAULTS, sentence

# By the scene's session_uid (0 for all scenes) and the function's name: what its last call raised.
troubles: dict[tuple[int, str], str] = {}


def handler(function: Callable) -> Callable:
    """Decorate a handler for bpy.app.handlers: guarded, and kept when a file is loaded."""
    return bpy.app.handlers.persistent(guarded(function))


def guarded(function: Callable | None = None, failed: Any = None) -> Callable:
    """Decorate a function that Blender calls: no exception leaves it.

    failed: what it returns after an exception; for a timer the seconds to its next call, or None to
        end it.

    The first argument may be a scene or part of one. The trouble is then told of that scene alone.
    """
    if function is None:
        return functools.partial(guarded, failed=failed)

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
