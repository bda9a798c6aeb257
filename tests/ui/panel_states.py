"""Draws our panels in any state of file and settings: blender --python panel_states.py -- FOLDER
PORT.

test_panels.py listens on the PORT of this machine. It gets one line that says what settings there
are, and sends the changes that make a state, a line each. After each change all panels are drawn
and all polls asked; the answer to a line is what was said on stderr, which panels were drawn, how
many crowds the scene has, and which settings and buttons the sidebar has after the last change.
All panels are open.
"""

import contextlib
import io
import json
import socket
import sys
from pathlib import Path

import bpy

HERE = Path(__file__).parent
sys.path += map(str, (HERE, HERE.parent, HERE.parent / "faults"))
import drawn_items  # noqa: E402
import robot  # noqa: E402
from robot import scene, settings  # noqa: E402
from small_plaza import REST, opened, saved  # noqa: E402

FOLDER, PORT = sys.argv[sys.argv.index("--") + 1 :]
FOLDER = Path(FOLDER)
PORT = int(PORT)
KINDS_OF_DATA = {
    "Collection": "collections",
    "Mesh": "meshes",
    "Image": "images",
    "Text": "texts",
    "Object": "objects",
}
drawn: set[str] = set()  # panels, since the last answer
# of each panel in the sidebar its settings and buttons, as it was drawn last
items: dict[tuple[str, str], tuple[list[str], list[str]]] = {}


def session():
    """Yields the seconds to wait before going on."""
    sys.modules[
        f"{robot.MODULE}.operators.ui.step_panel"
    ].StepPanel.bl_options = set()  # all open: what is closed is not drawn
    robot.toggle()
    yield from saved(str(FOLDER / "panels.blend"), str(FOLDER / "panels_files"))
    (FOLDER / "garbage.npz").write_text("no plan")
    robot.view_3d().spaces[0].show_region_ui = True
    yield 0.5
    robot.sidebar(robot.view_3d()).active_panel_category = "Crowd LOD"
    panels, menus = (
        [name for name in dir(bpy.types) if name.startswith(f"CROWDLOD_{kind}_")]
        for kind in ("PT", "MT")
    )
    step_panel = sys.modules[f"{robot.MODULE}.operators.ui.step_panel"]
    kinds = [getattr(bpy.types, name) for name in panels]
    drawn_items.note([kind for kind in kinds if issubclass(kind, step_panel.Sidebar)], items)
    for name in panels:
        getattr(bpy.types, name).append(lambda _, __, name=name: drawn.add(name))
    owners = {
        "settings": settings(),
        "crowd": settings().crowds[0],
        "group": settings().groups[0],
        "override": settings().overrides[0],
    }
    owners["editor"] = scene().crowd_lod_editor
    known = {
        owner: list(filter(None, map(told, values.bl_rna.properties)))
        for owner, values in owners.items()
    }
    with (
        socket.create_connection(("localhost", PORT)) as line,
        line.makefile("rw", encoding="utf-8") as talk,
    ):
        said: dict = {"known": known, "done": sorted(DONE), "panels": panels, "menus": menus}
        while True:
            talk.write(json.dumps(said) + "\n")
            talk.flush()
            asked = talk.readline()
            if not asked:
                return
            said = yield from answered(json.loads(asked))


def told(setting):
    """A setting as test_panels.py needs it: name, type, least, most, how many, choices.

    None for what nobody sets.
    """
    if setting.is_readonly or setting.type == "COLLECTION" or setting.is_hidden:
        return None
    low, high = (setting.hard_min, setting.hard_max) if setting.type in ("INT", "FLOAT") else (0, 0)
    choices = [item.identifier for item in setting.enum_items] if setting.type == "ENUM" else []
    return setting.identifier, setting.type, low, high, getattr(setting, "array_length", 0), choices


def answered(changes: list):
    """Make the changes in the file as it was saved.

    Draw after each of them, until one draw says something.
    """
    if robot.overlay()._failure:
        robot.toggle()
    bpy.context.preferences.view.ui_scale = 1.0
    sys.modules.pop("fast_simplification", None)
    yield from opened(str(FOLDER / "panels.blend"))
    drawn.clear()
    items.clear()
    said = io.StringIO()
    for n, change in enumerate(changes):
        with contextlib.redirect_stderr(said):
            items.clear()
            change_it(*change)
            if change[0] not in ("undo", "redo"):
                with robot.over():
                    bpy.ops.ed.undo_push(message=str(change))
            yield from robot.drawn(REST)
            for name in dir(bpy.ops.crowd_lod):
                for region in ("WINDOW", "UI"):
                    with robot.over(region):
                        getattr(bpy.ops.crowd_lod, name).poll()
            if change[0] in ("popover", "menu"):
                robot.key("ESC")
                yield from robot.drawn(REST)
        if "Traceback" in said.getvalue():
            return {"after": changes[: n + 1], "said": said.getvalue()[-3000:]}
    return {
        "said": "",
        "drawn": sorted(drawn),
        "crowds": len(settings().crowds),
        "items": [*items.values()],
    }


def change_it(what: str, *words):
    if what == "set":
        owner, n, name, value = words
        several = {
            "settings": [settings()],
            "crowd": settings().crowds,
            "group": settings().groups,
            "override": settings().overrides,
            "editor": [scene().crowd_lod_editor],
        }[owner]
        if len(several):
            put(several[n % len(several)], name, value)
    elif what == "press":
        with robot.over(), contextlib.suppress(RuntimeError):  # the sentence for the user
            getattr(bpy.ops.crowd_lod, words[0])("EXEC_DEFAULT", True, **dict(*words[1:]))
    elif what == "popover":
        with robot.over():
            bpy.ops.wm.call_panel("INVOKE_DEFAULT", name=words[0])
    elif what == "menu":
        with robot.over():
            bpy.ops.wm.call_menu("INVOKE_DEFAULT", name=words[0])
    elif what in ("undo", "redo"):
        robot.key("Z", ctrl=True, shift=what == "redo")
    else:
        DONE[what]()


def put(owner, name: str, value):
    """Set it; a pointer, to the data-block of its kind with this number, or to none."""
    setting = owner.bl_rna.properties[name]
    if setting.type == "POINTER":
        blocks = getattr(bpy.data, KINDS_OF_DATA[setting.fixed_type.identifier])
        value = blocks[value % len(blocks)] if value is not None and len(blocks) else None
    elif setting.subtype == "FILE_PATH" and value in ("garbage.npz", "plan.npz"):
        value = str(FOLDER / value if value == "garbage.npz" else FOLDER / "panels_files" / value)
    setattr(owner, name, value)


def gone(block, blocks):
    if block is not None:
        blocks.remove(block)


def children(collection) -> list:
    return [] if collection is None else [*collection.children]


def emptied(collection):
    for child in children(collection):
        collection.children.unlink(child)


def crowded(collection):
    for _ in range(0 if collection is None else 12):
        collection.children.link(bpy.data.collections.new("more"))


def renamed():
    for child in children(settings().characters):
        child.name = f"other {child.name}"


def crowd():
    """The active crowd, made if there is none."""
    return settings().active_crowd


def unknown(owner, name: str):
    """A number that is no choice, as another version of Crowd LOD may leave it in a file."""
    raw = owner.bl_system_properties_get(do_create=True) if bpy.app.version >= (5, 0, 0) else owner
    raw[name] = 77


def marked(value):
    if settings().build is not None:
        settings().build["crowd_lod_baked"] = value


def lost(image):
    """Its file is gone: it has no pixels."""
    if image is not None:
        image.source = "FILE"
        image.filepath = "//gone.png"


def preset(name: str):
    with robot.over():
        bpy.ops.crowd_lod.machine_preset(name=name)


def shown(other):
    robot.window().scene = other


def removed():
    if len(bpy.data.scenes) > 1:
        bpy.data.scenes.remove(scene())


def failed():
    """A proof of the scene as it is, in which an agent is off."""
    artifacts = sys.modules[f"{robot.MODULE}.operators.freshness.artifacts"]
    worst = {"agent": 7, "frame": 3, "lod": 1, "group": 0, "error_px": 2.0, "predicted_px": 1.0}
    parts = artifacts.proof_parts(scene())
    artifacts.note_proof(scene(), artifacts.ProofResult("Failed: all.", False, parts, worst))


def filmed(item):
    scene().camera = item


DONE = {
    "characters removed": lambda: gone(settings().characters, bpy.data.collections),
    "characters emptied": lambda: emptied(settings().characters),
    "character removed": lambda: gone(
        next(iter(children(settings().characters)), None), bpy.data.collections
    ),
    "characters renamed": renamed,
    "meshes removed": lambda: [bpy.data.meshes.remove(mesh) for mesh in [*bpy.data.meshes]],
    "LODs removed": lambda: gone(settings().levels, bpy.data.collections),
    "LODs emptied": lambda: emptied(settings().levels),
    "more LODs": lambda: crowded(settings().levels),
    "build removed by hand": lambda: gone(settings().build, bpy.data.collections),
    "build emptied": lambda: emptied(settings().build),
    "build marked as baked": lambda: marked([1.0, 0.0, 1.0, 5.0]),
    "mark of the bake spoilt": lambda: marked("baked"),
    "groups forgotten": lambda: settings().groups.clear(),
    "group forgotten": lambda: settings().groups.remove(0),
    "another group": lambda: settings().groups.add(),
    "machine spoilt": lambda: crowd().machine and crowd().machine.from_string('{"states": ['),
    "machine emptied": lambda: crowd().machine and crowd().machine.clear(),
    "machine removed": lambda: gone(crowd().machine, bpy.data.texts),
    "machine of the market": lambda: preset("market"),
    "an area": lambda: crowd().areas.add(),
    "map lost": lambda: lost(crowd().map_image),
    "map removed": lambda: gone(crowd().map_image, bpy.data.images),
    "proof failed": failed,
    "no camera": lambda: filmed(None),
    "camera no camera": lambda: filmed(
        next(item for item in bpy.data.objects if item.type != "CAMERA")
    ),
    "camera removed": lambda: gone(scene().camera, bpy.data.objects),
    "objects removed": lambda: [bpy.data.objects.remove(item) for item in [*bpy.data.objects]],
    "choice unknown": lambda: unknown(settings(), "choice"),
    "overrides by unknown": lambda: [unknown(entry, "select_by") for entry in settings().overrides],
    "type of override unknown": lambda: [unknown(entry, "type") for entry in settings().overrides],
    "library missing": lambda: sys.modules.update(fast_simplification=None),
    "crowds forgotten": lambda: settings().crowds.clear(),
    "new scene": lambda: shown(bpy.data.scenes.new("New")),
    "copy of the scene": lambda: shown(scene().copy()),
    "other scene": lambda: shown(bpy.data.scenes[-1 if scene() == bpy.data.scenes[0] else 0]),
    "scene removed": removed,
    "another view layer": lambda: scene().view_layers.new("more"),
    "motion blur": lambda: setattr(scene().render, "use_motion_blur", True),
    "another frame": lambda: scene().frame_set(3),
    "imperial units": lambda: setattr(scene().unit_settings, "system", "IMPERIAL"),
    "narrow sidebar": lambda: setattr(bpy.context.preferences.view, "ui_scale", 2.5),
    "wide sidebar": lambda: setattr(bpy.context.preferences.view, "ui_scale", 0.6),
}
robot.perform(session(), {}, FOLDER)
