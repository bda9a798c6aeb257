"""The five minutes of docs/tutorial.md: blender --python tutorial.py -- FOLDER [page].

Starts where a user starts: Blender's default scene, with a character of their own in place of the
cube. Then clicks the blue button of the sidebar, again and again, and takes a picture after each
step. The second day follows (second_day.py), unless the pictures are for the page: its character is
fine, and its shot longer.
"""

import json
import sys
import time
from importlib import import_module
from math import pi
from pathlib import Path

import bpy
import numpy as np

sys.path[:0] = map(str, Path(__file__).parents[:2])
import robot  # noqa: E402
import second_day  # noqa: E402
from robot import scene, settings  # noqa: E402
from support.coarse_characters import CAGE  # noqa: E402

FOLDER, *FOR_PAGE = sys.argv[sys.argv.index("--") + 1 :]
FOLDER = Path(FOLDER)
PICTURES = "1_start 2_characters 3_crowd 4_lods 5_plan 6_build 7_verified".split()
WIDE = 1000  # pixels of a picture
REST = 10.0  # seconds before one for the page: the overlay reads the characters meanwhile
WIDEST_ICON = 30  # pixels; a blue button is wider, a switch that is on is not
WIDEST_BUTTON = 0.45  # of the sidebar's width, in a panel's header
results = {"pressed": [], "after": {}}


def session():
    """Yields the seconds to wait before going on."""
    own_scene()
    area = robot.view_3d()
    area.spaces[0].show_region_ui = True
    view = area.spaces[0].region_3d
    view.view_perspective = "CAMERA"
    view.view_camera_zoom = 14
    view.view_camera_offset = (0.09, 0.0)
    yield 0.5
    robot.sidebar(area).active_panel_category = "Crowd LOD"
    yield 1.0
    seen = yield from picture(PICTURES[0])
    for name in PICTURES[1:]:
        steps = sys.modules[f"{robot.MODULE}.operators.ui.steps"]
        results["pressed"].append(steps.label_of(steps.next_operator(scene())))
        print(f"--- {name} {time.process_time():.0f} s", flush=True)
        yield from click(*blue_button(seen), turn if name == "4_lods" else nothing)
        if name == PICTURES[1]:
            yield from confirm()
        seen = yield from picture(name)
        results["after"][name] = made()
    results["verified"] = json.loads(
        (FOLDER / "output" / "verify" / "verify.json").read_text(encoding="utf-8")
    )["ok"]
    if not FOR_PAGE:
        results["second day"] = yield from second_day.perform(FOLDER)


def own_scene():
    """In the default scene, in place of the cube: a rigged, walking character, selected.

    Few frames, agents and proofs, to be quick.
    """
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    characters, scenery = (
        import_module(f"{robot.MODULE}.sample_scenes.{name}") for name in ("characters", "scenery")
    )
    (group,) = characters.make_characters(
        scene().collection, builds=characters.BUILDS[:1], finer=0 if FOR_PAGE else CAGE
    )
    rig, mesh = group.objects
    for item in (rig, mesh):
        scene().collection.children["Collection"].objects.link(item)
        item.select_set(True, view_layer=robot.window().view_layer)
    bpy.data.collections.remove(group)
    rig.rotation_euler.z = -pi / 2  # it faces +X, and Blender's front is -Y
    scenery.aim(scene().camera, (-9, -24, 3.2), (1, 0, 0.5))
    scene().frame_end = 24
    scene().render.resolution_x = 960
    scene().render.resolution_y = 540
    settings().count = 500 if FOR_PAGE else 150
    settings().verify_count = 1
    settings().output_folder = str(FOLDER / "output")
    if FOR_PAGE:
        bpy.context.preferences.system.viewport_aa = "8"
    else:
        scene().frame_end = 8
        scene().render.resolution_percentage = 50


def made():
    """What there is after a step."""
    found = settings()
    frame = robot.overlay().latest(scene())
    return {
        "characters": [each.name for each in found.characters.children],
        "agents": len(frame.crowd) if frame else 0,
        "visible": len(frame.buckets.order) if frame else 0,
        "lods": [int(count) for count in frame.buckets.counts] if frame else [],
        "triangles": frame.triangles / frame.full_triangles
        if frame and frame.full_triangles
        else 1.0,
        "planned": bool(frame and frame.planned),
        "points": sum(
            len(each.data.vertices) for each in found.build.objects if each.visible_camera
        )
        if found.build
        else 0,
    }


def nothing():
    yield from ()


def turn():
    """Turn the view by the mouse while a step is at work; note what is at work afterwards."""
    view = robot.view_3d().spaces[0].region_3d
    before = view.view_rotation.copy()
    area = robot.view_3d()
    x = area.x + area.width // 4
    y = area.y + area.height // 2
    robot.window().event_simulate(type="MIDDLEMOUSE", value="PRESS", x=x, y=y)
    for k in range(5):
        robot.window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=x + 20 * k, y=y)
        yield 0.05
    robot.window().event_simulate(type="MIDDLEMOUSE", value="RELEASE", x=x + 100, y=y)
    yield from robot.until(lambda: view.view_rotation != before, 10.0, 0.05)
    results["turned"] = view.view_rotation != before
    results["at work"] = [step.bl_idname for step in robot.window().modal_operators]
    view.view_perspective = "CAMERA"


def click(x: int, y: int, meanwhile):
    """Click there, do something `meanwhile`, and wait until the button's work is done."""
    robot.window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=y)
    yield 0.3
    for value in ("PRESS", "RELEASE"):
        robot.window().event_simulate(type="LEFTMOUSE", value=value, x=x, y=y)
    yield 0.5
    yield from meanwhile()
    yield from robot.until(lambda: not robot.window().modal_operators, robot.PATIENCE)


def confirm():
    """Accept the dialog that lists what is read of the selection."""
    for value in ("PRESS", "RELEASE"):
        robot.window().event_simulate(type="RET", value=value)
    yield 0.5


def blue_button(seen: np.ndarray) -> tuple[int, int]:
    """Where the topmost button of a panel's header is that is drawn as the default one, near its
    upper left end: in the window, from below. The list's active crowd is as blue, and wider.
    """
    region = robot.sidebar(robot.view_3d())
    blue = bpy.context.preferences.themes[0].user_interface.wcol_tool.inner_sel[:3]
    part = seen[region.y : region.y + region.height, region.x : region.x + region.width, :3]
    near = np.abs(part - blue).max(axis=2) < 0.03
    columns = np.arange(near.shape[1])
    span = np.where(near, columns, -1).max(axis=1) - np.where(near, columns, len(columns)).min(
        axis=1
    )
    is_button = (near.sum(axis=1) > WIDEST_ICON) & (span < WIDEST_BUTTON * len(columns))
    row = np.flatnonzero(is_button)[-1] - 3
    return int(region.x + np.flatnonzero(near[row])[0] + 4), int(region.y + row)


def picture(name: str):
    """Save a picture of the viewport and its sidebar.

    Returns all of the window: (height, width, 4) of 0 to 1, from below.
    """
    yield from robot.drawn(REST if FOR_PAGE else 1.0)
    yield from robot.picture("window")
    image = bpy.data.images.load(str(FOLDER / "window.png"))
    seen = np.empty((image.size[1], image.size[0], 4), np.float32)
    image.pixels.foreach_get(seen.ravel())
    bpy.data.images.remove(image)
    area = robot.view_3d()
    part = seen[area.y : area.y + area.height, area.x : area.x + area.width]
    image = bpy.data.images.new(name, area.width, area.height)
    image.pixels.foreach_set(np.ascontiguousarray(part).ravel())
    image.scale(WIDE, round(area.height * WIDE / area.width))
    image.filepath_raw = str(FOLDER / f"{name}.png")
    image.file_format = "PNG"
    image.save()
    bpy.data.images.remove(image)
    return seen


robot.perform(session(), results, FOLDER)
