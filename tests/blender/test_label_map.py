"""Label maps made in Blender: the image and its plane, the brush of a label, meshes that lay labels
over the map.
"""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators.scene.characters.group_measuring import measure_groups
from crowd_lod_extension.operators.scene.machine import map_areas
from crowd_lod_extension.operators.scene.machine.map_painting import plane_of
from crowd_lod_extension.operators.scene.machine.scene_world import machine_of, world_of
from crowd_lod_extension.operators.scene.sources.crowd_sources import combine_crowds, inputs_of

from ..support.objects import collection


@pytest.fixture
def ground():
    """A scene with the market's machine and a ground of 40 by 20 meters, off the origin."""
    bpy.ops.crowd_lod.machine_preset(name="market")
    settings = bpy.context.scene.crowd_lod
    settings.center = (10, -5, 1)
    settings.size = (40, 20)
    return bpy.context.scene


def block(x, y, size=2.0, name="Block"):
    """A cube of that size about x, y."""
    bpy.ops.mesh.primitive_cube_add(size=size, location=(x, y, 1))
    item = bpy.context.object
    item.name = name
    return item


def labels_of(scene):
    """The label of each cell, by name."""
    machine = machine_of(scene.crowd_lod)
    return np.array(machine.labels)[world_of(scene.crowd_lod, machine).labels]


def place(scene, x, y):
    """The label at a place of the ground."""
    machine = machine_of(scene.crowd_lod)
    return machine.labels[world_of(scene.crowd_lod, machine).at(np.array([x]), np.array([y]))[0]]


def make(scene):
    return map_areas.make(scene.crowd_lod, bpy.context.evaluated_depsgraph_get())


def test_a_new_map_is_of_the_first_label_and_lies_on_the_ground(ground):
    bpy.ops.crowd_lod.new_map(pixels=80)
    image = ground.crowd_lod.map_image
    plane = plane_of(ground)
    assert tuple(image.size) == (80, 40) and image.packed_file is not None
    assert set(labels_of(ground).ravel()) == {"lane"}
    bpy.context.view_layer.update()
    corners = [tuple(plane.matrix_world @ vertex.co)[:2] for vertex in plane.data.vertices]
    assert corners == [(-10, -15), (30, -15), (30, 5), (-10, 5)]
    assert plane.hide_render and ground.crowd_lod_editor.show_map
    texture = next(
        node for node in plane.data.materials[0].node_tree.nodes if node.type == "TEX_IMAGE"
    )
    assert texture.image == image and texture.interpolation == "Closest"


def test_the_plane_shows_pixels_where_the_crowd_has_them(ground):
    bpy.ops.crowd_lod.new_map(pixels=8)
    image = ground.crowd_lod.map_image
    plane = plane_of(ground)
    uv = {
        tuple(plane.data.vertices[loop.vertex_index].co)[:2]: tuple(
            plane.data.uv_layers[0].data[loop.index].uv
        )
        for loop in plane.data.loops
    }
    assert uv == {(-20, -10): (0, 0), (20, -10): (1, 0), (20, 10): (1, 1), (-20, 10): (0, 1)}
    values = list(image.pixels)
    values[4 * 7 : 4 * 7 + 3] = (
        0x40 / 255,
        0x38 / 255,
        0x38 / 255,
    )  # of the first row the last pixel
    image.pixels = values
    assert place(ground, 29, -14) == "wall" and place(ground, -9, -14) == "lane"


def test_the_map_is_hidden_and_shown_as_the_option_says_and_keeps_one_plane(ground):
    editor = ground.crowd_lod_editor
    editor.show_map = True
    assert plane_of(ground) is None  # there is no map
    bpy.ops.crowd_lod.new_map(pixels=8)
    editor.show_map = False
    assert plane_of(ground).hide_viewport and not editor.show_map
    ground.crowd_lod.size = (10, 10)
    editor.show_map = True
    bpy.ops.crowd_lod.new_map(pixels=16)
    assert [tuple(item.dimensions)[:2] for item in ground.objects if "crowd_lod_map" in item] == [
        (10, 10)
    ]
    assert len([mesh for mesh in bpy.data.meshes if mesh.name.startswith("Label Map")]) == 1


def test_viewports_are_colored_as_before_once_the_map_is_hidden(ground):
    window = bpy.context.window_manager.windows[0]
    shading = next(
        area.spaces.active.shading for area in window.screen.areas if area.type == "VIEW_3D"
    )
    shading.color_type = "RANDOM"
    bpy.ops.crowd_lod.new_map(pixels=8)
    bpy.ops.crowd_lod.paint_label(label="wall")
    assert shading.color_type == "TEXTURE"
    ground.crowd_lod_editor.show_map = False
    assert shading.color_type == "RANDOM"
    ground.crowd_lod_editor.show_map = True
    shading.color_type = "SINGLE"  # the user's choice since
    ground.crowd_lod_editor.show_map = False
    assert shading.color_type == "SINGLE"


def test_a_label_is_a_hard_brush_in_texture_paint(ground):
    bpy.ops.crowd_lod.new_map(pixels=8)
    other = block(0, 0)
    with pytest.raises(RuntimeError, match="no label door"):
        bpy.ops.crowd_lod.paint_label(label="door")
    assert bpy.context.object == other and other.mode == "OBJECT"
    for label in ("wall", "stall", "wall"):
        bpy.ops.crowd_lod.paint_label(label=label)
    brush = ground.tool_settings.image_paint.brush
    assert bpy.context.object == plane_of(ground) and bpy.context.object.mode == "TEXTURE_PAINT"
    assert brush.strength == 1 and not brush.use_paint_antialiasing and brush.blend == "MIX"
    assert [each.name for each in bpy.data.brushes if each.name.startswith("Crowd LOD")] == [
        "Crowd LOD Label"
    ]
    ground.crowd_lod_editor.show_map = False
    assert plane_of(ground).mode == "OBJECT"


def test_without_a_map_a_label_says_what_to_do(ground):
    with pytest.raises(RuntimeError, match="press New Map"):
        bpy.ops.crowd_lod.paint_label(label="wall")


def test_selected_meshes_lay_their_label_over_the_painted_map_and_follow(ground):
    bpy.ops.crowd_lod.new_map(pixels=80)
    item = block(10, -5, 4)
    before = inputs_of(ground)
    bpy.ops.crowd_lod.add_row(kind="areas")
    assert [(entry.name, entry.label) for entry in ground.crowd_lod.areas] == [("Block", "wall")]
    assert (
        place(ground, 10, -5) == "wall"
        and place(ground, 13, -5) == "lane"
        and inputs_of(ground) != before
    )
    assert (labels_of(ground) == "wall").sum() == 8 * 8  # 4 m of half a meter
    item.location.x = 20
    bpy.context.view_layer.update()
    make(ground)
    assert place(ground, 10, -5) == "lane" and place(ground, 20, -5) == "wall"
    ground.crowd_lod.areas[0].use = False
    make(ground)
    assert set(labels_of(ground).ravel()) == {"lane"}
    bpy.ops.crowd_lod.remove_row(kind="areas")
    assert not len(ground.crowd_lod.areas)


def test_collections_curves_and_modifiers_count_and_the_lower_area_lies_above(ground):
    settings = ground.crowd_lod
    shops = collection("Shops")
    for x in (0, 20):
        shops.objects.link(block(x, -5))
    array = shops.objects[0].modifiers.new("Array", "ARRAY")
    array.count = 2
    array.relative_offset_displace = (0, 2, 0)
    bpy.ops.curve.primitive_bezier_circle_add(radius=2, location=(20, -5, 1))
    bpy.context.object.data.dimensions = "2D"
    bpy.context.object.data.fill_mode = "BOTH"
    for name, label, item, home in (
        ("shops", "stall", None, shops),
        ("ring", "crossing", bpy.context.object, None),
    ):
        entry = settings.areas.add()
        entry.name = name
        entry.label = label
        entry.object = item
        entry.collection = home
    assert make(ground) > 0
    assert (
        place(ground, 0, -5) == "stall"
        and place(ground, 0, -1) == "stall"
        and place(ground, 0, -3.4) == "lane"
    )
    assert place(ground, 20, -5) == "crossing"
    ground.crowd_lod_editor.area_index = 1
    bpy.ops.crowd_lod.move_row(kind="areas", by=-1)
    make(ground)
    assert place(ground, 20, -5) == "stall" and place(ground, 21.6, -5) == "crossing"
    settings.areas[0].object.data.fill_mode = "NONE"  # the curve's line is left
    assert (
        make(ground) > 0
        and place(ground, 21.98, -5) == "crossing"
        and place(ground, 21.6, -5) == "lane"
    )


def test_agents_do_not_start_in_a_wall_and_the_walk_knows_it(ground, scene):
    settings = scene.crowd_lod
    settings.machine = bpy.data.texts["market.json"]
    settings.center = (0, 0, 0)
    settings.size = (40, 40)
    settings.count = 500
    block(-10, 0, 20)
    groups = measure_groups(scene)
    outside = combine_crowds(scene, groups).start
    inside = (outside.x < 0) & (np.abs(outside.y) < 10)
    bpy.ops.crowd_lod.add_row(kind="areas")
    found = combine_crowds(scene, groups)
    now = (found.start.x < 0) & (np.abs(found.start.y) < 9.9)
    assert inside.any() and not now.any() and combine_crowds(scene, groups) is found


@pytest.mark.parametrize("change, sentence", [
    (lambda entry: setattr(entry, "label", "door"), "lays the label door, which the state "
                                                    "machine lacks"),
    (lambda entry: setattr(entry, "label", ""), "lays the label without a name"),
    (lambda entry: setattr(entry, "object", None), "has no object with a surface"),
])  # fmt: skip
def test_an_area_that_cannot_be_laid_is_named(ground, change, sentence):
    block(0, 0)
    bpy.ops.crowd_lod.add_row(kind="areas")
    kept = labels_of(ground)
    change(ground.crowd_lod.areas[0])
    with pytest.raises(CrowdError, match=f"The area Block {sentence}"):
        make(ground)
    assert (labels_of(ground) == kept).all()


def test_areas_of_another_ground_are_not_trusted(ground):
    block(0, 0)
    bpy.ops.crowd_lod.add_row(kind="areas")
    ground.crowd_lod.size = (30, 20)
    with pytest.raises(CrowdError, match="laid over another ground"):
        labels_of(ground)
    make(ground)
    assert place(ground, 0, 0) == "wall"
    ground.crowd_lod_editor.label_index = 4
    ground.crowd_lod_editor.label_name = "rampart"
    assert ground.crowd_lod.areas[0].label == "rampart"
    make(ground)
    assert place(ground, 0, 0) == "rampart"


def test_an_area_off_the_ground_covers_nothing_and_edges_stay_without_a_map(ground):
    ground.crowd_lod.machine = None
    block(500, 500)
    bpy.ops.crowd_lod.add_row(kind="areas")
    ground.crowd_lod.areas[0].label = "right edge"
    assert make(ground) == 0
    columns = labels_of(ground)
    assert (columns[:, 0] == "left edge").all() and (columns[:, -1] == "right edge").all()
    assert set(columns[:, 1:-1].ravel()) == {"ground"} and columns.shape == (128, 256)


def test_areas_are_in_the_file_that_was_saved(ground, tmp_path):
    bpy.ops.crowd_lod.new_map(pixels=40)
    block(0, 0)
    bpy.ops.crowd_lod.add_row(kind="areas")
    kept = labels_of(ground)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "map.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "map.blend"))
    assert (labels_of(bpy.context.scene) == kept).all() and "wall" in kept
