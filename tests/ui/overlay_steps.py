"""The overlay in a window: blender --python overlay_steps.py -- FOLDER.

Changes what it shows behind Blender's back, and where.

Nothing here asks for a redraw after a change, except where it waits for one that must not draw.
"""

import sys
from pathlib import Path

import bpy

sys.path[:0] = map(str, Path(__file__).parents[:2])
import lifecycle as life  # noqa: E402
import robot  # noqa: E402
from robot import overlay, scene, settings  # noqa: E402

FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
results = {}
painted = []  # one for each drawing of characters


def session():
    yield from robot.sample("chapter")
    settings().count = 400
    settings().overlay_mode = "BOXES"
    yield from robot.press("crowd_lod.populate")
    robot.view_3d().spaces[0].region_3d.view_perspective = "CAMERA"
    paint = overlay().paint
    overlay().paint = lambda *arguments: (painted.append(1), paint(*arguments))
    yield from robot.until(lambda: painted)
    for step in (changes, rest, eyedropper, legends, local_view, build, deleted):
        print(f"--- {step.__name__}", flush=True)
        results[step.__name__] = yield from step()


def shown():
    return overlay().display_of(scene())


def followed(change, condition):
    """Whether the condition on what is shown came to hold after the change, all by itself, and did
    not before.
    """
    before = condition(shown())
    change()
    yield from robot.until(lambda: shown().frame is not None and condition(shown()), 10.0)
    return [before, shown().frame is not None and condition(shown())]


def put(name, value):
    return lambda: setattr(settings(), name, value)


def changes():
    """Settings by script, a text, an image, a driver."""
    found = {}
    yield 1.5  # whatever was late is drawn
    found["count"] = yield from followed(put("count", 500), lambda now: len(now.frame.crowd) == 500)
    first = shown().frame.trajectory
    found["seed"] = yield from followed(
        put("seed", 9), lambda now: now.frame.trajectory is not first
    )
    found["color"] = yield from followed(
        put("overlay_color", "GROUP"), lambda now: now.colors.names == names()
    )
    found["mode"] = yield from followed(
        put("overlay_mode", "POINTS"), lambda now: not now.batches.draws
    )
    machine = settings().machine
    text = machine.as_string()
    found["text"] = yield from followed(
        lambda: machine.from_string(text.replace('"walk', '"go')),
        lambda now: any("go" in s for s in now.frame.trajectory.machine.states),
    )
    image = settings().map_image
    world = shown().frame.trajectory.world
    pixels = image.pixels[:]
    yield from robot.drawn()  # looks at the image, and so does not at once again
    found["image"] = yield from followed(
        lambda: paint_on(image, pixels), lambda now: now.frame.trajectory.world is not world
    )
    image.pixels[:] = pixels
    empty = bpy.data.objects.new("number", None)
    scene().collection.objects.link(empty)
    driver = scene().driver_add("crowd_lod.crowds[0].count").driver
    variable = driver.variables.new()
    variable.name = "x"
    variable.type = "TRANSFORMS"
    driver.expression = "300 + x"
    variable.targets[0].id = empty
    variable.targets[0].transform_type = "LOC_X"
    found["driver"] = yield from followed(
        lambda: move(empty, 50.0), lambda now: len(now.frame.crowd) == 350
    )
    scene().driver_remove("crowd_lod.crowds[0].count")
    crowd = settings().crowds[0]
    crowd.keyframe_insert("count", frame=1)
    crowd.count = 420
    crowd.keyframe_insert("count", frame=30)
    found["animation"] = yield from followed(
        lambda: scene().frame_set(30), lambda now: len(now.frame.crowd) == 420
    )
    scene().animation_data_clear()
    off = yield from switched()
    return found | {"switched": off}


def names():
    return tuple(group.name for group in settings().groups)


def move(item, x):
    item.location.x = x


def paint_on(image, pixels):
    image.pixels[:] = pixels[4:] + pixels[:4]


def switched():
    """The overlay off and on again by script: how often it was drawn meanwhile."""
    settings().overlay = False
    yield 2.0
    off = len(painted)
    settings().overlay = True
    yield from robot.until(lambda: len(painted) > off)
    return len(painted) > off


def rest():
    """Nothing changes, nothing is drawn."""
    yield 6.0  # what was due is drawn
    before = len(painted)
    yield 4.0
    return {"drawn": len(painted) - before}


def eyedropper():
    """The mark of the agent is drawn after the mouse moved, without anything else."""
    places = {int(agent): life.clip(agent) for agent in shown().frame.buckets.order[:40]}
    agent = min(
        (a for a, (x, y, _, w) in places.items() if abs(x) < 0.4 * w and abs(y) < 0.4 * w),
        key=lambda a: places[a].w,
    )
    yield 2.0
    before = len(painted)
    with robot.over():
        bpy.ops.crowd_lod.inspect("INVOKE_DEFAULT")
    life.mouse("MOUSEMOVE", "NOTHING", agent)
    yield from robot.until(lambda: settings().agent == agent and len(painted) > before, 10.0)
    pointed = settings().agent == agent
    after = len(painted)
    life.mouse("LEFTMOUSE", "PRESS", agent)
    life.mouse("LEFTMOUSE", "RELEASE", agent)
    yield 1.0
    yield from robot.picture("30_eyedropper")
    return {"pointed": pointed, "drawn": after > before, "kept": settings().agent == agent}


def legends():
    """A picture of each legend, and what it says."""
    found = {}
    for color in ("LOD", "STATE", "GROUP", "REASON"):
        settings().overlay_color = color
        yield 1.0
        yield from robot.picture(f"31_{color.lower()}")
        found[color] = [line.text for line in overlay().hud.legend(shown().colors)]
    settings().agent = -1
    settings().overlay_color = "LOD"
    return found | {
        "states": list(shown().frame.trajectory.machine.states),
        "groups": list(names()),
    }


def characters_drawn():
    """Whether a drawing of the viewport draws characters."""
    before = len(painted)
    yield from robot.drawn()
    return len(painted) > before


def local(item):
    """Whether characters are drawn in the local view of this object; then leaves local view."""
    for other in scene().objects:
        other.select_set(other == item, view_layer=scene().view_layers[0])
    scene().view_layers[0].objects.active = item
    with robot.over():
        bpy.ops.view3d.localview()
    drawn = yield from characters_drawn()
    yield from robot.picture(f"32_local_{item.name}")
    with robot.over():
        bpy.ops.view3d.localview()
    return drawn


def local_view():
    ground = next(item for item in scene().objects if item.name.startswith("Ground"))
    scene().view_layers[0].layer_collection.children[settings().characters.name].exclude = False
    character = next(item for item in settings().characters.all_objects if item.type == "MESH")
    return {
        "ground": (yield from local(ground)),
        "character": (yield from local(character)),
        "global": (yield from characters_drawn()),
    }


def build():
    """Characters are drawn only where the build does not show."""
    settings().choice = "BY_DISTANCE"
    settings().level_count = 2
    yield from robot.press("crowd_lod.make_levels")
    yield from robot.press("crowd_lod.build")
    space = robot.view_3d().spaces[0]
    top = settings().build
    place = next(p for p in scene().view_layers[0].layer_collection.children if p.collection == top)
    found = {"built": (yield from characters_drawn())}
    yield from robot.picture("33_built")
    hide = {
        "excluded": (place, "exclude", True),
        "hidden in the layer": (place, "hide_viewport", True),
        "hidden in viewports": (top, "hide_viewport", True),
        "object type": (space, "show_object_viewport_mesh", False),
    }
    for name, (owner, attribute, value) in hide.items():
        setattr(owner, attribute, value)
        found[name] = yield from characters_drawn()
        setattr(owner, attribute, not value)
    found["again"] = yield from characters_drawn()
    found["local view of the build"] = yield from local(top.objects[0])
    with robot.over():
        bpy.ops.crowd_lod.remove_build()
    found["removed"] = yield from characters_drawn()
    return found


def deleted():
    """A character group is deleted: who is told, by itself."""
    child = settings().characters.children[0]
    name = child.name
    with robot.over():
        bpy.data.batch_remove([*child.all_objects, child])
    yield from robot.until(lambda: any(name in note for note in shown().notes), 10.0)
    yield from robot.picture("34_deleted")
    return {"name": name, "notes": list(shown().notes)}


robot.perform(session(), results, FOLDER)
