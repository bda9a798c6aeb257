"""Pictures of who is seen: exact ids, holes kept, and the file as it was."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.validation.id_pictures import NOBODY
from crowd_lod_extension.operators.blender.materials import switch_nodes_on
from crowd_lod_extension.operators.deliver.proof import id_pictures
from crowd_lod_extension.operators.deliver.proof.id_pictures import render_ids

from ..support.characters import new
from ..support.nodes import geometry_nodes
from ..support.objects import filmed_from, lamp, mesh_of, placed

IDS = 0, 70_001, 4_000_001  # of agents at x = -2, 0, 2 m
WIDE = 60  # pixels of 0.1 m


@pytest.fixture
def row():
    """Three square agents of 0.8 m and a square that is none, from above; a lamp in sight."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 8
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.render.resolution_x, scene.render.resolution_y = WIDE, 30
    scene.render.resolution_percentage = 100
    scene.render.use_motion_blur = True
    corners = [(-0.4, -0.4, 0), (0.4, -0.4, 0), (0.4, 0.4, 0), (-0.4, 0.4, 0)]
    square = mesh_of("square", corners, [(0, 1, 2, 3)])
    uv = square.uv_layers.new(name="uv")
    uv.data.foreach_set("uv", [0, 0, 1, 0, 1, 1, 0, 1])
    points = mesh_of("points", [(x, 0, 0) for x in (-2, 0, 2)])
    points.attributes.new("id", "INT", "POINT").data.foreach_set("value", IDS)
    points.attributes.new("looks", "FLOAT", "POINT")
    tree, given, info, instances, end = geometry_nodes(
        placed("crowd", points), "GeometryNodeObjectInfo", "GeometryNodeInstanceOnPoints"
    )
    info.inputs["Object"].default_value = new("square", square)
    tree.links.new(given.outputs[0], instances.inputs["Points"])
    tree.links.new(info.outputs["Geometry"], instances.inputs["Instance"])
    tree.links.new(instances.outputs[0], end.inputs[0])
    placed("stranger", square, location=(0, 1, 0))
    lamp("AREA", (2, -1, 1), (np.pi, 0, 0), size=0.5)  # its light side up
    camera = filmed_from((0, 0, 5), type="ORTHO", ortho_scale=0.1 * WIDE)
    camera.data.dof.use_dof = True
    return scene


def dressed(kind=None):
    """The square's material, with its nodes and the surface's input."""
    material = bpy.data.materials.new("cloth")
    tree = switch_nodes_on(material)
    bpy.data.meshes["square"].materials.append(material)
    output = tree.get_output_node("CYCLES")
    if kind is not None:
        shader = tree.nodes.new(kind)
        tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return tree, output.inputs["Surface"]


def stripes(tree):
    """A socket that is 1 on the right half of the square, 0 on the left."""
    uv = tree.nodes.new("ShaderNodeTexCoord")
    separate = tree.nodes.new("ShaderNodeSeparateXYZ")
    step = tree.nodes.new("ShaderNodeMath")
    step.operation = "GREATER_THAN"
    tree.links.new(uv.outputs["UV"], separate.inputs[0])
    tree.links.new(separate.outputs[0], step.inputs[0])
    return step.outputs[0]


def plain():
    dressed()


def none():
    """No material at all."""


def empty_slot():
    bpy.data.meshes["square"].materials.append(None)


def half_by_alpha():
    tree, surface = dressed()
    tree.links.new(stripes(tree), surface.links[0].from_node.inputs["Alpha"])


def half_by_mix():
    tree, surface = dressed("ShaderNodeMixShader")
    mix = surface.links[0].from_node
    for place, kind in ((1, "ShaderNodeBsdfTransparent"), (2, "ShaderNodeBsdfDiffuse")):
        tree.links.new(tree.nodes.new(kind).outputs[0], mix.inputs[place])
    tree.links.new(stripes(tree), mix.inputs[0])


def half_in_groups():
    """A group in a group, of which the inner one mixes, that another material has, too."""
    half_by_mix()
    inner, outer = (bpy.data.node_groups.new(name, "ShaderNodeTree") for name in "ab")
    for tree in (inner, outer):
        tree.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    end = inner.nodes.new("NodeGroupOutput")
    mix = inner.nodes.new("ShaderNodeMixShader")
    inner.links.new(inner.nodes.new("ShaderNodeBsdfTransparent").outputs[0], mix.inputs[1])
    inner.links.new(inner.nodes.new("ShaderNodeEmission").outputs[0], mix.inputs[2])
    inner.links.new(stripes(inner), mix.inputs[0])
    inner.links.new(mix.outputs[0], end.inputs[0])
    within = outer.nodes.new("ShaderNodeGroup")
    within.node_tree = inner
    outer.links.new(within.outputs[0], outer.nodes.new("NodeGroupOutput").inputs[0])
    for material in (bpy.data.materials["cloth"], bpy.data.materials.new("other")):
        tree = switch_nodes_on(material)
        group = tree.nodes.new("ShaderNodeGroup")
        group.node_tree = outer
        tree.links.new(group.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])


def half_by_color():
    tree, surface = dressed("ShaderNodeBsdfTransparent")
    invert = tree.nodes.new("ShaderNodeInvert")
    tree.links.new(stripes(tree), invert.inputs["Color"])
    tree.links.new(invert.outputs[0], surface.links[0].from_node.inputs["Color"])


def glass():
    tree, surface = dressed("ShaderNodeAddShader")
    for place, kind in ((0, "ShaderNodeEmission"), (1, "ShaderNodeBsdfTransparent")):
        tree.links.new(tree.nodes.new(kind).outputs[0], surface.links[0].from_node.inputs[place])


def muted():
    half_by_mix()
    next(
        n for n in bpy.data.materials["cloth"].node_tree.nodes if n.type == "MIX_SHADER"
    ).mute = True


WHOLE, HALF, NOTHING = 64, 32, 0


@pytest.mark.parametrize(
    "dress, seen",
    [
        (plain, WHOLE),
        (none, WHOLE),
        (empty_slot, WHOLE),
        (glass, WHOLE),
        (half_by_alpha, HALF),
        (half_by_mix, HALF),
        (half_by_color, HALF),
        (half_in_groups, HALF),
        (muted, NOTHING),
    ],
)
def test_agents_are_seen_where_their_material_is_opaque(row, tmp_path, dress, seen):
    dress()
    before = looks_of_file()
    (ids,) = finished(render_ids(row, 1, tmp_path))
    assert looks_of_file() == before and not list(tmp_path.iterdir())
    assert ids.shape == (30, WIDE) and ids.dtype == np.int32
    found = {agent: int((ids == agent).sum()) for agent in np.unique(ids).tolist()}
    assert found.pop(NOBODY) and found == ({agent: seen for agent in IDS} if seen else {})
    if seen:
        column = np.nonzero(ids == IDS[0])[1]
        assert column.max() == 13 and column.min() == (6 if seen == WHOLE else 10)


def test_finer_ids_in_tiles_of_two_eyes_are_those_of_one_picture(row, tmp_path, monkeypatch):
    dressed()
    (coarse,) = finished(render_ids(row, 1, tmp_path))
    (fine,) = finished(render_ids(row, 3, tmp_path))
    assert np.array_equal(fine[1::3, 1::3], coarse)
    monkeypatch.setattr(id_pictures, "MOST", 3 * WIDE * 7)  # seven rows a tile
    (tiled,) = finished(render_ids(row, 3, tmp_path))
    assert np.array_equal(tiled, fine)
    if bpy.app.version >= (5, 2, 0):
        row.render.use_multiview = True
        row.render.image_settings.views_format = "INDIVIDUAL"
        left, right = finished(render_ids(row, 1, tmp_path))
        assert left.shape == right.shape == coarse.shape


def looks_of_file():
    """What may change: the names of all data-blocks, nodes and links, and settings of renders."""
    trees = [material.node_tree for material in bpy.data.materials if material.node_tree]
    groups = list(bpy.data.node_groups)
    scene = bpy.context.scene
    return (
        sorted({block.name for block in bpy.data.user_map()} - {"Render Result"}),
        [
            (
                [(node.name, getattr(node, "node_tree", None)) for node in tree.nodes],
                sorted(
                    (link.from_node.name, link.from_socket.identifier, link.to_socket.identifier)
                    for link in tree.links
                ),
                [socket.name for socket in tree.interface.items_tree],
            )
            for tree in (*trees, *groups)
        ],
        [list(mesh.materials) for mesh in bpy.data.meshes],
        (scene.render.resolution_x, scene.render.resolution_y),
        scene.world,
        scene.cycles.samples,
        scene.cycles.pixel_filter_type,
        scene.render.use_motion_blur,
        scene.render.film_transparent,
        scene.render.use_border,
        scene.camera.data.dof.use_dof,
    )
