"""The overlay's points and lines, bodies without a window and read back."""

from dataclasses import replace

import bpy
import gpu
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from crowd_lod_extension.crowd_lod.culling.camera import frustum_corners
from crowd_lod_extension.operators.blender.colors import to_srgb
from crowd_lod_extension.operators.lods.make_lods import TINTS
from crowd_lod_extension.operators.viewport import draw_data
from crowd_lod_extension.operators.viewport.draw_data import CULLED, FRUSTUM, Style, drawing
from crowd_lod_extension.operators.viewport.gpu_batches import Batches
from crowd_lod_extension.operators.viewport.gpu_draw import POINT_PIXELS, paint
from mathutils import Matrix, Vector

from ..support.overlays import AGENTS, GROUPS, planned

WIDTH = 320
HEIGHT = 240


@pytest.fixture(scope="module", autouse=True)
def context():
    gpu.init()


def without_lines(what):
    return replace(what, lines=what.lines[:0], line_colors=what.line_colors[:0])


@pytest.fixture
def viewer():
    """A function that makes a camera of this kind, above and behind AGENTS, which sees them all."""
    made = []

    def make(kind):
        data = bpy.data.cameras.new("viewer")
        data.type = kind
        data.ortho_scale = 60.0
        data.lens = 24.0
        data.clip_end = 500.0
        item = bpy.data.objects.new("viewer", data)
        made.append(item)
        bpy.context.scene.collection.objects.link(item)
        eye = Vector((-12.0, -22.0, 20.0))
        target = Vector((0.0, 10.0, 0.0))
        turn = (target - eye).to_track_quat("-Z", "Y").to_matrix().to_4x4()
        item.matrix_world = Matrix.Translation(eye) @ turn
        render = bpy.context.scene.render
        render.resolution_x = WIDTH
        render.resolution_y = HEIGHT
        render.resolution_percentage = 100
        bpy.context.view_layer.update()
        return item

    yield make
    for item in made:
        bpy.data.cameras.remove(item.data)


def picture(what, viewer, depth=1.0):
    """What the overlay draws, (HEIGHT, WIDTH, 4) float32, bottom row first, over black at this
    depth.
    """
    depsgraph = bpy.context.evaluated_depsgraph_get()
    canvas = gpu.types.GPUOffScreen(WIDTH, HEIGHT, format="RGBA32F")
    try:
        with canvas.bind():
            buffer = gpu.state.active_framebuffer_get()
            buffer.clear(color=(0, 0, 0, 1), depth=depth)
            view = np.array(viewer.matrix_world.inverted())
            projection = np.array(viewer.calc_matrix_camera(depsgraph, x=WIDTH, y=HEIGHT))
            paint(Batches(what), view, projection, (WIDTH, HEIGHT), 1.0)
            pixels = buffer.read_color(0, 0, WIDTH, HEIGHT, 4, 0, "FLOAT")
        return np.asarray(memoryview(pixels), np.float32).reshape(HEIGHT, WIDTH, 4).copy()
    finally:
        canvas.free()


def pixel(viewer, position) -> tuple[int, int]:
    """Row and column of a world position in the viewer's picture."""
    x, y, depth = world_to_camera_view(bpy.context.scene, viewer, Vector(position))
    assert 0 < x < 1 and 0 < y < 1 and depth > 0
    return int(y * HEIGHT), int(x * WIDTH)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_points_stand_where_the_agents_do_in_the_tint_of_their_lod(viewer, kind):
    viewer = viewer(kind)
    seen = picture(without_lines(planned()[1]), viewer)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    free = np.ones((HEIGHT, WIDTH), bool)
    for feet, group, level in AGENTS:
        row, column = pixel(viewer, np.add(feet, (0, 0, GROUPS[group].center)))
        color = np.multiply(CULLED[:3], CULLED[3]) if level is None else TINTS[level]
        assert seen[row, column, :3] == pytest.approx(color, abs=0.02)
        free &= np.hypot(rows - row, columns - column) > POINT_PIXELS[1] / 2 + 1
    assert (seen[free] == (0, 0, 0, 1)).all()


def test_points_shrink_with_distance_down_to_a_least_size(viewer):
    viewer = viewer("PERSP")
    seen = picture(without_lines(planned()[1]), viewer)
    red, blue = ((seen[..., channel] > 0.3).sum() for channel in (0, 2))
    assert red > blue >= 0.6 * (POINT_PIXELS[0] * GROUPS[1].radius) ** 2 * np.pi / 4


def test_what_stands_in_front_hides_the_points(viewer):
    seen = picture(planned()[1], viewer("PERSP"), depth=0.0)
    assert (seen == (0, 0, 0, 1)).all()


def test_lines_run_along_the_frustum_and_where_each_lod_begins(viewer):
    frame, what = planned()
    viewer = viewer("PERSP")
    seen = picture(what, viewer)
    camera = frame.camera
    expected = [(camera.far, FRUSTUM), (10.0, (*TINTS[1], 1.0)), (20.0, (*TINTS[2], 1.0))]
    for distance, linear in expected:
        color = to_srgb(np.array(linear, np.float32))[:3]
        left_bottom, right_bottom = frustum_corners(camera, distance)[:2]
        row, column = pixel(viewer, 0.7 * left_bottom + 0.3 * right_bottom)
        near = seen[row - 1 : row + 2, column - 1 : column + 2, :3].reshape(-1, 3)
        assert np.abs(near - color).max(axis=1).min() < 0.1


def test_the_gpu_is_left_as_it_was(viewer):
    before = gpu.state.depth_test_get(), gpu.state.depth_mask_get(), gpu.state.blend_get()
    picture(planned()[1], viewer("PERSP"))
    assert (gpu.state.depth_test_get(), gpu.state.depth_mask_get(), gpu.state.blend_get()) == before


def test_far_from_the_worlds_origin_the_points_are_as_exact():
    _, here = planned()
    _, there = planned((4_000_000.0, -2_000_000.0, 0.0))
    assert there.positions == pytest.approx(here.positions, abs=1e-4)
    assert there.lines == pytest.approx(here.lines, abs=1e-4)
    assert there.positions.dtype == np.float32


def test_points_are_in_order_of_lod_and_those_culled_last():
    _, what = planned()
    tints = [tuple(np.float32(c) for c in (*TINTS[level], 1.0)) for level in (0, 0, 1, 2)]
    assert [tuple(c) for c in what.colors[:4]] == tints
    assert (what.colors[4:] == np.float32(CULLED)).all()
    assert (what.sizes[4:] < what.sizes[0]).all() and what.sizes[0] == 1


def test_of_many_culled_agents_a_part_shows_and_all_those_seen(monkeypatch):
    frame, every = planned()
    monkeypatch.setattr(
        draw_data, "MOST_CULLED", 3
    )  # of six agents every second may show where it is culled, the fifth is
    some = drawing(frame)
    assert len(every.positions) == 6 and (some.positions == every.positions[:5]).all()
    assert (some.colors == every.colors[:5]).all() and (some.sizes == every.sizes[:5]).all()
    assert len(drawing(frame, Style(culled=False)).positions) == 4


def test_what_did_not_change_is_not_uploaded_again():
    _, what = planned()
    first = Batches(what)
    again = Batches(replace(what), before=first)
    assert again.points is first.points and again.lines is first.lines
    moved = replace(what, positions=what.positions + np.float32(1))
    later = Batches(moved, before=again)
    assert later.points is not first.points and later.lines is first.lines


def test_the_gpu_is_left_as_it_was_by_an_error_while_drawing(viewer):
    before = gpu.state.depth_test_get(), gpu.state.depth_mask_get(), gpu.state.blend_get()
    broken = Batches(planned()[1])
    broken.points = "no batch"
    canvas = gpu.types.GPUOffScreen(WIDTH, HEIGHT)
    try:
        with canvas.bind(), pytest.raises(AttributeError):
            paint(broken, np.eye(4), np.eye(4), (WIDTH, HEIGHT), 1.0)
    finally:
        canvas.free()
    assert (gpu.state.depth_test_get(), gpu.state.depth_mask_get(), gpu.state.blend_get()) == before
