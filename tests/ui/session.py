"""What a user does, in a real Blender window: blender --python session.py -- FOLDER [STEP ...].

Presses every button, as the sidebar does, waits until its work is done, looks at what came of it,
takes a picture, and writes all it saw to FOLDER/results.json, which test_window.py judges. Only bpy
and the standard library.
"""

import shutil
import sys
import time
from pathlib import Path

import bpy

sys.path[:0] = map(str, Path(__file__).parents[:2])
import lifecycle as life  # noqa: E402
import robot  # noqa: E402
from robot import overlay, scene, settings  # noqa: E402

FOLDER, *CHOSEN = sys.argv[sys.argv.index("--") + 1 :]
FOLDER = Path(FOLDER)
AGENTS = 1000
results = {}


def session():
    """Yields the seconds to wait before going on."""
    area = robot.view_3d()
    area.spaces[0].show_region_ui = True
    yield 0.5
    robot.sidebar(area).active_panel_category = "Crowd LOD"
    yield 0.5
    steps = (
        empty,
        sample,
        timeline,
        levels,
        build,
        preview,
        escape,
        no_camera,
        deleted,
        plaza,
        lifecycle,
        leave,
    )
    for step in (step for step in steps if not CHOSEN or step.__name__ in CHOSEN):
        print(f"--- {step.__name__} {time.process_time():.0f} s", flush=True)
        started = time.monotonic()
        results[step.__name__] = yield from step()
        results[step.__name__]["seconds"] = round(time.monotonic() - started, 1)


def listen():
    """Note the frame of the figures whenever the sidebar draws them."""

    def note(panel, context):
        frame = overlay().latest(context.scene)
        results["sidebar"] = frame and frame.time

    bpy.types.CROWDLOD_PT_main.append(note)


def after(change):
    """Do it, wait until the viewport has followed; what it and the sidebar show then."""
    before = overlay().display_of(scene())
    change()
    yield from robot.until(lambda: overlay().display_of(scene()) is not before)
    frame = overlay().latest(scene())
    yield from robot.until(lambda: frame is None or results["sidebar"] == frame.time)
    return shown()


def shown():
    """The figures at the top of the sidebar."""
    frame = overlay().latest(scene())
    if frame is None:
        return {"problem": overlay().problem(scene())}
    return {
        "time": frame.time,
        "sidebar": results.get("sidebar"),
        "visible": int(frame.visible.sum()),
        "counts": frame.buckets.counts.tolist(),
    }


def empty():
    """Each button in a scene without anything: an error, and the scene is as it was."""
    yield from robot.picture("01_empty")
    found = {}
    for name in ("populate", "make_levels", "build", "bake", "preview", "remove_build"):
        before = robot.snapshot()
        status = yield from robot.press(f"crowd_lod.{name}")
        found[name] = {"status": status, "changed": robot.changes(before)}
        yield from robot.dismiss()
    return {"buttons": found}


def sample():
    listen()
    status = yield from robot.sample("chapter")
    few_agents()
    status = [status, (yield from robot.press("crowd_lod.populate"))]
    yield from robot.until(lambda: results.get("sidebar"))
    yield from robot.picture("02_populated")
    return {"status": status, "scene": scene().name, "overlay": settings().overlay, **shown()}


def few_agents():
    """Software OpenGL draws each of their triangles."""
    settings().count = AGENTS
    scene().display.render_aa = "OFF"


def timeline():
    """The overlay follows the frame, the camera and the settings, and computes nothing while all
    stands still.
    """
    found = {"frame 60": (yield from after(lambda: scene().frame_set(60)))}
    first = overlay().latest(scene())
    for _ in range(5):
        robot.view_3d().tag_redraw()
        yield 0.3
    found["idle"] = overlay().latest(scene()) is first
    found["camera moved"] = yield from after(lambda: move(15))
    yield from after(lambda: move(-15))
    found["threshold"] = yield from after(lambda: threshold(0.5))
    found["threshold pushed"] = yield from after(lambda: threshold(0.7))
    yield from robot.picture("03_threshold_pushed")
    found["back"] = yield from after(lambda: threshold(0.3, 0.6))
    space = robot.view_3d().spaces[0].region_3d
    space.view_perspective = "CAMERA"
    yield 1.0
    yield from robot.picture("04_through_the_camera")
    space.view_perspective = "PERSP"
    space.view_distance = 150
    yield 1.0
    yield from robot.picture("05_from_afar")
    return found


def move(meters: float):
    scene().camera.location.x += meters


def threshold(*values: float):
    settings().thresholds[: len(values)] = values
    robot.view_3d().tag_redraw()  # as an edit in the sidebar does


def levels():
    status = yield from robot.press("crowd_lod.make_levels")
    yield 1.0
    for part in ("06_levels_a", "06_levels_b", "06_levels_c"):
        yield from robot.picture(part)
        yield from robot.scroll(12)
    yield from robot.scroll(-60)
    top = settings().levels
    return {
        "status": status,
        "levels": [sorted(group.name for group in level.children) for level in top.children],
        "groups": sorted(g.name for g in settings().groups),
        "triangles": [
            [g.triangles[k] for k in range(settings().level_count)] for g in settings().groups
        ],
    }


def build():
    """Build, undo, redo, another frame, remove."""
    status = yield from robot.press("crowd_lod.build")
    yield 1.0
    found = {"status": status, "points": points(), **shown()}
    yield from robot.picture("07_built")
    robot.undo()
    yield 1.0
    found["undone"] = {
        "build": settings().build is None,
        "levels": settings().levels is not None,
        "points": points(),
    }
    robot.redo()
    yield 1.0
    found["redone"] = points()
    figures = yield from after(lambda: scene().frame_set(90))
    found["frame 90"] = {"points": points(), **figures}
    found["painted"] = yield from painted()
    before = robot.snapshot()
    found["removed"] = yield from robot.press("crowd_lod.remove_build")
    found["points removed"] = points()
    found["changed"] = robot.changes(before)
    return found


def painted():
    """Paint the map while the animation is played: whether it counts at once, and in the end.

    Whether the painting is undone so.
    """
    trajectory_of = robot.display().trajectory_of
    image = settings().map_image
    world = trajectory_of(scene()).world
    pixels = image.pixels[:]
    with robot.over():
        bpy.ops.screen.animation_play()
    yield 1.5
    moved = pixels[4:] + pixels[:4]
    time.sleep(overlay().LOOK_AGAIN)
    trajectory_of(scene())  # looks now, and so not again at once, however slow the machine
    image.pixels[:] = moved
    soon = []
    yield from robot.until(
        lambda: soon.append(trajectory_of(scene()).world is world) or not soon[-1]
    )
    with robot.over():
        bpy.ops.screen.animation_cancel(restore_frame=True)
    image.pixels[:] = pixels
    scene().frame_set(90)
    labels = trajectory_of(scene()).world.labels
    return {
        "looks": len(soon),
        "other": not soon[-1],
        "again": labels.tobytes() == world.labels.tobytes(),
    }


def points():
    """Agents that the camera sees in each LOD's point object, or None without a build."""
    if settings().build is None:
        return None
    seen = (each for each in settings().build.objects if each.visible_camera)
    return [
        len(each.data.vertices) for each in sorted(seen, key=lambda each: each["crowd_lod_level"])
    ]


def preview():
    settings().output_folder = str(FOLDER / "output")
    settings().frames = "1,60"
    settings().width = 320
    before = robot.snapshot()
    status = yield from robot.press("crowd_lod.preview")
    yield from robot.picture("08_preview_done")
    files = sorted(path.name for path in (FOLDER / "output" / "preview").iterdir())
    return {"status": status, "files": files, "changed": robot.changes(before)}


def escape():
    """Esc in the middle of a long preview."""
    settings().output_folder = str(FOLDER / "escaped")
    settings().frames = "1:200"
    settings().step = 1
    before = robot.snapshot()
    status = yield from robot.press("crowd_lod.preview", escape_after=3.0)
    yield from robot.picture("09_escaped")
    return {
        "status": status,
        "changed": robot.changes(before),
        "folder": (FOLDER / "escaped").exists(),
    }


def no_camera():
    """Buttons and overlay without a camera, then with one again."""
    camera = scene().camera
    settings().frames = "1,60"
    found = {"overlay": (yield from after(lambda: film(None))), "buttons": {}}
    yield from robot.picture("10_no_camera")
    for name in ("build", "preview"):
        before = robot.snapshot()
        status = yield from robot.press(f"crowd_lod.{name}")
        found["buttons"][name] = {"status": status, "changed": robot.changes(before)}
        yield from robot.picture(f"11_no_camera_{name}")
        yield from robot.dismiss()
    found["camera is back"] = yield from after(lambda: film(camera))
    return found


def film(camera):
    scene().camera = camera


def deleted():
    """The scene that is shown goes."""
    shown_scene = scene()
    robot.window().scene = next(other for other in bpy.data.scenes if other is not shown_scene)
    bpy.data.scenes.remove(shown_scene)
    yield from robot.drawn()
    return {"scene": scene().name}


def plaza():
    status = yield from robot.sample("plaza")
    few_agents()
    status = [status, (yield from robot.press("crowd_lod.populate"))]
    robot.view_3d().spaces[0].region_3d.view_perspective = "CAMERA"
    yield from robot.until(lambda: overlay().latest(scene()))
    yield 1.0
    yield from robot.picture("13_plaza")
    return {"status": status, **shown()}


def lifecycle():
    """In the chapter's scene, anew."""
    status = yield from robot.sample("chapter")
    few_agents()
    status = [status, (yield from robot.press("crowd_lod.populate"))]
    return {"status": status} | (yield from life.lifecycle(FOLDER))


def leave():
    """Blender is quit amid a preview."""
    settings().output_folder = str(FOLDER / "left")
    settings().frames = "1:200"
    settings().step = 1
    with robot.over():
        status = bpy.ops.crowd_lod.preview("INVOKE_DEFAULT")
    yield from robot.until(lambda: (FOLDER / "left").exists())
    return {"status": sorted(status), "begun": (FOLDER / "left").exists()}


for old in ("output", "escaped", "left"):
    shutil.rmtree(FOLDER / old, ignore_errors=True)
robot.perform(session(), results, FOLDER)
