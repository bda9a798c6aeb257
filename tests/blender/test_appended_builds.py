"""A live build that is appended to another file: with its scene it follows the frame, without it it
says that it stands still.
"""

import bpy
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.build.appended_builds import standing_still
from crowd_lod_extension.operators.build.bake import bake
from crowd_lod_extension.operators.build.buttons import build_live
from crowd_lod_extension.operators.build.shelves import points_of
from crowd_lod_extension.operators.ui import steps

from ..support.objects import filmed_from


def saved(scene, path):
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    build = scene.crowd_lod.build
    names = {
        "Scene": [scene.name],
        "Collection": [build.name],
        "Object": [item.name for item in build.objects],
    }
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return names


def append(path, kind, names):
    for name in names:
        bpy.ops.wm.append(directory=f"{path}/{kind}/", filename=name)
    return bpy.context.scene


def test_an_appended_scene_follows_the_frame(built, tmp_path):
    path = tmp_path / "live.blend"
    names = saved(built, path)
    append(path, "Scene", names["Scene"])
    scene = next(each for each in bpy.data.scenes if each.crowd_lod.build is not None)
    counts = []
    for frame in (1, 40):
        scene.frame_set(frame)
        counts.append(
            [len(item.data.vertices) for item in points_of(scene.crowd_lod.build).values()]
        )
    assert counts[0] != counts[1] and not any(map(standing_still, bpy.data.scenes))


@pytest.mark.parametrize("kind", ("Collection", "Object"))
def test_without_its_scene_it_says_that_it_stands_still_by_name(built, tmp_path, capfd, kind):
    path = tmp_path / "live.blend"
    names = saved(built, path)
    scene = append(path, kind, names[kind])
    told = (
        f"The build {' and '.join(sorted(names[kind])[:3])} came from another file without its "
        f"scene's settings"
    )
    assert steps.messages(scene)[0][0].startswith(told) and steps.messages(scene)[0][1] == "ERROR"
    if kind == "Object":  # renders say the same
        return
    filmed_from((0, 0, 0))
    scene.render.engine = "BLENDER_WORKBENCH"
    scene.render.resolution_percentage = 1
    scene.render.filepath = str(tmp_path / "x")
    scene.frame_end = 2
    capfd.readouterr()
    bpy.ops.render.render(animation=True)
    said = capfd.readouterr().err
    assert said.count(told) == 1 and "Traceback" not in said


def test_a_linked_scene_says_that_it_stands_still_and_an_appended_bake_nothing(built, tmp_path):
    path = tmp_path / "live.blend"
    names = saved(built, path)
    with bpy.data.libraries.load(str(path), link=True) as (_, linked):
        linked.scenes = names["Scene"]
    (scene,) = linked.scenes
    assert standing_still(scene).startswith(f"The scene {scene.name} is linked")
    bpy.ops.wm.open_mainfile(filepath=str(path))
    built = bpy.context.scene
    list(bake(built, [1, 2]))
    path = tmp_path / "baked.blend"
    names = saved(built, path)
    assert not standing_still(append(path, "Collection", names["Collection"]))


def test_a_linked_instance_of_a_live_build_says_that_it_stands_still(built, tmp_path):
    path = tmp_path / "live.blend"
    (name,) = saved(built, path)["Collection"]
    with bpy.data.libraries.load(str(path), link=True) as (_, linked):
        linked.collections = [name]
    scene = bpy.context.scene
    empty = bpy.data.objects.new("Instance", None)  # as File, Link makes it
    empty.instance_type = "COLLECTION"
    (empty.instance_collection,) = linked.collections
    scene.collection.objects.link(empty)
    assert standing_still(scene).startswith(f"The build {name} came from another file")


def test_a_build_in_its_own_file_says_nothing(built):
    assert not standing_still(built)


def test_a_live_build_in_a_background_scene_says_that_it_stands_still(built, tmp_path, capfd):
    """A scene in between shows it, too; a bake follows."""
    between = bpy.data.scenes.new("Set")
    between.background_set = built
    lighting = bpy.data.scenes.new("Lighting")
    lighting.background_set = between
    told = (
        f"The scene {{}} shows {built.name} as its Background Scene, where the live build stands "
        f"still: press Bake in {built.name}."
    )
    assert steps.messages(lighting)[0][:2] == (told.format("Lighting"), "ERROR")
    assert any(line[0] == told.format("Lighting") for line in steps.messages(built))
    assert told.format("Lighting") in finished(build_live(built))
    lighting.camera = built.camera
    lighting.render.engine = "BLENDER_WORKBENCH"
    lighting.render.resolution_percentage = 1
    lighting.render.filepath = str(tmp_path / "x")
    capfd.readouterr()
    bpy.ops.render.render(scene="Lighting", write_still=True)
    assert capfd.readouterr().err.count(told.format("Lighting")) == 1
    list(bake(built, [1, 2]))
    assert not any(line[0] == told.format("Lighting") for line in steps.messages(built))
