import subprocess
import sys

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.levels.cost_model import MEMORY
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.blender.ownership import remove_owned
from crowd_lod_extension.operators.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.characters.stored_groups import store_groups
from crowd_lod_extension.operators.lod_meshes.make_lods import make_levels
from crowd_lod_extension.operators.render_setup import bake, render_setup
from crowd_lod_extension.operators.render_setup.cost_estimate import FULL, estimate
from crowd_lod_extension.operators.render_setup.shelves import LIBRARY

from ..support.characters import character, new, painted, rig, skin, tube

SIZE = 1024


def picture(name, size=SIZE, **kind):
    """A new image of broad waves and a fine checker, of bytes unless it is of another `kind`."""
    image = bpy.data.images.new(name, size, size, **kind)
    y, x = np.mgrid[:size, :size] / size
    values = np.ones((size, size, 4), np.float32)
    values[..., 0] = 0.5 + 0.3 * np.sin(40 * x)
    values[..., 1] = 0.5 + 0.3 * np.sin(50 * y)
    values[..., 2] = 0.4 + 0.2 * ((np.mgrid[:size, :size].sum(axis=0) // 4) % 2)
    image.pixels.foreach_set(values.ravel())
    image.update()
    image.pack()
    return image


@pytest.fixture
def crowd():
    """A crowd of one character with an image, three LODs by distance, in front of a camera that
    looks down a long field.
    """
    scene = bpy.context.scene
    item = new("body", tube("body"))
    item.data.materials.append(painted("skin", picture("cloth")))
    skin(item, rig())
    character(item)
    scene.collection.children["People"].hide_render = True
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.location = (0, -70, 4)
    camera.rotation_euler = (1.52, 0, 0)
    camera.data.clip_end = 200
    light = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    scene.collection.objects.link(light)
    light.rotation_euler = (0.8, 0.2, 0)
    light.data.energy = 3
    render = scene.render
    render.resolution_x = 320
    render.resolution_y = 180
    render.engine = "CYCLES"
    scene.cycles.samples = 16
    scene.view_settings.view_transform = "Standard"
    scene.frame_end = 3
    settings = scene.crowd_lod
    settings.count = 60
    settings.size = (20, 60)
    settings.level_count = 3
    settings.thresholds[:2] = (0.15, 0.4)
    store_groups(settings, measure_groups(scene))
    list(make_levels(scene))
    return scene


def rendered(scene, path):
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return image_data.load_pixels(path)[..., :3] / 255


def images_of_build(scene):
    """The images that the build's characters show, by LOD."""
    shelves = next(child for child in scene.crowd_lod.build.children if LIBRARY in child).children
    found = {}
    for shelf in (shelf for shelf in shelves if LIBRARY in shelf):
        materials = {slot.material for item in shelf.all_objects for slot in item.material_slots}
        found[shelf[LIBRARY]] = {
            node.image for m in materials for node in m.node_tree.nodes if node.type == "TEX_IMAGE"
        }
    return found


def contents():
    """What the file holds of images, materials, meshes and node groups."""
    kinds = bpy.data.images, bpy.data.materials, bpy.data.meshes, bpy.data.node_groups
    return sorted(block.name for kind in kinds for block in kind if block.name != "Render Result")


@pytest.mark.once
def test_far_lods_show_scaled_images_and_look_the_same(crowd, tmp_path):
    before = contents()
    finished(render_setup.build(crowd))
    unscaled = contents()
    plain = rendered(crowd, tmp_path / "plain.png")
    crowd.crowd_lod.scale_textures = True
    for _ in range(2):  # the second takes the place of the first
        cast = finished(render_setup.build(crowd))
        images = images_of_build(crowd)
        sizes = {level: [tuple(image.size) for image in own] for level, own in images.items()}
        assert sizes == {0: [(1024, 1024)], 1: [(64, 64)], 2: [(32, 32)]}
        assert cast.images == (4 * 1024**2, 4 * (1024**2 + 64**2 + 32**2))
        assert (
            len(contents()) == len(unscaled) + 6
        )  # an image, a material and a mesh of each far LOD
    meshes = [item.data for level in crowd.crowd_lod.levels.children for item in level.all_objects]
    assert {material.name for mesh in meshes for material in mesh.materials} == {"skin"}
    difference = np.abs(plain - rendered(crowd, tmp_path / "scaled.png"))
    shown = plain.max(axis=2) > 0.02
    assert 1000 < shown.sum() and 0 < difference[shown].mean() < 0.01
    crowd.crowd_lod.scale_textures = False
    assert finished(render_setup.build(crowd)).images is None
    assert contents() == unscaled
    render_setup.remove_build(crowd.crowd_lod)
    assert contents() == before


def test_images_are_in_what_builds_are_said_to_cost(crowd):
    node = next(
        node for node in bpy.data.materials["skin"].node_tree.nodes if node.type == "TEX_IMAGE"
    )
    image = node.image
    node.image = None
    bare = finished(estimate(crowd, crowd.crowd_lod)).prices
    node.image = image
    found = finished(estimate(crowd, crowd.crowd_lod))
    for name, own in found.prices.items():
        memory = MEMORY[found.costs.engine]
        assert own.memory - bare[name].memory == pytest.approx(
            memory["images"] * 4 * SIZE**2 + memory["image_count"]
        )
        assert own.seconds - bare[name].seconds == pytest.approx(
            found.costs.seconds["images"] * 4 * SIZE**2
        )
    crowd.crowd_lod.scale_textures = True
    for known in (False, True):
        works = finished(estimate(crowd, crowd.crowd_lod, [1], known)).works
        cast = finished(bake.bake(crowd, [1]) if known else render_setup.build(crowd))
        assert works[FULL].images == 4 * SIZE**2 and works["By Distance"].images == cast.images[1]


@pytest.mark.once
@pytest.mark.skipif(
    sys.platform != "linux", reason="reads a process's peak memory from Linux's /proc"
)
def test_bake_of_far_agents_renders_without_the_full_image(crowd, tmp_path):
    """Peak memory of a render in a process of its own, of an image of 2048 x 2048, 16 MB.

    The file is without the characters and LOD meshes themselves, of whose materials Cycles of
    Blender 5.2 loads all images, hidden or not: the scene's settings name them.
    """
    image = picture("large", 2048)
    image.filepath_raw = str(tmp_path / "large.png")
    image.file_format = "PNG"
    image.save()
    next(
        node for node in bpy.data.materials["skin"].node_tree.nodes if node.type == "TEX_IMAGE"
    ).image = bpy.data.images.load(image.filepath_raw)
    crowd.cycles.samples = 1
    crowd.render.resolution_percentage = 10
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "crowd.blend"))
    code = (
        "import bpy, sys; bpy.ops.wm.open_mainfile(filepath=sys.argv[1]); bpy.ops.render.render(); "
        "print('peak', open('/proc/self/status').read().split('VmHWM:')[1].split()[0])"
    )
    peak = {}
    for scaling in (False, True):
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "crowd.blend"))
        scene = bpy.context.scene
        settings = scene.crowd_lod
        path = tmp_path / f"{scaling}.blend"
        settings.scale_textures = scaling
        cast = finished(bake.bake(scene, [1]))
        remove_owned(settings.levels)
        bpy.data.batch_remove(
            [*settings.characters.all_objects, *settings.characters.children, settings.characters]
        )
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
        said = subprocess.run(
            [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True
        ).stdout
        peak[scaling] = 1024 * int(said.split("peak ")[1].split()[0])
    assert cast.images[0] == 4 * 2048**2 and cast.images[1] < 100_000
    assert 12e6 < peak[False] - peak[True]


def test_what_cannot_be_scaled_stays_and_is_named(crowd):
    """A normal map in a group, floats, an image placed by a group's input, a palette, and five
    kinds that stay.
    """
    material = bpy.data.materials["skin"]
    stays = {}
    tree = material.node_tree
    group = bpy.data.node_groups.new("inner", "ShaderNodeTree")
    group.interface.new_socket("Place", in_out="INPUT", socket_type="NodeSocketVector")
    entry = group.nodes.new("NodeGroupInput")
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    tree.links.new(tree.nodes.new("ShaderNodeUVMap").outputs["UV"], node.inputs["Place"])
    scaling = {"normal": {"is_data": True}, "light": {"float_buffer": True}, "placed": {}}
    for name, kind in scaling.items():
        inner = group.nodes.new("ShaderNodeTexImage")
        inner.image = picture(name, 256, **kind)
    group.links.new(entry.outputs["Place"], inner.inputs["Vector"])
    for name, source in (
        ("tiles", "TILED"),
        ("film", "MOVIE"),
        ("frames", "SEQUENCE"),
        ("lost", "FILE"),
        ("round", "GENERATED"),
    ):
        other = tree.nodes.new("ShaderNodeTexImage")
        other.image = stays[name] = bpy.data.images.new(name, 64, 64)
        other.image.source = source
    tree.links.new(
        tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], other.inputs["Vector"]
    )
    crowd.crowd_lod.scale_textures = True
    cast = finished(render_setup.build(crowd))
    assert cast.notes[-1] == (
        "Images in full: tiles (UDIM tiles), film (a movie), frames (a sequence), lost (no "
        "pixels), round (not placed by a UV map alone)."
    )
    assert set(stays.values()) <= images_of_build(crowd)[2]
    assert {inner.image.name for inner in group.nodes if inner.type == "TEX_IMAGE"} == set(scaling)
    shelf = next(child for child in bpy.data.collections if child.get(LIBRARY) == 2)
    own = {slot.material for item in shelf.all_objects for slot in item.material_slots}
    (copied,) = {each.node_tree for m in own for each in m.node_tree.nodes if each.type == "GROUP"}
    found = {inner.image.name: inner.image for inner in copied.nodes if inner.type == "TEX_IMAGE"}
    assert sorted(found) == ["light / 8", "normal / 8", "placed / 8"]
    assert found["light / 8"].is_float and found["normal / 8"].colorspace_settings.is_data
    for name, kind in scaling.items():
        values, own = (
            image_data.read_values(each) for each in (bpy.data.images[name], found[f"{name} / 8"])
        )
        mean = values.reshape(32, 8, 32, 8, 4).mean(axis=(1, 3))
        assert (
            np.abs(mean - own).max() < (1e-6 if "float_buffer" in kind else 0.002)
            or name == "placed"
        )
    render_setup.remove_build(crowd.crowd_lod)
    assert not [name for name in contents() if "/ 8" in name] and [
        each.name for each in bpy.data.node_groups
    ] == ["inner"]


def test_scaled_images_are_in_the_file(crowd, tmp_path):
    crowd.crowd_lod.scale_textures = True
    finished(render_setup.build(crowd))
    before = {
        image.name: image_data.read_values(image).copy()
        for own in images_of_build(crowd).values()
        for image in own
    }
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "crowd.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "crowd.blend"))
    assert len(before) == 3
    for name, values in before.items():
        np.testing.assert_array_equal(image_data.read_values(bpy.data.images[name]), values)
