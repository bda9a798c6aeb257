"""The mean color of an agent that Verify renders alone."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.culling.camera import Window
from crowd_lod_extension.crowd_lod.validation.judged_agents import JudgedAgent
from crowd_lod_extension.operators.deliver.proof.lone_agents import LoneStage, facts_of

from ..support.cameras import straight


def test_a_glint_in_one_pixel_is_no_other_color():
    full = np.full((40, 20, 4), 0.1, np.float32)
    full[..., 3] = 1
    glint = full.copy()
    glint[7, 7, :3] = 2354.0  # as the sun in a soldier's visor, at one of his LODs
    red = full.copy()
    red[..., 0] = 0.2
    judged = JudgedAgent(7, 0, 2, straight(), Window(0, 1, 0, 1), 1.0, 1.0)
    assert facts_of(judged, full, glint, 1.0)["ok"]
    assert facts_of(judged, full, red, 1.0)["color_off"] == pytest.approx(0.135, abs=0.01)


def test_agents_alone_are_simplified_as_renders_of_the_scene(tmp_path):
    render = bpy.context.scene.render
    render.use_simplify = True
    render.simplify_subdivision_render = 1
    alone = LoneStage(bpy.context.scene, tmp_path).stage.render
    assert (alone.use_simplify, alone.simplify_subdivision_render) == (True, 1)
