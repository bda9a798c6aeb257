"""What materials look like to the overlay."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators.blender.colors import GRAY, Looks
from crowd_lod_extension.operators.blender.materials import switch_nodes_on

COLOR = 0.5, 0.25, 0.125
SRGB = 188, 137, 99  # of COLOR


def material(image=None):
    made = bpy.data.materials.new("look")
    tree = switch_nodes_on(made)
    surface = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    surface.inputs["Base Color"].default_value = (*COLOR, 1)
    if image is not None:
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image = image
        tree.links.new(node.outputs["Color"], surface.inputs["Base Color"])
    return made


def image(values, space, floats):
    made = bpy.data.images.new("look", 4, 4, float_buffer=floats)
    made.colorspace_settings.name = space
    made.pixels.foreach_set(np.tile(np.float32((*values, 1)), 16))
    return made


def test_a_plain_material_shows_its_base_color_and_none_is_gray():
    assert Looks().of(material()) == pytest.approx((*COLOR, -1))
    assert Looks().of(None) == (*GRAY, -1)


@pytest.mark.parametrize(
    "values, space, floats",
    [
        (np.array(SRGB) / 255, "sRGB", False),
        (COLOR, "Non-Color", False),
        (COLOR, "Linear Rec.709", False),
        (COLOR, "Linear Rec.709", True),
    ],
)
def test_images_come_out_as_srgb_whatever_their_own_space_is(values, space, floats):
    looks = Looks()
    assert looks.of(material(image(values, space, floats))) == (1, 1, 1, 0)
    (picture,) = looks.images()
    assert picture.shape == (4, 4, 4) and np.abs(picture[..., :3].astype(int) - SRGB).max() <= 1
