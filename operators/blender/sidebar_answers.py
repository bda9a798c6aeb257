"""Answers that the sidebar asks for whenever it is drawn."""

import functools
from collections.abc import Callable
from typing import TypeVar

import bpy

from . import scene_cache
from .operator import at_work

Answer = TypeVar("Answer")


def keep_at_work(ask: Callable[[bpy.types.Scene], Answer]) -> Callable[[bpy.types.Scene], Answer]:
    """Decorate a question about a scene: while a step is at work, its first answer stays.

    Steps go through frames and change data. To look up what that makes of an answer took 60 ms of
    each drawing, for one character.
    """
    answers: dict[int, Answer] = scene_cache.add_cache({}, by_scene=True)

    @functools.wraps(ask)
    def answer(scene: bpy.types.Scene) -> Answer:
        if not (at_work and scene.session_uid in answers):
            answers[scene.session_uid] = ask(scene)
        return answers[scene.session_uid]

    return answer
