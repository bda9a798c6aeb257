"""Which materials hide what is behind them: what their output gets decides."""

import bpy
import pytest
from crowd_lod_extension.operators.blender.materials import (
    hides_in_all_engines,
    is_opaque,
    switch_nodes_on,
)


def made_of(*kinds):
    """A material whose output gets these shaders, mixed if there are two."""
    material = bpy.data.materials.new("shown")
    switch_nodes_on(material)
    tree = material.node_tree
    tree.nodes.clear()
    shaders = [tree.nodes.new(kind) for kind in kinds]
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    end = shaders[0]
    if len(shaders) > 1:
        end = tree.nodes.new("ShaderNodeMixShader")
        for k, shader in enumerate(shaders):
            tree.links.new(shader.outputs[0], end.inputs[1 + k])
    tree.links.new(end.outputs[0], output.inputs["Surface"])
    return material, shaders


def stray(kind):
    material, _ = made_of("ShaderNodeBsdfPrincipled")
    material.node_tree.nodes.new(kind)
    return material


def with_value(name, value):
    material, (shader,) = made_of("ShaderNodeBsdfPrincipled")
    shader.inputs[name].default_value = value
    return material


def one_sided():
    material, _ = made_of("ShaderNodeBsdfPrincipled")
    material.use_backface_culling = True
    return material


OPAQUE = {
    "none": lambda: None,
    "new": lambda: bpy.data.materials.new("shown"),  # without nodes in Blender 4.5
    "principled": lambda: made_of("ShaderNodeBsdfPrincipled")[0],
    "a stray transparent node": lambda: stray("ShaderNodeBsdfTransparent"),
    "a stray glass node": lambda: stray("ShaderNodeBsdfGlass"),
    "translucent": lambda: made_of("ShaderNodeBsdfTranslucent")[0],
    "a color that shines": lambda: made_of("ShaderNodeRGB")[0],
    "two opaque shaders": lambda: made_of("ShaderNodeBsdfDiffuse", "ShaderNodeBsdfGlossy")[0],
}
CLEAR = {
    "glass": lambda: made_of("ShaderNodeBsdfGlass")[0],
    "a mix with transparent": lambda: made_of("ShaderNodeBsdfDiffuse", "ShaderNodeBsdfTransparent")[
        0
    ],
    "alpha": lambda: with_value("Alpha", 0.5),
    "transmission": lambda: with_value("Transmission Weight", 0.5),
}


@pytest.mark.parametrize("name", OPAQUE)
def test_what_reaches_the_output_hides(name):
    material = OPAQUE[name]()
    assert is_opaque(material) and hides_in_all_engines(material)


@pytest.mark.parametrize("name", CLEAR)
def test_what_lets_rays_through_hides_nothing(name):
    material = CLEAR[name]()
    assert not is_opaque(material) and not hides_in_all_engines(material)


def test_what_shows_one_side_hides_on_that_side_alone():
    assert is_opaque(one_sided()) and not hides_in_all_engines(one_sided())


@pytest.mark.parametrize("method", ["BUMP", "DISPLACEMENT", "BOTH"])
def test_a_surface_that_is_moved_hides_nothing_for_sure_and_bumps_move_none(method):
    material, _ = made_of("ShaderNodeBsdfPrincipled")
    material.displacement_method = method
    tree = material.node_tree
    moves = tree.nodes.new("ShaderNodeDisplacement").outputs[0]
    tree.links.new(moves, tree.get_output_node("ALL").inputs["Displacement"])
    assert is_opaque(material) and hides_in_all_engines(material) == (method == "BUMP")
