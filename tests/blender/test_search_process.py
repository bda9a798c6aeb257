"""Searches for the LODs of several characters, each in a process of its own."""

import os
import resource
import sys

import bpy
import pytest
from crowd_lod_extension.crowd_lod.progress import count_cores, finished
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.characters.stored_groups import groups_of

from ..support.characters import character
from ..support.objects import filmed_from

pytestmark = [
    pytest.mark.once,  # two searches that are worth processes take 20 s
    pytest.mark.skipif(sys.platform == "win32", reason="the processes' times are POSIX's"),
    pytest.mark.skipif(count_cores() < 2, reason="one core searches alone"),
]


@pytest.fixture
def scene():
    """Two pillars of 4,000 triangles, a short and a long one."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    for name, height in (("short", 1.2), ("long", 2.4)):
        bpy.ops.mesh.primitive_cone_add(vertices=4, radius1=0.3, radius2=0.2, depth=height)
        item = bpy.context.object
        item.name = name
        subdivided = item.modifiers.new("Subdivision", "SUBSURF")
        subdivided.subdivision_type = "SIMPLE"
        subdivided.levels = subdivided.render_levels = 4
        item.users_collection[0].objects.unlink(item)
        character(item, name=name)
    filmed_from((0, -40, 2), (1.5, 0, 0))
    scene.crowd_lod.count = 60
    scene.crowd_lod.size = (6, 6)
    return scene


def children_seconds():
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime


def has_children():
    try:
        os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return False
    return True


def made(scene):
    finished(make_levels(scene))
    return groups_of(scene.crowd_lod)


def places(scene):
    return [
        [tuple(vertex.co) for vertex in item.data.vertices]
        for level in scene.crowd_lod.levels.children
        for home in level.children
        for item in home.objects
    ]


def test_processes_find_what_one_finds_alone(scene, monkeypatch):
    before = children_seconds()
    groups, found = made(scene), places(scene)
    assert children_seconds() - before > 4
    scene.crowd_lod.levels = None
    monkeypatch.setenv("PYTHONHOME", "/nowhere")  # no process starts: all is searched here
    assert made(scene) == groups
    assert places(scene) == found


def test_a_search_that_is_closed_ends_its_processes(scene):
    blocks = len(bpy.data.user_map())
    steps = make_levels(scene)
    next(progress for progress in steps if has_children())
    steps.close()
    assert not has_children()
    assert len(bpy.data.user_map()) == blocks
