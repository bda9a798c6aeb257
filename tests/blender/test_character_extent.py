"""A character's sphere holds all that a render shows of it, judged by the pixels of renders."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.blender.evaluation import as_rendered
from crowd_lod_extension.operators.blender.materials import switch_nodes_on
from crowd_lod_extension.operators.build import frame_update
from crowd_lod_extension.operators.lods.deviation import measure_levels
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene import plausible
from crowd_lod_extension.operators.scene.characters import group_measuring, stored_groups
from crowd_lod_extension.operators.scene.characters.characters import characters_of
from mathutils import Matrix

from ..support.characters import character, new, rig, rigged, skin, tube
from ..support.messages import sentences, told
from ..support.nodes import geometry_nodes
from ..support.objects import box_mesh, filmed_from, mesh_of
from ..support.rigs import keyed

# of the picture; meters that it shows
PIXELS = 64
WIDTH = 12.0


def lit(tmp_path, height, frames=(1,)):
    """(n, 2) meters to the right and up from the `height` above the scene's origin: the pixels that
    renders from the side show.
    """
    scene = bpy.context.scene
    filmed_from((0, -20, height), (np.pi / 2, 0, 0), type="ORTHO", ortho_scale=WIDTH)
    render = scene.render
    render.engine = "CYCLES"
    scene.cycles.samples = 1
    scene.cycles.use_denoising = False
    render.resolution_x = render.resolution_y = PIXELS
    render.film_transparent = True
    render.image_settings.color_mode = "RGBA"
    render.filter_size = 0.01
    render.filepath = str(tmp_path / "picture.png")
    found = []
    for frame in frames:
        scene.frame_set(frame)
        bpy.ops.render.render(write_still=True)
        row, column = np.nonzero(image_data.load_pixels(tmp_path / "picture.png")[..., 3])
        found.append(np.column_stack([column, row]) + 0.5 - PIXELS / 2)
    return np.concatenate(found) * WIDTH / PIXELS


def in_renders_only(body):
    array = body.modifiers.new("Array", "ARRAY")
    array.count = 3
    array.use_relative_offset = False
    array.use_constant_offset = True
    array.constant_offset_displace = (1.5, 0, 0)
    array.show_viewport = False
    return array


def finer_in_renders(body):
    """A tile whose middle, which only renders have, is pulled up."""
    mesh = mesh_of("tile", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2, 3)])
    tile = new("tile", mesh)
    finer = tile.modifiers.new("Finer", "SUBSURF")
    finer.subdivision_type = "SIMPLE"
    finer.levels = 0
    finer.render_levels = 3
    pull = tile.modifiers.new("Pull", "DISPLACE")
    pull.texture = bpy.data.textures.new("round", "BLEND")
    pull.direction = "Z"
    pull.strength = 5
    pull.mid_level = 0
    pull.texture.progression = "SPHERICAL"
    body.users_collection[0].objects.link(tile)


def keyed_in_renders(body):
    array = in_renders_only(body)
    array.show_render = False
    keyed(array, "show_render", True, 8)
    array.show_viewport = False
    array.keyframe_insert("show_viewport", frame=1)


def driven_in_renders(body):
    in_renders_only(body).driver_add("show_render").driver.expression = "frame > 4"
    keyed(body, "location", (0, 0, 0.1), 9)


def hidden_in_the_viewport(body):
    part = new("hat", tube("hat", 8, 8))
    part.location.z = 2
    part.hide_viewport = True
    body.users_collection[0].objects.link(part)


def hidden_at_times(body):
    hidden_in_the_viewport(body)
    part = bpy.data.objects["hat"]
    part.hide_viewport = False
    keyed(part, "hide_viewport", True, 3)
    keyed(part, "location", (0, 0, 3), 9)


def in_a_hidden_collection(body):
    hidden_in_the_viewport(body)
    part = bpy.data.objects["hat"]
    home = bpy.data.collections.new("hats")
    part.hide_viewport = False
    body.users_collection[0].children.link(home)
    body.users_collection[0].objects.unlink(part)
    home.objects.link(part)
    home.hide_viewport = True


def hair(body):
    data = bpy.data.hair_curves.new("hair")
    data.add_curves([3, 3])
    data.position_data.foreach_set(
        "vector",
        np.float32([(0, 0, 2), (0.5, 0, 3), (2, 0, 3), (0, 0, 2), (0, 0, 3), (0, 0, 4)]).ravel(),
    )
    data.attributes.new("radius", "FLOAT", "POINT").data.foreach_set(
        "value", np.full(6, 0.4, np.float32)
    )
    body.users_collection[0].objects.link(new("hair", data))


def material(body, method="DISPLACEMENT"):
    made = bpy.data.materials.new("skin")
    made.displacement_method = method
    body.data.materials.append(made)
    return switch_nodes_on(made)


def displaced_by(tree, height=None):
    node = tree.nodes.new("ShaderNodeDisplacement")
    node.inputs["Scale"].default_value = 2.0
    node.inputs["Midlevel"].default_value = 0.0
    node.inputs["Height"].default_value = 0.75
    if height is not None:
        tree.links.new(height, node.inputs["Height"])
    tree.links.new(
        node.outputs[0],
        next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL").inputs["Displacement"],
    )
    return node


def displaced(body):
    displaced_by(material(body))


def displaced_by_a_ramp(body):
    tree = material(body)
    noise = tree.nodes.new("ShaderNodeTexNoise")
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    noise.inputs["Scale"].default_value = 20.0
    tree.links.new(noise.outputs[0], ramp.inputs[0])
    for element, value in zip(ramp.color_ramp.elements, (0.7, 0.8), strict=True):
        element.color = (value, value, value, 1)
    displaced_by(tree, ramp.outputs[0])


CASES = [
    in_renders_only,
    finer_in_renders,
    keyed_in_renders,
    driven_in_renders,
    hidden_in_the_viewport,
    hidden_at_times,
]
CASES += [in_a_hidden_collection, hair, displaced, displaced_by_a_ramp]


@pytest.mark.parametrize("case", CASES)
def test_a_sphere_holds_all_that_a_render_shows(case, tmp_path):
    body = new("body", tube("body", 8, 8))
    character(body)
    bare = group_measuring.measure_groups(bpy.context.scene)[0]
    case(body)
    (group,) = group_measuring.measure_groups(bpy.context.scene)
    shown = np.linalg.norm(lit(tmp_path, group.feet + group.center, range(1, 10, 4)), axis=1).max()
    assert bare.radius + 0.2 < shown <= group.radius + WIDTH / PIXELS
    assert group.radius < 1.6 * shown, "and not much more"


def test_the_plans_sphere_holds_lods_that_stick_out_of_the_character(tmp_path):
    body = new("body", tube("body", 8, 8))
    home = character(body)
    scene = bpy.context.scene
    scene.crowd_lod.level_count = 2
    list(make_levels(scene))
    level = scene.crowd_lod.levels.children[1].children[0].objects[0]
    level.data.transform(Matrix.Diagonal((3, 1, 2, 1)))  # an edited LOD
    list(measure_levels(scene))
    (group,) = stored_groups.groups_of(scene.crowd_lod)
    home.hide_render = True
    scene.collection.objects.link(level)
    shown = np.linalg.norm(lit(tmp_path, group.feet + group.center), axis=1).max()
    assert 2.5 < shown <= group.reach + WIDTH / PIXELS


def asks_is_viewport(body):
    tree, begin, _, end = geometry_nodes(body, "GeometryNodeIsViewport")
    tree.links.new(begin.outputs[0], end.inputs[0])
    return "body", "use the node Is Viewport"


def displaced_by_noise(body):
    tree = material(body)
    displaced_by(tree, tree.nodes.new("ShaderNodeTexNoise").outputs[0])
    return "skin", "by an unlimited height"


@pytest.mark.parametrize("case", [asks_is_viewport, displaced_by_noise])
def test_what_a_render_alone_knows_is_named_with_a_margin(case):
    body = new("body", tube("body", 8, 8))
    character(body)
    named = case(body)
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    said = " ".join(
        sentences(
            plausible.notes_on_extent(
                bpy.context.scene,
                characters_of(bpy.context.scene),
                stored_groups.groups_of(bpy.context.scene.crowd_lod),
            )
        )
    )
    assert all(part in said for part in named) and "Margin to Fixed, 1.53 m or more" in said
    for made in bpy.data.materials:
        made.max_vertex_displacement = 0.5  # the user bounds it
    for made in bpy.data.node_groups:
        made.nodes.remove(made.nodes["Is Viewport"])
    assert not list(
        plausible.notes_on_extent(
            bpy.context.scene,
            characters_of(bpy.context.scene),
            stored_groups.groups_of(bpy.context.scene.crowd_lod),
        )
    )
    assert group_measuring.measure_groups(bpy.context.scene)[0].radius == pytest.approx(
        1.02 + 0.5 * bool(bpy.data.materials), abs=0.01
    )


def test_a_bump_is_no_displacement():
    body = new("body", tube("body", 8, 8))
    character(body)
    displaced_by(material(body, "BUMP"))
    assert group_measuring.measure_groups(bpy.context.scene)[0].radius == pytest.approx(
        1.02, abs=0.01
    )


@pytest.fixture
def sunk():
    """A crowd of one who stands half in the ground, and bends."""
    scene = bpy.context.scene
    body, armature = rigged("body", 8, 8)
    character(body, armature, name="giraffe").instance_offset = (0, 0, 1)
    settings = scene.crowd_lod
    settings.count = 1
    settings.size = (0.001, 0.001)
    settings.level_count = 2
    scene.render.fps = 24
    return scene


def pictured(scene, tmp_path):
    """Meters above the ground, of the lowest that a render of the built crowd shows."""
    scene.frame_set(1)
    return lit(tmp_path, 1.0)[:, 1].min() + 1.0


@pytest.mark.once
def test_new_crowds_stand_on_their_lowest_point(sunk, tmp_path):
    settings = sunk.crowd_lod
    lit(tmp_path, 1.0)  # a camera
    bpy.ops.crowd_lod.populate()
    (entry,) = settings.groups
    assert (
        entry.on_ground
        and entry.lowest == pytest.approx(-1)
        and entry.center == pytest.approx(1.0, abs=0.01)
    )
    said = " ".join(sentences(plausible.notes_on_feet(sunk, stored_groups.groups_of(settings))))
    assert said == "giraffe was raised by 1 m, so that its feet touch the ground."
    bpy.ops.crowd_lod.build()
    settings.characters.hide_render = True
    assert pictured(sunk, tmp_path) == pytest.approx(0, abs=WIDTH / PIXELS)
    entry.on_ground = False
    assert entry.center == pytest.approx(0.0, abs=0.01)
    assert "Feet do not touch the ground (giraffe: raise by 1 m): tick Stand on Ground" in " ".join(
        sentences(plausible.notes_on_feet(sunk, stored_groups.groups_of(settings)))
    )
    with pytest.raises(CrowdError, match="press Build again"):
        frame_update.update(sunk, bpy.context.evaluated_depsgraph_get())
    bpy.ops.crowd_lod.build()
    assert pictured(sunk, tmp_path) == pytest.approx(-1, abs=WIDTH / PIXELS)
    entry.on_ground = True
    settings.characters.children[0].instance_offset.z = 0.5
    bpy.ops.crowd_lod.populate()
    bpy.ops.crowd_lod.build()
    assert entry.lowest == pytest.approx(-0.5) and pictured(sunk, tmp_path) == pytest.approx(
        0, abs=WIDTH / PIXELS
    )


@pytest.mark.once
def test_crowds_of_today_keep_their_feet(sunk, tmp_path):
    settings = sunk.crowd_lod
    lit(tmp_path, 1.0)
    settings.groups.add().name = "giraffe"  # as an earlier version stored it
    bpy.ops.crowd_lod.populate()
    bpy.ops.crowd_lod.build()
    settings.characters.hide_render = True
    assert (
        settings.groups[0].center == pytest.approx(0, abs=0.01) and not settings.groups[0].on_ground
    )
    assert pictured(sunk, tmp_path) == pytest.approx(-1, abs=WIDTH / PIXELS)


def test_a_step_of_two_percent_is_none(sunk):
    sunk.crowd_lod.characters.children[0].instance_offset.z = 0.03
    assert group_measuring.measure_groups(sunk)[0].lowest == 0


def test_rounding_of_a_flat_character_lifts_nobody(sunk):
    bpy.data.objects["body"].data.transform(Matrix.Diagonal((1, 1, 0, 1)))
    sunk.crowd_lod.characters.children[0].instance_offset.z = 2.18e-7
    bpy.ops.crowd_lod.populate()
    assert sunk.crowd_lod.groups[0].lowest == 0 and "ground" not in told(sunk)


def test_nobody_stands_on_what_is_in_a_hand():
    """A crossbow that hangs below the feet, and is wider than they are."""
    scene = bpy.context.scene
    armature = rig("archer")
    armature.data.bones["upper"].name = "handslot.r"
    body = new("body", tube("body", 12, 6))
    skin(body, armature)
    body.vertex_groups["upper"].name = "handslot.r"
    weapon = new("crossbow", box_mesh("crossbow", (-0.5, -0.5, -0.5), (0.5, 0.5, 0.3)))
    character(body, weapon)
    scene.collection.objects.link(armature)
    weapon.parent = armature
    weapon.parent_type = "BONE"
    weapon.parent_bone = "handslot.r"
    bpy.context.view_layer.update()
    weapon.matrix_world = Matrix.Identity(4)
    scene.crowd_lod.count = 1
    bpy.ops.crowd_lod.populate()
    assert scene.crowd_lod.groups[0].lowest == pytest.approx(0, abs=0.05)


def test_hair_that_is_simulated_stays_within_its_length_of_its_roots():
    """In any order of frames: a simulation would go on from the pose before."""
    body, armature = rigged("body", 8, 8)
    character(body, armature)
    hair(body)
    item = next(item for item in body.users_collection[0].objects if item.type == "CURVES")
    flying_off(item)
    groups = [group_measuring.measure_groups(bpy.context.scene)[0] for _ in range(2)]
    assert groups[0] == groups[1]
    root, length, radius = 2.0, np.hypot(0.5, 1.0) + 1.5, 0.4
    reach = length + radius
    group, _ = groups
    assert root + reach <= group.center + group.radius < root + reach + 0.05  # the body bends
    with as_rendered([item], hair_swings=False) as (_, actors):
        assert [*actors[item].modifiers] == []
    with as_rendered([item]) as (_, actors):
        assert actors[item] == item
    assert len(item.modifiers) == 1


def flying_off(item):
    """Nodes that move hair a meter up in each frame, as a simulation does."""
    kinds = "SimulationInput", "SetPosition", "SimulationOutput"
    tree, first, begin, move, end, last = geometry_nodes(
        item, *(f"GeometryNode{kind}" for kind in kinds)
    )
    begin.pair_with_output(end)
    move.inputs["Offset"].default_value = (0, 0, 1)
    for one, other in ((first, begin), (begin, move), (move, end), (end, last)):
        tree.links.new(one.outputs["Geometry"], other.inputs["Geometry"])
