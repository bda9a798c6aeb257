"""Random orders of our operators, undo and redo: python undo_sequences.py FOLDER FIRST_SEED COUNT.

FOLDER takes the file that each sequence starts from, a small crowd, and previews. Each step is
printed before it is taken, so that the last line names the step that crashed Blender. Every state
that an undo or a redo leads to must be one that the file was in before. tests/ui/undo_keys.py takes
the same steps in a window.
"""

import random
import sys
from collections import defaultdict
from pathlib import Path

import bpy

sys.path.append(str(Path(__file__).parents[1]))
from support.coarse_characters import coarsen  # noqa: E402

STEPS = 9
IN_A_WINDOW = "inspect", "render_viewport"
WEIGHTS = {"build": 6, "bake": 4, "make_levels": 3, "remove_build": 2}
KINDS = (
    "actions armatures cameras collections lights materials meshes node_groups objects scenes texts"
).split()
ANY = "any state"
MARK = "undo sequences"  # a world, whose property `step` tells in which step's state the file is


class Hands:
    """Presses buttons without a window."""

    def press(self, name: str, properties: dict):
        try:
            getattr(bpy.ops.crowd_lod, name)("EXEC_DEFAULT", True, **properties)
        except RuntimeError as error:  # it tells the user what is missing
            assert "Traceback" not in str(error), error
        yield from ()

    def undo(self):
        if bpy.ops.ed.undo.poll():
            bpy.ops.ed.undo()
        yield from ()

    def redo(self):
        if bpy.ops.ed.redo.poll():
            bpy.ops.ed.redo()
        yield from ()


def sequence(seed: int, hands):
    """Take STEPS random steps; yields where the `hands` have to wait."""
    chance = random.Random(seed)
    states = defaultdict(list)
    names = [name for name in sorted(dir(bpy.ops.crowd_lod)) if name not in IN_A_WINDOW]
    bpy.data.worlds.new(MARK).use_fake_user = True
    print(f"sequence {seed}:", end=" ", flush=True)
    for step in range(STEPS):
        if step and chance.random() < 0.45:
            way = chance.choice(("undo", "undo", "redo"))
            for _ in range(chance.randint(1, 3)):
                print(way, end=" ", flush=True)
                yield from getattr(hands, way)()
                use(chance)
                if (
                    MARK in bpy.data.worlds and "step" in bpy.data.worlds[MARK]
                ):  # else back before the first step
                    now = state()
                    before = states[bpy.data.worlds[MARK]["step"]]
                    assert ANY in before or now in before, [
                        [(a, b) for a, b in zip(now, each, strict=True) if a != b]
                        for each in before
                    ]
        else:
            name = chance.choices(names, [WEIGHTS.get(each, 1) for each in names])[0]
            if not getattr(bpy.ops.crowd_lod, name).poll():
                continue
            print(name, end=" ", flush=True)
            change(chance)
            if MARK not in bpy.data.worlds:
                bpy.data.worlds.new(MARK).use_fake_user = True
            bpy.data.worlds[MARK]["step"] = step
            bpy.ops.ed.undo_push(message="settings")
            states[step] = [state()]
            yield from hands.press(name, named(name))
            use(chance)
            states[step].append(state())
            if name == "update_all":  # each of its steps can be undone alone
                states[step].append(ANY)
    print("held", flush=True)


def named(name: str) -> dict:
    """Which sample scene, and which preset fits the scene's map; no other operator has a name."""
    fits = "plaza" if bpy.context.scene.name.startswith("Plaza") else "chapter"
    return {"sample": {"name": "chapter"}, "machine_preset": {"name": fits}}.get(name, {})


def quicken(scene: bpy.types.Scene, folder: str = "") -> None:
    """Make a new sample scene quick to work with; what it writes goes to the folder, if there is
    one.
    """
    settings = scene.crowd_lod
    scene.frame_end, settings.count = 5, min(settings.count, 200)
    settings.frames = "1,5"
    settings.width = 64
    settings.verify_count = 1
    settings.output_folder = folder or settings.output_folder
    if settings.characters:
        coarsen(settings)


def change(chance: random.Random) -> None:
    """Another setting, now and then."""
    settings = bpy.context.scene.crowd_lod
    quicken(bpy.context.scene)
    which = chance.randrange(5)
    if which == 0:
        settings.level_count = chance.randint(1, 4)
    elif which == 1:
        settings.count = chance.randint(10, 200)
    elif which == 2:
        settings.choice = chance.choice(("BY_DISTANCE", "BY_TOLERANCE"))
    elif which == 3:
        bpy.context.scene.render.use_motion_blur = chance.random() < 0.5


def use(chance: random.Random) -> None:
    """Look at all that is there, as windows, renders and other add-ons do."""
    bpy.context.view_layer.update()
    for collection in bpy.data.collections:
        for item in collection.all_objects:
            assert item.name in bpy.data.objects
    list(bpy.context.evaluated_depsgraph_get().object_instances)
    if chance.random() < 0.5:
        bpy.context.scene.frame_set(chance.randint(1, 40))
    if chance.random() < 0.1 and bpy.app.background:
        render = bpy.context.scene.render
        render.resolution_x = 64
        render.resolution_y = 36
        render.engine = "BLENDER_WORKBENCH"
        bpy.ops.render.render()


def state() -> list:
    """What the file holds: names by kind, what is in each collection and object, what the settings
    name.
    """
    found = [sorted(block.name_full for block in getattr(bpy.data, kind)) for kind in KINDS]
    found.append(
        sorted(image.name_full for image in bpy.data.images if image.type != "RENDER_RESULT")
    )
    inside = [
        (each.name, sorted(o.name for o in each.objects), sorted(c.name for c in each.children))
        for each in bpy.data.collections
    ]
    data = [
        (o.name, o.data.name if o.data else "", [m.name for m in o.modifiers])
        for o in bpy.data.objects
    ]
    chosen = [_chosen(scene.crowd_lod) for scene in bpy.data.scenes]
    return [*found, sorted(inside), sorted(data), chosen]


def _chosen(settings) -> list:
    blocks = settings.characters, settings.levels, settings.build, settings.machine
    lists = ([each.name for each in several] for several in (settings.groups, settings.overrides))
    return [*(block and block.name for block in blocks), *lists, settings.shot_plan]


def saved(folder: str) -> str:
    """The path of a file with the sample scene `chapter`, of coarse characters and few frames,
    populated.
    """
    from crowd_lod_extension import sample_scenes

    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    sample_scenes.make("chapter", scene)
    scene.crowd_lod.characters.children.unlink(bpy.data.collections["heavy"])
    for material in bpy.data.materials:
        material.node_tree.nodes.new("ShaderNodeTexImage").image = bpy.data.images.new(
            f"{material.name} image", 256, 256
        )
    quicken(scene, folder)
    settings = scene.crowd_lod
    settings.count = 100
    bpy.ops.crowd_lod.populate()
    path = f"{folder}/crowd.blend"
    bpy.ops.wm.save_as_mainfile(filepath=path)
    return path


def main(folder: str, first: str, count: str) -> None:
    import crowd_lod_extension

    crowd_lod_extension.register()
    path = saved(folder)
    for seed in range(int(first), int(first) + int(count)):
        bpy.ops.wm.open_mainfile(filepath=path, load_ui=False)
        bpy.ops.ed.undo_push(message="opened")
        for _ in sequence(seed, Hands()):
            pass


if __name__ == "__main__":
    main(*sys.argv[1:])
