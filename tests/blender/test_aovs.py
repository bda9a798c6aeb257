"""What the agents are, as passes for compositing: in each pixel that of the agent it shows."""

import addon_utils
import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators.build.aovs import add_aovs
from crowd_lod_extension.operators.scene.scene_crowd import trajectory_of

from ..support.exr import channels_of
from ..support.scene_frames import frame_now

NAMES = ("id", "looks", "group", "lod")


def passes(scene, folder):
    """(pixels, 4): id, looks, group and LOD that Cycles renders where a pixel shows an agent."""
    addon_utils.enable("cycles")
    render = scene.render
    render.engine = "CYCLES"
    render.film_transparent = True
    scene.cycles.samples = 1
    scene.cycles.filter_width = 0.01
    scene.cycles.use_denoising = False
    settings = render.image_settings
    if bpy.app.version >= (5,):
        settings.media_type = "MULTI_LAYER_IMAGE"
    else:
        settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"
    settings.exr_codec = "NONE"
    render.filepath = str(folder / "passes.exr")
    bpy.ops.render.render(write_still=True)
    # such as ViewLayer.id.X, with the part's name before it where each pass has a part
    channels = {
        name.split(".")[-2 if name.endswith(".X") else -1]: values
        for name, values in channels_of(folder / "passes.exr").items()
        if name.endswith((".X", "Combined.A"))
    }
    return np.stack([channels[name][channels["A"] == 1] for name in NAMES], axis=1)


@pytest.mark.parametrize("baked", [False, True])
def test_each_pixel_holds_what_its_agent_is(built, tmp_path, baked):
    if baked:
        built.frame_start = built.frame_end = 1
        bpy.ops.crowd_lod.bake()
    message = add_aovs(built)
    assert add_aovs(built) == message
    shown = passes(built, tmp_path)
    frame = frame_now(built, built.view_layers[0].depsgraph)
    trajectory = trajectory_of(built)
    agents = shown[:, 0].astype(np.intp)
    expected = np.stack(
        [agents, trajectory.looks[agents], frame.crowd.group[agents], frame.levels[agents]], axis=1
    )
    assert len(np.unique(agents)) > 20 and len(np.unique(shown[:, 3])) == 3
    np.testing.assert_allclose(shown, expected, atol=1e-6)


def test_a_bake_that_shows_nobody_is_told(built):
    built.camera.data.clip_end = 2 * built.camera.data.clip_start
    for item in [item for item in built.objects if item.type == "LIGHT"]:
        bpy.data.objects.remove(item)
    built.world = None
    built.frame_start = built.frame_end = 1
    bpy.ops.crowd_lod.bake()
    with pytest.raises(
        CrowdError, match="The build shows no agents: bake frames in which the camera"
    ):
        add_aovs(built)
    assert not built.view_layers[0].aovs


def test_what_cannot_be_written_is_told_and_nothing_changes(built):
    aov = built.view_layers[0].aovs.add()
    aov.name = "id"
    with pytest.raises(CrowdError, match="ViewLayer has an AOV id that holds colors: rename it"):
        add_aovs(built)
    assert len(built.view_layers[0].aovs) == 1 and "Crowd LOD AOVs" not in bpy.data.node_groups
