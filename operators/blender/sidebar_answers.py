"""Answers that the sidebar asks for whenever it is drawn."""

import functools
import time as clock
from collections.abc import Callable
from typing import Generic, TypeVar

import bpy

from . import scene_cache
from .steps import at_work

LOOK = 1.0  # seconds between two looks at a scene that stays the same
SHARE = 0.05  # of the time that looks may take: a long one serves for longer
Answer = TypeVar("Answer")
Question = Callable[[bpy.types.Scene], Answer]


class KeptAnswer(Generic[Answer]):
    """A question about a scene whose answer holds for LOOK seconds, or until its key changes."""

    def __init__(self, ask: Question[Answer], key: Question[object]):
        self._ask = ask
        self._key = key
        # of each scene: until when the answer holds, and for which key
        self._answers: dict[int, tuple[float, object, Answer]] = scene_cache.add_cache(
            {}, by_scene=True
        )

    def __call__(self, scene: bpy.types.Scene) -> Answer:
        key = self._key(scene)
        if not self._holds(scene, key):
            begun = clock.monotonic()
            answer = self._ask(scene)
            took = clock.monotonic() - begun
            until = begun + LOOK * max(1.0, took / SHARE)
            scene_cache.tidy()
            self._answers[scene.session_uid] = until, key, answer
        return self._answers[scene.session_uid][2]

    def holds(self, scene: bpy.types.Scene) -> bool:
        """Return whether the last answer still holds."""
        return self._holds(scene, self._key(scene))

    def latest(self, scene: bpy.types.Scene) -> Answer | None:
        """Return the last answer, whether or not it still holds; None without one."""
        _, _, answer = self._answers.get(scene.session_uid, (0.0, None, None))
        return answer

    def drop(self, scene: bpy.types.Scene) -> None:
        """Look again when next asked."""
        self._answers.pop(scene.session_uid, None)

    def _holds(self, scene: bpy.types.Scene, key: object) -> bool:
        until, known_key, _ = self._answers.get(scene.session_uid, (-1.0, None, None))
        return clock.monotonic() < until and key == known_key


# In quotes: typing would remember KeptAnswer, and Blender 4.5 hang when it ends
# (docs/notes/blender_traps.md).
def hold(
    key: Question[object] = lambda _: None,
) -> "Callable[[Question[Answer]], KeptAnswer[Answer]]":
    """Decorate a question about a scene: its answer is `KeptAnswer`.

    key: returns what the answer depends on, as far as that is quick to read.
    """
    return lambda ask: KeptAnswer(ask, key)


def keep_at_work(ask: Question[Answer]) -> Question[Answer]:
    """Decorate a question about a scene: while a step is at work, its first answer stays.

    Steps go through frames and change data. To look up what that makes of an answer took 60 ms of
    each drawing, for one character.
    """
    answers: dict[int, Answer] = scene_cache.add_cache({}, by_scene=True)

    @functools.wraps(ask)
    def answer(scene: bpy.types.Scene) -> Answer:
        if not (at_work() and scene.session_uid in answers):
            answers[scene.session_uid] = ask(scene)
        return answers[scene.session_uid]

    return answer
