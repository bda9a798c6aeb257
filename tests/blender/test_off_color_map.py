"""A label map with a few off-color pixels populates: they are counted, named and marked."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.walk import stray_places
from crowd_lod_extension.crowd_lod.crowd import state_machine
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.deliver.preview.preview import Preview, preview
from crowd_lod_extension.operators.scene import scene_crowd, stuck_agents
from crowd_lod_extension.operators.scene.machine import scene_world
from crowd_lod_extension.operators.viewport.draw_data import drawing
from crowd_lod_extension.operators.viewport.inset import STRAY, with_strays

from ..support.messages import told
from ..support.scene_frames import frame_now

pytestmark = pytest.mark.once  # long, and the same on every Blender


COLORS = state_machine.load_preset("chapter").label_colors


def paint(scene, odd=()):
    """Ground between two edges, 40 x 40 pixels over the area; `odd` are (row, column) of yellow
    ones.
    """
    labels = np.zeros((40, 40), int)
    labels[:, 0] = 1
    labels[:, -1] = 2
    pixels = COLORS[labels]
    for row, column in odd:
        pixels[row, column] = 255, 255, 0
    scene.crowd_lod.map_image = image_data.write_image("painted", pixels)


def test_ten_off_color_pixels_leave_the_crowd_and_are_told(scene, capfd):
    paint(scene)
    bpy.ops.crowd_lod.populate()
    clean = scene_crowd.trajectory_of(scene)
    assert told(scene) == "" and not len(clean.world.strays)
    paint(scene, [(7, 3 + k) for k in range(10)])
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    spoilt = scene_crowd.trajectory_of(scene)
    assert (spoilt.world.labels == clean.world.labels).all() and (
        spoilt.start.x == clean.start.x
    ).all()
    sentence = (
        "10 pixels of the label map have no label's color and count as ground: paint over, first "
        "in column 3, row 7 from the bottom."
    )
    assert told(scene) == sentence and sentence in capfd.readouterr().out
    (row,) = stuck_agents.find(spoilt).rows
    assert row == {
        "kind": "off-color",
        "agents": 0,
        "place": [-16.5, -12.5],
        "column": 3,
        "row": 7,
        "count": 10,
    }
    paint(scene, [(row, 20) for row in range(17)])
    with pytest.raises(RuntimeError, match="belong to no label"):
        bpy.ops.crowd_lod.populate()


def test_a_soft_brush_and_a_jpeg_leave_the_labels(scene, tmp_path):
    paint(scene)
    pixels = image_data.read_values(scene.crowd_lod.map_image).copy()
    pixels[:, 1, :3] += (pixels[:, 0, :3] - pixels[:, 1, :3]) * 0.15  # the brush's rim
    for row in range(4):
        pixels[row, 1, :3] = pixels[row, 0, :3] * 0.5 + pixels[row, 2, :3] * 0.5
    scene.crowd_lod.map_image.pixels.foreach_set(pixels.ravel())
    world = scene_world.world_of(scene.crowd_lod, state_machine.load_preset("chapter"))
    assert (world.labels[:, 0] == 1).all() and not world.labels[:, 1:-1].any()
    assert world.strays.tolist() == [[row, 1] for row in range(4)]


def test_inset_and_picture_from_above_mark_them(scene, tmp_path):
    odd = [(35, 5), (36, 6), (35, 7)]
    paint(scene, odd)
    bpy.ops.crowd_lod.populate()
    frame = frame_now(scene, bpy.context.evaluated_depsgraph_get())
    what = drawing(frame)
    marked = with_strays(what, stray_places(frame.trajectory))
    assert (
        len(marked.positions) == len(what.positions) + 3 == len(marked.colors) == len(marked.sizes)
    )
    at = marked.positions[-3:] + marked.origin
    assert at[:, :2].tolist() == pytest.approx(
        np.array([(c - 19.5, r - 19.5) for r, c in sorted(odd)]), abs=1e-4
    )
    assert (marked.colors[-3:] == STRAY).all() and at[:, 2].min() > what.positions[
        :, 2
    ].max() + what.origin[2]

    def magenta(folder):
        finished(preview(scene, Preview([1], folder, 320), []))
        pixels = image_data.load_pixels(folder / "above_0001.png").astype(int)
        return (pixels[..., 0] > 200) & (pixels[..., 1] < 60) & (pixels[..., 2] > 200)

    scene.crowd_lod.level_count = 1
    bpy.ops.crowd_lod.make_levels()
    assert magenta(tmp_path / "spoilt").sum() >= 9
    paint(scene)
    assert not magenta(tmp_path / "clean").any()
