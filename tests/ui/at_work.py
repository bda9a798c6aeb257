"""What users and scripts do while a step works, in a real Blender's window:
blender --enable-event-simulate --python at_work.py -- FOLDER.

Types every key that could touch the scene, looks around, and disturbs steps by script. Others can
run it to see what a window does with each of them; results.json says so, row by row.
"""

import sys
from pathlib import Path

import bpy

sys.path[:0] = map(str, Path(__file__).parents[:2])
import robot  # noqa: E402
from robot import overlay, scene, settings  # noqa: E402

FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
results = {}
# (what is typed, where, with which keys held)
TOUCHES = [
    *((key, "WINDOW", ()) for key in "A G H I M N S X TAB DEL SPACE F2 F3 F12 ONE TWO".split()),
    *((key, "WINDOW", ()) for key in "LEFT_ARROW RIGHT_ARROW UP_ARROW PAGE_UP".split()),
    *((key, "WINDOW", ("ctrl",)) for key in "Z S N O V NUMPAD_0 PAGE_UP WHEELUPMOUSE".split()),
    ("Z", "WINDOW", ("ctrl", "shift")),
    ("NUMPAD_0", "WINDOW", ("ctrl", "alt")),
    ("WHEELUPMOUSE", "WINDOW", ("alt",)),
    *((key, "WINDOW", ()) for key in ("LEFTMOUSE", "RIGHTMOUSE")),
    *((key, "UI", ()) for key in ("LEFTMOUSE", "RIGHTMOUSE", "BACK_SPACE", "NUMPAD_MINUS")),
    ("WHEELUPMOUSE", "UI", ("ctrl",)),
]
LOOKS = ["MIDDLEMOUSE", "WHEELUPMOUSE", "NUMPAD_1", "NUMPAD_4", "NUMPAD_PLUS", "HOME"]


def session():
    yield from robot.sample("chapter")
    settings().count = 200
    settings().output_folder = str(FOLDER / "output")
    settings().overlay_mode = "BOXES"
    settings().frames = "1:200"
    settings().step = 1
    settings().width = 64
    yield from robot.press("crowd_lod.populate")
    robot.view_3d().spaces[0].show_region_ui = True
    yield 0.5
    robot.sidebar(robot.view_3d()).active_panel_category = "Crowd LOD"
    yield 0.5
    for part in (touches, looks, locked_camera, second_window, playback, proof, scripts, leave):
        print(f"--- {part.__name__}", flush=True)
        results[part.__name__] = yield from part()


def module(name: str):
    return sys.modules[f"{robot.MODULE}.operators.blender.{name}"]


def at_work():
    return module("steps").at_work()


def begin(name: str = "preview"):
    with robot.over():
        getattr(bpy.ops.crowd_lod, name)("INVOKE_DEFAULT", True)
    yield from robot.until(lambda: at_work() is not None and at_work().slices.progress > 0)
    assert at_work(), f"{name} was over at once"


def end():
    robot.key("ESC")
    yield from robot.until(lambda: at_work() is None)
    yield 0.3


def strike(kind: str, where: str = "WINDOW", held: tuple = (), window=None):
    """Type a key, or click, over the viewport or its sidebar."""
    window = window or robot.window()
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == where)
    x = region.x + region.width // 3
    y = region.y + region.height // 3
    keys = dict.fromkeys(held, True)
    window.event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=y)
    window.event_simulate(type=kind, value="PRESS", x=x, y=y, **keys)
    if kind == "MIDDLEMOUSE":
        for step in range(1, 5):
            window.event_simulate(type="MOUSEMOVE", value="NOTHING", x=x + 8 * step, y=y + 4 * step)
            yield 0.2
    if "WHEEL" not in kind:
        window.event_simulate(type=kind, value="RELEASE", x=x, y=y, **keys)
    yield 0.2


def state() -> dict:
    """What a touch could change, and a look must not."""
    own = [item for item in bpy.data.objects if item.name in scene().objects]
    return {
        "scene": scene().name,
        "frame": scene().frame_current,
        "objects": sorted(item.name for item in own),
        "modes": sorted({item.mode for item in own}),
        "selected": sorted(item.name for item in own if item.select_get()),
        "hidden": sorted(item.name for item in own if item.hide_get()),
        "camera": [round(value, 4) for row in scene().camera.matrix_world for value in row],
        "camera's name": scene().camera.name,
        "lens": scene().camera.data.lens,
        "agents": settings().count,
        "windows": len(robot.windows()),
        "playing": robot.window().screen.is_animation_playing,
        "file": bpy.data.filepath,
        "workspace": robot.window().workspace.name,
    }


def view() -> list[float]:
    look = robot.view_3d().spaces[0].region_3d
    return [round(v, 4) for row in look.perspective_matrix for v in row]


def touches():
    """By key: what it changed; nothing at all, and the step goes on."""
    yield from begin()
    changed = {}
    for kind, where, held in TOUCHES:
        before = state()
        yield from strike(kind, where, held)
        now = state()
        told = [name for name in now if now[name] != before[name]]
        changed[" ".join((*held, kind, where))] = told if at_work() else [*told, "the step ended"]
        if not at_work():
            yield from begin()
    status = at_work().status
    yield from robot.picture("at_work")
    yield from end()
    return {"changed": changed, "status": status}


def looks():
    """By key: whether the view is another one, and the scene as it was."""
    yield from begin()
    before = state()
    moved = {}
    for kind in LOOKS:
        earlier = view()
        yield from strike(kind)
        yield from robot.until(lambda seen=earlier: view() != seen, limit=10.0)
        moved[kind] = view() != earlier
    same = state() == before
    yield from end()
    return {"moved": moved, "same": same}


def locked_camera():
    """Through a camera that is locked to the view, nothing moves it."""
    space = robot.view_3d().spaces[0]
    space.lock_camera = True
    space.region_3d.view_perspective = "CAMERA"
    yield 0.5
    yield from begin()
    before = state()
    for kind in LOOKS:
        yield from strike(kind)
    same = state() == before
    yield from end()
    space.lock_camera = False
    return {"same": same}


def second_window():
    """In another window nothing is touched either, and Esc ends the step."""
    with robot.over():
        bpy.ops.wm.window_new()
    yield 1.0
    other = robot.windows()[-1]
    yield from begin()
    yield 0.5
    before = state()
    for kind in ("TAB", "DEL", "RIGHT_ARROW", "A"):
        yield from strike(kind, window=other)
    same = state() == before
    yield from strike("ESC", window=other)
    ended = at_work() is None
    if not ended:
        yield from end()
    with bpy.context.temp_override(window=other):
        bpy.ops.wm.window_close()
    yield 0.5
    return {"same": same, "ended": ended}


def playback():
    """Playback stops when a step begins."""
    with robot.over():
        bpy.ops.screen.animation_play()
    yield 0.5
    yield from begin()
    playing = robot.window().screen.is_animation_playing
    yield from end()
    return {"playing": playing}


def proof():
    """While Verify works, the viewport shows the build alone; its text says which frame."""
    settings().frames = "2"
    scene().render.resolution_percentage = 10
    yield from robot.press("crowd_lod.make_levels")
    yield from robot.press("crowd_lod.build")
    drawn = []
    paint = overlay().paint
    overlay().paint = lambda *arguments: (drawn.append(1), paint(*arguments))
    frame = scene().frame_current
    yield from begin("verify")
    drawn.clear()
    status = ""
    while at_work():
        robot.view_3d().tag_redraw()
        if "at frame" in at_work().status:
            status = at_work().status
        yield 0.3
    overlay().paint = paint
    found = {"drawn": len(drawn), "status": status, "back": scene().frame_current == frame}
    yield from robot.press("crowd_lod.remove_build")
    settings().frames = "1:200"
    return found


def show_a_steps_scene():
    robot.window().scene = next(s for s in bpy.data.scenes if s.name.startswith("."))


def look_at_another_scene():
    robot.window().scene = bpy.data.scenes["Other"]


def delete_mesh():
    items = settings().characters.all_objects
    bpy.data.meshes.remove(next(item.data for item in items if item.type == "MESH"))


def rename_rig():
    items = settings().characters.all_objects
    next(item for item in items if item.type == "ARMATURE").name = "Renamed"


def save():
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "saved.blend"), copy=True)


def delete_scene():
    doomed = scene()
    look_at_another_scene()
    bpy.data.scenes.remove(doomed)


SCRIPTS = {
    "another scene": look_at_another_scene,
    "a step's scene": show_a_steps_scene,
    "toggle": robot.toggle,
    "undo": robot.undo,
    "save": save,
    "rename": rename_rig,
    "mesh": delete_mesh,
    "delete scene": delete_scene,
}


def scripts():
    """By act and step: whether it is over, and what it left."""
    path = str(FOLDER / "before.blend")
    bpy.data.scenes.new("Other")
    home = scene().name
    bpy.ops.wm.save_as_mainfile(filepath=path)
    told = {}
    for act, disturb in SCRIPTS.items():
        for name in ("make_levels", "bake", "preview"):
            bpy.ops.wm.open_mainfile(filepath=path)
            yield 1.0
            robot.window().scene = bpy.data.scenes[home]
            if name == "make_levels":
                bpy.data.collections.remove(settings().levels)
            with robot.over():
                bpy.ops.ed.undo_push(message="Before the step")
            yield from begin(name)
            if act == "a step's scene":
                yield from robot.until(
                    lambda: any(s.name.startswith(".") for s in bpy.data.scenes) or not at_work()
                )
                if not at_work():
                    continue
            disturb()
            yield from robot.until(lambda: at_work() is None, limit=1.0)
            still = at_work() is not None
            if still:
                yield from end()
            yield 0.5
            told[f"{act}: {name}"] = {
                "went on": still,
                "scenes": sorted(s.name for s in bpy.data.scenes if s.name.startswith(".")),
                "gray": not bpy.ops.crowd_lod.sample.poll(),
            }
    return told


def leave():
    """Blender is quit amid a step."""
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / "before.blend"))
    yield 1.0
    yield from begin()
    return {"begun": at_work() is not None}


robot.perform(session(), results, FOLDER)
