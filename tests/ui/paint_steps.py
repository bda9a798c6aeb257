"""A wall painted in Blender's window: blender --python paint_steps.py -- FOLDER.

Presses New Map and a label, paints with the mouse in Texture Paint, and sees what the crowd does;
then moves a mesh that lays a label over the map. Populate is pressed once, before all of it.
"""

import sys
from pathlib import Path

import bpy

sys.path[:0] = map(str, Path(__file__).parents[:2])
import robot  # noqa: E402
from bpy_extras.view3d_utils import location_3d_to_region_2d  # noqa: E402
from robot import overlay, scene, settings  # noqa: E402

FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
FRAME = 72
results = {}


def session():
    yield from robot.sample("chapter")
    settings().count = 400
    settings().overlay_mode = "POINTS"
    settings().overlay_color = "STATE"
    yield from robot.press("crowd_lod.machine_preset", name="chapter")
    yield from robot.press("crowd_lod.new_map", pixels=64)
    yield from robot.press("crowd_lod.populate")
    for item in [item for item in scene().objects if item.name.startswith("Ground")]:
        bpy.data.objects.remove(item)
    from_above()
    scene().frame_set(FRAME)
    yield from robot.drawn()
    results["before"] = crowd()
    results["paint"] = yield from paint()
    results["wall"] = yield from wall()


def from_above():
    view = robot.view_3d().spaces[0].region_3d
    view.view_perspective = "ORTHO"
    view.view_rotation = (1, 0, 0, 0)
    # clear of the shelf of brushes
    view.view_location = settings().center
    view.view_distance = 2.4 * max(settings().size)


def crowd() -> dict:
    """What the overlay shows: the states of the agents, and where those that turned are."""
    frame = overlay().latest(scene())
    trajectory = frame.trajectory
    turned = frame.crowd.state == trajectory.states.names.index("walk left")
    labels = trajectory.world.labels
    return {
        "time": frame.time,
        "turned": int(turned.sum()),
        "farthest": float(frame.crowd.x[turned].max()) if turned.any() else None,
        "walls": [int(n) for n in (labels == 2).sum(axis=0)],
        "cell": trajectory.world.cell[0],
        "left": trajectory.area.x_min,
    }


def at(x, y):
    """The pixel of the window over a place of the ground."""
    area = robot.view_3d()
    region = next(region for region in area.regions if region.type == "WINDOW")
    place = location_3d_to_region_2d(region, area.spaces[0].region_3d, (x, y, 0))
    return region.x + round(place.x), region.y + round(place.y)


def paint():
    """A stroke along the ground's whole depth, a quarter of its width right of the middle."""
    status = yield from robot.press("crowd_lod.paint_label", label="right edge")
    yield from robot.drawn()
    (x, y, _) = settings().center
    (width, depth) = settings().size
    path = [at(x + width / 4, y + depth * (n / 20 - 0.55)) for n in range(23)]
    robot.window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=path[0][0], y=path[0][1])
    yield 0.2
    robot.window().event_simulate(type="LEFTMOUSE", value="PRESS", x=path[0][0], y=path[0][1])
    yield 0.2
    for px, py in path:
        robot.window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=px, y=py)
        yield 0.05
    robot.window().event_simulate(type="LEFTMOUSE", value="RELEASE", x=path[-1][0], y=path[-1][1])
    yield from robot.until(lambda: any(crowd()["walls"]))
    yield from robot.drawn()
    yield from robot.picture("40_painted")
    pixels = [round(255 * value) for value in settings().map_image.pixels]
    colors = {tuple(pixels[n : n + 3]) for n in range(0, len(pixels), 4)}
    return {"status": status, "colors": sorted(colors), "mode": bpy.context.object.mode, **crowd()}


def wall():
    """A mesh lays the label over the map, is moved, and moved back by undo."""
    with robot.over():
        bpy.ops.object.mode_set(mode="OBJECT")
        x = settings().center[0] - settings().size[0] / 4
        y = settings().center[1]
        bpy.ops.mesh.primitive_cube_add(size=2, location=(x, y, 0))
        bpy.ops.ed.undo_push(message="cube")
    cube = bpy.context.object.name
    yield from robot.press("crowd_lod.add_row", kind="areas")
    settings().areas[0].label = "right edge"
    yield from robot.press("crowd_lod.populate")
    found = {"added": (yield from walls_after(lambda: None))}
    with robot.over():
        found["moved"] = yield from walls_after(
            lambda: bpy.ops.transform.translate(value=(-5, 0, 0))
        )
        bpy.ops.ed.undo_push(message="move")
    yield from robot.picture("41_wall_moved")
    found["undone"] = yield from walls_after(lambda: robot.key("Z", ctrl=True))
    found["place"] = bpy.data.objects[cube].location.x - x
    return found


def walls_after(change):
    """The columns that have walls, once the overlay has followed the change."""
    before = crowd()["walls"]
    change()
    yield from robot.until(lambda: crowd()["walls"] != before, 6.0)
    yield from robot.drawn()
    return crowd()["walls"]


robot.perform(session(), results, FOLDER)
