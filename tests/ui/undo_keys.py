"""Two and three buttons, Ctrl-Z and Ctrl-Shift-Z: blender --python undo_keys.py -- FOLDER FIRST
COUNT.

All pairs of our operators, and fifty random triples, are in as many parts as there are operators;
COUNT parts are taken, from the FIRST on, which is 0. They are taken in a saved file of the plaza
that has a build, a shot plan and overrides, with the overlay on, after Render Viewport Image and
Preview. After each pair or triple all is undone, redone and undone again by keys; every state must
be one that the file was in before. A crash ends Blender before results.json is written; the last
line printed then names what crashed it.
"""

import random
import sys
from pathlib import Path

import bpy

HERE = Path(__file__).parent
sys.path += map(str, (HERE, HERE.parent, HERE.parent / "faults"))
import robot  # noqa: E402
from small_plaza import REST, opened, pressed, saved, worked  # noqa: E402
from undo_sequences import quicken, state  # noqa: E402

FOLDER, FIRST, COUNT = sys.argv[sys.argv.index("--") + 1 :]
FOLDER = Path(FOLDER)
CHOSEN = range(int(FIRST), int(FIRST) + int(COUNT))
TRIPLES = 50
FILES = str(FOLDER / "undo_files")
FRESH = 12  # pairs and triples from one opening of the file to the next
results = {"operators": [], "pairs": 0, "triples": 0}


def session():
    """Yields the seconds to wait before going on."""
    path = str(FOLDER / "undo.blend")
    yield from saved(path, FILES)
    names = results["operators"] = [
        name for name in sorted(dir(bpy.ops.crowd_lod)) if makes_a_step(name)
    ]
    # each operator once the first and once the second of a part's pairs
    pairs = [
        (name, names[(n + by) % len(names)])
        for by in CHOSEN
        if by < len(names)
        for n, name in enumerate(names)
    ]
    triples = [
        random.Random(seed).choices(names, k=3)
        for seed in range(TRIPLES)
        if seed % len(names) in CHOSEN
    ]
    known: list = []
    for number, chosen in enumerate([*pairs, *triples]):
        if number % FRESH == 0:
            yield from opened(path)
            known = [state()]
            yield from pressed("render_viewport")
            yield from pressed("preview")
        print("undo keys:", *chosen, flush=True)
        yield from there_and_back(chosen, known)
        results["pairs" if len(chosen) == 2 else "triples"] += 1
    results["worked"] = sorted(worked)
    yield from robot.picture("30_after_undo")


def makes_a_step(name: str) -> bool:
    """Whether the button can make an undo step: not if it asks for a file, or adds a preset, which
    is a file of the user.

    After such a button Ctrl-Z takes back what was done before it.
    """
    return not {"filepath", "remove_active"} & {
        *getattr(bpy.ops.crowd_lod, name).get_rna_type().properties.keys()
    }


def there_and_back(chosen, known: list):
    """Press the buttons `chosen`, undo and redo all by keys.

    `known`: all states of the file since it was opened.
    """
    known.append(state())
    for name in chosen:
        quicken(robot.scene(), FILES)
        yield from pressed(name)
        known.append(state())
    for shift in (False, True, False):
        for _ in chosen:
            robot.key("Z", ctrl=True, shift=shift)
            yield from robot.drawn(REST)
            now = state()
            assert now in known, [
                chosen,
                shift,
                [(a, b) for a, b in zip(now, known[-1], strict=True) if a != b],
            ]
    for extra in robot.windows()[
        1:
    ]:  # of Render Viewport Image: till here they showed what undo took away
        with bpy.context.temp_override(window=extra):
            bpy.ops.wm.window_close()
    yield REST  # Blender crashes where a scene is shown in the same round of its loop


robot.perform(session(), results, FOLDER)
