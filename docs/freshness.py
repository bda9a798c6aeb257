"""Writes docs/notes/freshness.md: what each artifact is made of, as the code says it.

    .venv-3.13/bin/python docs/freshness.py

The parts are those of the sample chapter, by distance and by tolerance.
"""

from pathlib import Path

import bpy
import crowd_lod_extension
from crowd_lod_extension.operators.freshness import artifacts
from crowd_lod_extension.operators.freshness.parts import lod_parts
from crowd_lod_extension.sample_scenes import make

PAGE = Path(__file__).parent / "notes" / "freshness.md"
HEAD = """# Artifacts and their parts

Written by `docs/freshness.py` from the code: change the code, and run it again.

An artifact is what a step makes. It is out of date where one of its parts is another than when it
was made; messages name these parts. `operators/freshness/artifacts.py` is the one place that
answers, [files.md](files.md#what-something-was-made-of) tells what a part holds. The characters
are those of the sample chapter.

| made by | artifact's parts |
| --- | --- |
"""


def parts_of(scene, artifact):
    """The names of the artifact's parts, in their order."""
    if artifact is not artifacts.LODS:
        return list(artifact.parts(scene))
    names = {}
    for choice in ("BY_DISTANCE", "BY_TOLERANCE"):
        scene.crowd_lod.choice = choice
        names |= lod_parts(scene)
    return [*names, "levels", "character groups"]


def page() -> str:
    """Return the page; it opens an empty file for the sample scene."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    make("chapter", scene)
    scene.crowd_lod.count = 20
    scene.crowd_lod.occlusion = True
    scene.crowd_lod.budget_triangles = 10**6  # LODs are chosen for it
    bpy.ops.crowd_lod.populate()
    steps = (
        artifacts.CROWD,
        artifacts.LODS,
        artifacts.PLAN,
        artifacts.BUILD,
        artifacts.BAKE,
        artifacts.PROOF,
    )
    rows = [f"| *{step.label}* | {', '.join(parts_of(scene, step))} |" for step in steps]
    return HEAD + "\n".join(rows) + "\n"


if __name__ == "__main__":
    crowd_lod_extension.register()
    PAGE.write_text(page(), encoding="utf-8")
