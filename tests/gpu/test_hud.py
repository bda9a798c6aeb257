"""What the overlay writes, the view from above, and a viewport's view as the plan's camera."""

from dataclasses import replace
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.leave_outs import STATIC, STILL
from crowd_lod_extension.crowd_lod.frame.reasons import REASONS, Account
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap
from crowd_lod_extension.operators.blender.cameras import camera_from
from crowd_lod_extension.operators.blender.colors import to_srgb
from crowd_lod_extension.operators.lods.make_lods import TINTS
from crowd_lod_extension.operators.viewport import hud, inset
from crowd_lod_extension.operators.viewport.draw_data import (
    HIDDEN,
    Colors,
    Style,
    by_group,
    by_level,
    by_reason,
    by_state,
    drawing,
)
from crowd_lod_extension.operators.viewport.gpu_batches import Batches
from crowd_lod_extension.operators.viewport.viewport_cameras import camera_of, viewpoint

from ..support.overlays import AGENTS, GROUPS, planned

ACCOUNT = Account(3, True, "far away", 2, 30.0, 0.41)


def texts(said):
    return [line.text for line in said]


def test_lines_tell_all_figures_of_the_frame():
    frame, what = planned()
    frame = replace(
        frame, vertices=1_234_567, full_vertices=12_345_678, triangles=20_000, full_triangles=50_000
    )
    frame = replace(
        frame, milliseconds=dict.fromkeys(frame.milliseconds, 1.5), left_out=(STATIC, STILL)
    )  # these are in a popover
    said = texts(hud.figures(frame, by_level(frame), worst=0.4321))
    assert said[:4] == ["6 agents, 4 visible, 33.3% culled", "LOD 0  2", "LOD 1  1", "LOD 2  1"]
    assert said[4:] == ["Triangles  20 k of 50 k without LOD", "Largest error  0.432 px"]
    frame = replace(frame, hidden=np.arange(6) > 4)
    (line,) = (line for line in hud.figures(frame, by_level(frame)) if "Occluded" in line.text)
    assert line == hud.HudLine("Occluded  1", HIDDEN[:3])


def test_lines_of_lods_bear_their_tints_and_an_agent_that_of_its_own():
    frame, _ = planned()
    colors = by_level(frame)
    said = hud.figures(frame, colors)
    assert [line.color for line in said[1:4]] == [pytest.approx(tint) for tint in TINTS[:3]]
    agent = hud.line_of(ACCOUNT, colors)
    assert agent.color == pytest.approx(TINTS[2])
    assert agent.text == "Agent 3, LOD 2: 30 m away, error 0.41 px"


@pytest.mark.parametrize("by", [by_state, by_group, by_reason])
def test_other_colors_have_a_legend_and_lods_then_no_color(by):
    frame, _ = planned()
    colors = by(frame)
    said = hud.figures(frame, colors, notes=("A note.",))
    assert [line.color for line in said[1:4]] == [None] * 3
    names = {
        by_state: frame.trajectory.machine.states,
        by_group: ("adult", "child"),
        by_reason: [  # those that some agent has
            REASONS[k][0].upper() + REASONS[k][1:] for k in sorted({*colors.index.tolist()})
        ],
    }[by]
    lines = said[4 : 4 + len(names)]
    assert texts(lines) == [*names] and said[4 + len(names)].text == "A note."
    drawn = drawing(frame, Style("POINTS"), colors)
    shown = {tuple(color[:3]) for color in drawn.colors[: len(frame.buckets.order)].tolist()}
    assert shown <= {
        line.color for line in lines
    }  # the swatches are the agents' own colors, to the bit
    for agent, color in zip(frame.buckets.order.tolist(), drawn.colors.tolist(), strict=False):
        assert (
            colors.of_agent(agent, True)
            == tuple(color[:3])
            == lines[[*names].index(colors.names[int(colors.index[agent])])].color
        )


def test_a_long_legend_ends_with_how_many_are_left():
    names = tuple(f"group {k}" for k in range(40))
    lines = hud.legend(
        Colors(np.zeros(1, np.uint8), np.float32([(1, 0, 0, 1), (0, 1, 0, 1)]), names=names)
    )
    assert texts(lines) == [*names[:12], "and 28 more"]
    assert [line.color for line in lines[:4]] == [(1, 0, 0), (0, 1, 0)] * 2 and lines[
        -1
    ].color is None
    assert hud.legend(Colors(np.zeros(1, np.uint8), np.ones((1, 4), np.float32))) == []


def test_one_line_tells_why_an_agent_is_culled_or_has_another_lod():
    unmeasured = replace(ACCOUNT, error=None)
    assert hud.describe(unmeasured) == "Agent 3, LOD 2: 30 m away"
    planned_lod = replace(ACCOUNT, reason="shot plan")
    assert hud.describe(planned_lod) == "Agent 3, LOD 2 (shot plan): 30 m away, error 0.41 px"
    culled = replace(ACCOUNT, visible=False, reason="left of the frame")
    assert hud.describe(culled) == "Agent 3, culled: left of the frame"


def test_an_empty_crowd_has_its_lines_too():
    frame, _ = planned()
    buckets = replace(
        frame.buckets, order=frame.buckets.order[:0], offsets=np.zeros_like(frame.buckets.offsets)
    )
    empty = replace(frame, crowd=frame.crowd.of(slice(0)), buckets=buckets)
    said = texts(hud.figures(empty, by_level(empty)))
    assert said[0] == "0 agents, 0 visible, 0.0% culled"


def test_narrow_and_low_viewports_break_lines_and_leave_the_last_out():
    said = (hud.HudLine("one two three four", (1.0, 0.0, 0.0)), hud.HudLine("five"))
    assert hud.wrap_lines(said, 80, 9) == list(said)
    narrow = hud.wrap_lines(said, 9, 9)
    assert texts(narrow) == ["one two", "  three", "  four", "five"]
    assert [line.color for line in narrow] == [(1.0, 0.0, 0.0), None, None, None]
    assert texts(hud.wrap_lines(said, 9, 3)) == ["one two", "  three", "..."]
    assert hud.wrap_lines(said, 9, 0) == [] and texts(hud.wrap_lines(said, -5, 1)) == ["..."]


def test_the_figures_keep_clear_of_what_lies_over_the_viewport():
    def region(kind, x, y, width, height):
        return SimpleNamespace(type=kind, x=x, y=y, width=width, height=height)

    window = region("WINDOW", 10, 20, 1000, 600)
    over = [
        window,
        region("TOOLS", 10, 20, 50, 600),
        region("UI", 800, 20, 210, 600),
        region("HEADER", 10, 590, 1000, 30),
    ]
    over += [region("TOOL_HEADER", 10, 560, 1000, 30), region("ASSET_SHELF", 10, 20, 1000, 1)]
    area = SimpleNamespace(x=10, y=20, width=1000, height=600, regions=over)
    plain = SimpleNamespace(show_text=False, show_stats=False)
    assert hud.free_box(area, window, plain, 1.0) == (50, 0, 790, 540 - hud.MARGIN)
    assert hud.free_box(area, window, plain, 2.0)[3] == 540 - 2 * hud.MARGIN
    written = SimpleNamespace(show_text=True, show_stats=True)
    assert hud.free_box(area, window, written, 1.0)[3] == 540 - hud.MARGIN - 9 * hud.LINE


@pytest.mark.parametrize("eye", [(0.0, -70.0, 3.0), (5.0, 5.0, 400.0)])
def test_the_area_and_the_eye_are_seen_from_above_upright_and_undistorted(eye):
    area = Area(-50, -20, 30, 40)
    eye = np.array(eye)
    places = np.array([(0, 0, -eye[2]), (0.0, 900.0, 40.0)])
    view, projection = inset.from_above(area, eye, places)
    across = projection[0, 0] * inset.SIZE[0]
    up = projection[1, 1] * inset.SIZE[1]
    assert across == pytest.approx(up)
    seen = [(area.x_min, area.y_min, 0.0), (area.x_max, area.y_max, 0.0), (*eye[:2], eye[2])]
    clip = np.array([projection @ view @ (*place, 1.0) for place in seen])
    assert (np.abs(clip[:, :3]) < 1).all() and clip[:, 3] == pytest.approx(1)
    assert (clip[1, :2] > clip[0, :2]).all()
    assert np.abs(clip[:, :2]).max() == pytest.approx(1 / 1.06, abs=0.01)
    heights = [(projection @ view @ (0, 0, eye[2] + z, 1.0))[2] for z in places[:, 2]]
    assert heights[1] < heights[0] and np.abs(heights).max() < 1  # what stands higher is nearer


def test_the_view_from_above_holds_every_agent_in_its_color():
    frame, what = planned()
    what = replace(what, lines=what.lines[:0], line_colors=what.line_colors[:0])
    view, projection = inset.from_above(Area(-50, -50, 50, 50), what.origin, what.positions)
    texture = inset.picture(Batches(what), view, projection, 2.0)
    width, height = (2 * side for side in inset.SIZE)
    assert (texture.width, texture.height) == (width, height)
    seen = np.array(texture.read().to_list(), np.float32).reshape(height, width, 4) / 255
    for (x, y, z), group, level in AGENTS:
        at = projection @ view @ (x, y, z + GROUPS[group].center, 1.0)
        row = int((at[1] + 1) / 2 * height)
        column = int((at[0] + 1) / 2 * width)
        near = seen[row - 1 : row + 2, column - 1 : column + 2, :3].reshape(-1, 3)
        if level is None:
            assert near.max() > 0.2
        else:
            tint = to_srgb(np.array([*TINTS[level], 1.0], np.float32))[:3]
            assert np.abs(near - tint).max(axis=1).min() < 0.01
    painted = (seen[..., :3].max(axis=-1) > 0.3).sum()
    assert 0 < painted < 100 * len(AGENTS)


def test_off_color_pixels_of_the_map_are_magenta_over_the_agents():
    _, what = planned()
    what = replace(what, lines=what.lines[:0], line_colors=what.line_colors[:0])
    (x, y, z), _, _ = AGENTS[0]
    world = LabelMap(
        np.zeros((100, 100), np.uint8),
        Area(-50, -50, 50, 50),
        np.array([(int(y + 50), int(x + 50)), (90, 7)]),
    )
    marked = inset.with_strays(
        what, np.array([(*place, z) for place in zip(*world.middles(*world.strays.T), strict=True)])
    )
    view, projection = inset.from_above(world.area, marked.origin, marked.positions)
    texture = inset.picture(Batches(marked), view, projection, 2.0)
    seen = (
        np.array(texture.read().to_list(), np.float32).reshape(texture.height, texture.width, 4)
        / 255
    )
    for place in zip(*world.middles(*world.strays.T), strict=True):
        at = projection @ view @ (*place, z, 1.0)
        row = int((at[1] + 1) / 2 * texture.height)
        column = int((at[0] + 1) / 2 * texture.width)
        assert seen[row, column, :3].tolist() == pytest.approx([1, 0, 1], abs=0.01)


def test_the_scale_is_a_round_length():
    lengths = [inset.scale_bar(longest) for longest in (0.3, 1.0, 49.0, 55.0, 2600.0)]
    texts_of = [said for _, said in lengths]
    assert texts_of == ["0.2 m", "1 m", "20 m", "50 m", "2 km"]
    assert [length for length, _ in lengths] == pytest.approx([0.2, 1, 20, 50, 2000])


@pytest.fixture
def filmed():
    """A scene's camera object, moved, turned and shifted."""
    item = bpy.data.objects.new("filmed", bpy.data.cameras.new("filmed"))
    item.location = (3, -20, 5)
    item.rotation_euler = (1.2, 0.1, 0.4)
    item.data.clip_start = 0.1
    item.data.clip_end = 1000.0
    item.data.ortho_scale = 12.0
    item.data.shift_x = 0.1
    item.data.shift_y = -0.2
    bpy.context.scene.collection.objects.link(item)
    yield item
    bpy.data.cameras.remove(item.data)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_a_view_through_a_camera_is_the_cameras(filmed, kind):
    filmed.data.type = kind
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    render = bpy.context.scene.render
    render.resolution_x = 640
    render.resolution_y = 480
    render.resolution_percentage = 100
    expected = camera_from(filmed, render, depsgraph)
    view = filmed.matrix_world.inverted()
    projection = filmed.calc_matrix_camera(depsgraph, x=640, y=480)
    found = camera_of(
        np.array(view, np.float64), np.array(projection, np.float64), (640, 480), (0.1, 1000.0)
    )
    assert found.kind == expected.kind
    for name in ("origin", "X", "Y", "Z"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), abs=1e-4)
    assert vars(found.window) == pytest.approx(vars(expected.window), abs=1e-4)
    assert (found.near, found.far) == pytest.approx((expected.near, expected.far), rel=1e-3)
    assert found.pixels_per_unit == pytest.approx(expected.pixels_per_unit, rel=1e-4)


def test_the_clip_range_is_the_viewports_or_that_of_the_camera_it_looks_through(filmed):
    bpy.context.view_layer.update()
    matrix = filmed.calc_matrix_camera(bpy.context.evaluated_depsgraph_get(), x=640, y=480)
    view = SimpleNamespace(
        view_matrix=filmed.matrix_world.inverted(), window_matrix=matrix, view_perspective="PERSP"
    )
    space = SimpleNamespace(clip_start=0.5, clip_end=77.0, use_local_camera=False, camera=None)
    scene = SimpleNamespace(camera=filmed)
    region = SimpleNamespace(width=640, height=480)
    context = SimpleNamespace(space_data=space, region_data=view, scene=scene, region=region)
    assert (viewpoint(context).near, viewpoint(context).far) == (0.5, 77.0)
    view.view_perspective = "CAMERA"
    assert viewpoint(context).far == 1000.0
    scene.camera = None
    assert viewpoint(context).far == 77.0
    space.use_local_camera = True
    space.camera = filmed
    assert viewpoint(context).far == 1000.0
