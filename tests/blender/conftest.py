"""Every test starts in an empty file with the extension registered."""

import shutil
from contextlib import contextmanager

import bpy
import crowd_lod_extension
import pytest
from crowd_lod_extension.crowd_lod.simplification import decimate
from crowd_lod_extension.operators.blender import sidebar_answers
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd

from ..support.coarse_characters import CAGE
from ..support.empty_file import open_empty_file
from ..support.objects import collection, filmed_from


@pytest.fixture(scope="module", autouse=True)
def registered():
    crowd_lod_extension.register()
    yield
    crowd_lod_extension.unregister()


@pytest.fixture(autouse=True)
def empty_file(registered):
    open_empty_file()


@pytest.fixture
def at_once(monkeypatch):
    """The sidebar looks at the scene again whenever it is drawn, not once a second."""
    monkeypatch.setattr(sidebar_answers, "LOOK", 0.0)


@contextmanager
def _rough():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(decimate, "ROUNDS", (1, 1))
        patch.setattr(decimate, "RESAMPLINGS", 0)
        yield


@pytest.fixture
def rough_lods():
    """LODs are moved nearer to their characters once, which takes half of the time otherwise."""
    with _rough():
        yield


@pytest.fixture
def scene(request):
    """A small crowd of two coarse sample characters, seen by a camera; LODs at 12 m and 30 m.

    A file of tests may name finer ones by FINER, a number for make_characters.
    """
    from crowd_lod_extension.sample_scenes.characters import make_characters

    scene = bpy.context.scene
    scene.render.fps = 24
    scene.render.resolution_x = 160
    scene.render.resolution_y = 90
    characters = collection("People")
    make_characters(characters, finer=_finer(request))
    characters.children.unlink(characters.children["heavy"])
    characters.hide_render = True
    filmed_from((0, -25, 2), (1.5, 0, 0), clip_end=60)
    settings = scene.crowd_lod
    settings.characters = characters
    settings.forward = "X"
    settings.count = 300
    settings.size = (40, 40)
    settings.thresholds[:2] = (0.2, 0.5)
    return scene


@pytest.fixture
def small_shot():
    """A scene of two small frames with a camera and no characters yet, in which 6 agents are to
    be.
    """
    scene = bpy.context.scene
    scene.render.resolution_x = 80
    scene.render.resolution_y = 45
    scene.frame_start = 1
    scene.frame_end = 2
    filmed_from((0, -25, 2), (1.5, 0, 0))
    settings = scene.crowd_lod
    settings.count = 6
    settings.size = (10, 10)
    return scene


@pytest.fixture
def rendered():
    """(scene, number, look) -> what look(scene) says at each time that Cycles asks for to render
    the frame.
    """

    def render(scene, number, look):
        found = {}

        def looked(scene, depsgraph):
            if depsgraph.mode == "RENDER":
                time = scene.frame_current + scene.frame_subframe
                assert found.setdefault(time, look(scene)) == look(scene), time

        scene.frame_set(number)
        scene.render.engine = "CYCLES"
        scene.cycles.samples = 1
        scene.render.resolution_percentage = 10
        bpy.app.handlers.frame_change_post.append(looked)
        try:
            bpy.ops.render.render()
        finally:
            bpy.app.handlers.frame_change_post.remove(looked)
        return found

    return render


@pytest.fixture(scope="session")
def saved_once(tmp_path_factory, worker_id):
    """(name, make) -> the scene of a file of that name, which is as make() leaves the open file.

    What takes seconds to make is made by the first test that asks for it, in any of the processes
    that run tests side by side.
    """
    own = tmp_path_factory.mktemp("saved")  # tests write beside the file that is open
    run = tmp_path_factory.getbasetemp()
    shared = (run if worker_id == "master" else run.parent) / "saved"
    shared.mkdir(exist_ok=True)

    def opened(name, make):
        made = shared / f"{name}.blend"
        path = own / made.name
        if not made.exists():
            make()
            bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
            path.replace(made)
        shutil.copyfile(made, path)
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
        return bpy.context.scene

    return opened


@pytest.fixture
def levelled(saved_once, request):
    """The small crowd with its LODs."""
    name = f"levelled {_finer(request)}"
    return saved_once(name, lambda: _level(request.getfixturevalue("scene")))


@pytest.fixture
def one_level(saved_once, request):
    """The small crowd of one group that shows its character itself.

    Pictures of LODs and their silhouettes take three quarters of a small preview.
    """
    name = f"one level {_finer(request)}"
    return saved_once(name, lambda: _level_one_group(request.getfixturevalue("scene"), 1))


@pytest.fixture
def two_levels(saved_once, request):
    """The small crowd of one group and one LOD: a preview of it takes a quarter of the time."""
    name = f"two levels {_finer(request)}"
    return saved_once(name, lambda: _level_one_group(request.getfixturevalue("scene"), 2))


@pytest.fixture
def by_tolerance(saved_once, request):
    """The small crowd of one group, with rough LODs by tolerance."""

    def make():
        settings = request.getfixturevalue("scene").crowd_lod
        settings.characters.children.unlink(settings.characters.children["child"])
        settings.choice = "BY_TOLERANCE"
        settings.tolerance = 1.0
        settings.frames = "1:20"
        with _rough():
            assert bpy.ops.crowd_lod.populate() == bpy.ops.crowd_lod.make_levels() == {"FINISHED"}

    return saved_once("by tolerance", make)


@pytest.fixture
def built(saved_once, request):
    """The small crowd, built, under a camera that moves and turns."""
    name = f"built {_finer(request)}"
    scene = saved_once(name, lambda: _build(request.getfixturevalue("levelled")))
    scene.frame_set(1)
    return scene


def _finer(request) -> int:
    return getattr(request.module, "FINER", CAGE)


def _level_one_group(scene, levels):
    people = scene.crowd_lod.characters
    people.children.unlink(people.children["child"])
    scene.crowd_lod.level_count = levels
    _level(scene)


def _level(scene):
    from crowd_lod_extension.operators.lods.make_lods import make_levels
    from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
    from crowd_lod_extension.operators.scene.characters.stored_groups import store_groups

    store_groups(scene.crowd_lod, measure_groups(scene))
    with _rough():  # whichever test is the first to ask for them
        list(make_levels(scene))


def _build(scene):
    from crowd_lod_extension.operators.build.render_setup import build

    for frame, x, turn in ((1, -5, -0.3), (40, 12, 0.6)):
        scene.camera.location.x = x
        scene.camera.rotation_euler.z = turn
        scene.camera.keyframe_insert("location", frame=frame)
        scene.camera.keyframe_insert("rotation_euler", frame=frame)
    list(build(read_crowd(scene)))
