"""Steps of session.py: pointing at agents, and all that may happen to a scene, a file or a window
while the overlay is on.
"""

import time

import bpy
import robot
from mathutils import Quaternion, Vector
from robot import overlay, scene, settings


def seen():
    """Whether the overlay still runs, what it draws, and what it says."""
    yield from robot.drawn()
    display = overlay().display_of(scene())
    return {
        "handlers": robot.draw_handlers.count,
        "agents": len(display.frame.crowd) if display and display.frame else None,
        "problem": overlay().problem(scene()),
    }


def main_region():
    return next(region for region in robot.view_3d().regions if region.type == "WINDOW")


def clip(agent):
    """Where the agent's waist is in the viewport's clip space."""
    crowd = overlay().latest(scene()).crowd
    return main_region().data.perspective_matrix @ Vector(
        (crowd.x[agent], crowd.y[agent], crowd.z[agent] + 0.9, 1.0)
    )


def mouse(kind, value, agent):
    """Send a mouse event where the agent is."""
    region = main_region()
    (x, y, _, w) = clip(agent)
    at = (
        int(region.x + (x / w + 1) * region.width / 2),
        int(region.y + (y / w + 1) * region.height / 2),
    )
    robot.window().event_simulate(type=kind, value=value, x=at[0], y=at[1])


def inspect():
    """Point at agents, keep one by a click, point at another and press Esc."""
    robot.view_3d().spaces[0].region_3d.view_perspective = "CAMERA"
    settings().hud = True
    settings().inset = True
    settings().overlay = True
    yield from robot.until(lambda: overlay().latest(scene()) is not None)
    yield 1.0
    # the nearest ones that are seen: no other stands in front of them
    places = {int(agent): clip(agent) for agent in overlay().latest(scene()).buckets.order[:40]}
    inside = [
        agent
        for agent, (x, y, _, w) in places.items()
        if -0.4 * w < x < 0 and -0.8 * w < y < 0.1 * w
    ]
    first, second = sorted(inside, key=lambda agent: places[agent].w)[:2]
    results = {"wanted": [first, second]}
    with robot.over():
        results["status"] = sorted(bpy.ops.crowd_lod.inspect("INVOKE_DEFAULT"))
    mouse("MOUSEMOVE", "NOTHING", first)
    yield 1.0
    results["pointed"] = settings().agent
    yield from robot.picture("20_pointing")
    mouse("LEFTMOUSE", "PRESS", first)
    mouse("LEFTMOUSE", "RELEASE", first)
    yield 0.5
    results["kept"] = settings().agent
    results["modal"] = len(robot.window().modal_operators)
    account = overlay().account_of(scene())
    results["told"] = [account.agent, account.visible, account.level]
    with robot.over():
        bpy.ops.crowd_lod.inspect("INVOKE_DEFAULT")
    mouse("MOUSEMOVE", "NOTHING", second)
    yield 0.5
    results["pointed again"] = settings().agent
    robot.key("ESC")
    yield 0.5
    results["after esc"] = settings().agent
    results["still modal"] = len(robot.window().modal_operators)
    settings().agent = -1
    return results


def views():
    """Quad view, a second window, local view, hidden overlays, the viewport's own view."""
    results = {}
    space = robot.view_3d().spaces[0]
    with robot.over():
        bpy.ops.screen.region_quadview()
    results["quad view"] = yield from seen()
    yield from robot.picture("21_quad_view")
    settings().overlay_camera = "VIEWPORT"
    results["quad view, own views"] = yield from seen()
    yield from robot.picture("22_own_views")
    with robot.over():
        bpy.ops.screen.region_quadview()
    results["own view"] = yield from seen()
    settings().overlay_camera = "SCENE"
    with robot.over():
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.5)
    views = [area for area in robot.window().screen.areas if area.type == "VIEW_3D"]
    views[1].spaces[0].region_3d.view_perspective = "PERSP"
    results["two viewports"] = yield from seen()
    yield from robot.picture("22_two_viewports")
    with bpy.context.temp_override(window=robot.window(), area=views[1]):
        bpy.ops.screen.area_close()
    with robot.over():
        bpy.ops.wm.window_new()
    results["two windows"] = yield from seen()
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[-1]):
        bpy.ops.wm.window_close()
    results["one window"] = yield from seen()
    ground = next(item for item in scene().objects if item.name.startswith("Ground"))
    scene().view_layers[0].objects.active = ground
    ground.select_set(True)
    for name in ("local view", "global view"):
        with robot.over():
            bpy.ops.view3d.localview()
        results[name] = yield from seen()
    before = overlay().display_of(scene())
    space.overlay.show_overlays = False
    settings().seed += 1
    hidden = yield from seen()
    results["hidden"] = hidden | {"followed": overlay().display_of(scene()) is not before}
    space.overlay.show_overlays = True
    results["seen again"] = yield from seen()
    return results


def rendered(folder):
    """The viewport's own picture of the crowd, compared with what is on the screen."""
    space = robot.view_3d().spaces[0]
    region = main_region()
    settings().hud = settings().inset = False
    view = space.region_3d
    view.view_perspective = "PERSP"
    view.view_location = (0, 0, 0)
    view.view_distance = 40.0
    view.view_rotation = Quaternion((0.8, 0.6, 0, 0))  # from above
    settings().overlay_mode = "BOXES"
    space.overlay.show_floor = space.overlay.show_axis_x = space.overlay.show_axis_y = False
    yield from seen()
    before = set(bpy.data.images)
    status = yield from robot.press("crowd_lod.render_viewport")
    (image,) = set(bpy.data.images) - before
    yield from robot.close_window_of(image)
    yield from robot.picture("23_viewport")
    mine = bytes_of(image)
    screen = bpy.data.images.load(str(folder / "23_viewport.png"))
    whole = bytes_of(screen)
    width = screen.size[0]
    agents = same = 0
    for row in range(60, region.height - 120, 3):  # free of headers
        for column in range(100, region.width - 300, 3):
            at = 4 * (row * image.size[0] + column)
            pixel = mine[at : at + 3]
            if max(pixel) > 2 * sorted(pixel)[1]:  # of one hue: an agent
                there = 4 * ((region.y + row) * width + region.x + column)
                agents += 1
                same += (
                    max(abs(a - b) for a, b in zip(pixel, whole[there : there + 3], strict=True))
                    <= 1
                )
    results = {
        "status": status,
        "modal": len(robot.window().modal_operators),
        "size": list(image.size),
        "region": [region.width, region.height],
        "agents": agents,
        "same": same,
    }
    bpy.data.images.remove(screen)
    image.filepath_raw = str(folder / "23_render_viewport.png")
    image.file_format = "PNG"
    image.save()
    with robot.over():
        view.view_perspective = "CAMERA"
        bpy.ops.crowd_lod.render_viewport()
    (second,) = set(bpy.data.images) - before - {image}
    render = scene().render
    results["through the camera"] = list(second.size)
    results["render"] = [
        side * render.resolution_percentage // 100
        for side in (render.resolution_x, render.resolution_y)
    ]
    second.filepath_raw = str(folder / "24_render_viewport.png")
    second.file_format = "PNG"
    second.save()
    yield from robot.close_window_of(second)
    for made in (image, second):
        bpy.data.images.remove(made)
    settings().overlay_mode = "MESHES"
    settings().hud = True
    settings().inset = True
    return results


def bytes_of(image):
    """The image's values, 0 to 255, RGBA, from the left bottom corner on."""
    return [round(255 * value) for value in image.pixels[:]]


def losses():
    """What the crowd stands on goes, piece by piece, and comes back by undo."""
    results = {}
    characters = settings().characters
    armatures = [item for item in characters.all_objects if item.type == "ARMATURE"]
    meshes = [item for item in characters.all_objects if item.type == "MESH"]
    bpy.ops.ed.undo_push(message="before")
    for name, lose in (
        ("armature", lambda: [bpy.data.objects.remove(item) for item in armatures]),
        ("character", lambda: [bpy.data.objects.remove(item) for item in meshes]),
        ("collection", lambda: bpy.data.collections.remove(characters)),
        ("camera", lambda: bpy.data.objects.remove(scene().camera)),
    ):
        lose()
        results[name] = yield from seen()
    bpy.ops.ed.undo_push(message="after")
    robot.undo()
    results["undone"] = yield from seen()
    robot.redo()
    results["redone"] = yield from seen()
    robot.undo()
    yield 0.5
    return results


def files(folder):
    """Another scene, a saved file opened again, a new one."""
    results = {}
    own = scene()
    robot.window().scene = next(other for other in bpy.data.scenes if other is not own)
    results["other scene"] = yield from seen()
    robot.window().scene = own
    results["own scene"] = yield from seen()
    path = str(folder / "lifecycle.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    for name, load in (
        ("opened", lambda: bpy.ops.wm.open_mainfile(filepath=path)),
        ("new", lambda: bpy.ops.wm.read_homefile()),
        ("opened again", lambda: bpy.ops.wm.open_mainfile(filepath=path)),
    ):
        load()
        results[name] = (yield from seen()) | {"kept": robot.count_displays()}
    return results


def breakage():
    """An unforeseen error in either part of the drawing: told once, and all is let go."""
    results = {}
    for part in ("plan", "figures"):
        home, name = (robot.display(), "use_of") if part == "plan" else (overlay().hud, part)
        real = getattr(home, name)

        def broken(*_, part=part):
            raise ZeroDivisionError(f"made by the test in {part}")

        setattr(home, name, broken)
        scene().frame_set(scene().frame_current + 1)
        results[part] = yield from seen()
        setattr(home, name, real)
        robot.toggle()
        results[f"after {part}"] = yield from seen()
    return results


def repeat():
    """Disabled and enabled, the crowd drawn in between now and then."""
    before = robot.leftovers()
    memory = []
    for number in range(40):
        robot.toggle()
        yield 0.02
        if number % 10 == 9:
            yield from seen()
            memory.append(robot.memory())
    return {
        "before": before,
        "after": robot.leftovers(),
        "seen": (yield from seen()),
        "memory": memory,
    }


def lifecycle(folder):
    results = {}
    for step in (inspect, views, rendered, losses, files, breakage, repeat):
        print(f"--- lifecycle: {step.__name__} {time.process_time():.0f} s", flush=True)
        results[step.__name__] = yield from (step(folder) if step in (rendered, files) else step())
    return results
