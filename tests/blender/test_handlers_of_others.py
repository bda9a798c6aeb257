"""Handlers of other add-ons may be callables of any kind: none of them stops the live build."""

from functools import partial

import bpy
import pytest
from crowd_lod_extension.operators import registration
from crowd_lod_extension.operators.blender.ownership import PACKAGE, is_ours
from crowd_lod_extension.operators.build.shelves import points_of


def function(*_):
    pass


def without_module(value):
    def handlers(*_):
        pass

    handlers.__module__ = value
    return handlers


class Callable:
    __module__ = None

    def __call__(self, *_):
        pass

    def method(self, *_):
        pass


OTHERS = {
    "function": function,
    "module None": without_module(None),
    "module 5": without_module(5),
    "a name that begins like ours": without_module(f"{PACKAGE}_more.tools"),
    "partial": partial(function),
    "object": Callable(),
    "method": Callable().method,
    "builtin": print,
    "builtin method": [].append,
    "class": dict.fromkeys,
}


@pytest.mark.parametrize("kind", OTHERS)
def test_a_handler_of_another_add_on_is_not_ours_and_the_build_follows(built, capfd, kind):
    other = OTHERS[kind]
    assert not is_ours(other)
    bpy.app.handlers.frame_change_post.append(other)
    bpy.app.handlers.depsgraph_update_post.append(other)
    try:
        before = sum(len(item.data.vertices) for item in points_of(built.crowd_lod.build).values())
        built.frame_set(30)
        told = capfd.readouterr().err
    finally:
        bpy.app.handlers.frame_change_post.remove(other)
        bpy.app.handlers.depsgraph_update_post.remove(other)
    assert "Crowd LOD" not in told and "ownership" not in told
    assert (
        sum(len(item.data.vertices) for item in points_of(built.crowd_lod.build).values()) != before
    )


def test_our_own_handlers_are_ours():
    assert all(is_ours(each) for functions in registration.HANDLERS.values() for each in functions)
