"""The order of the work: which button comes next, and what there is to say about it."""

import bpy

from ...crowd_lod.simplification.decimate import missing_library
from ..build import staleness
from ..build.render_setup import BAKED
from ..crowd import needs
from ..lod_meshes.made_for import outdated
from ..overlay import viewport_overlay

LABELS = {
    "crowd_lod.characters_from_selection": "Characters from Selection",
    "crowd_lod.populate": "Populate",
    "crowd_lod.make_levels": "Make LOD Meshes",
    "crowd_lod.plan_shot": "Plan Shot",
    "crowd_lod.build": "Build",
    "crowd_lod.verify": "Verify",
    "crowd_lod.bake": "Bake",
}


def following(scene: bpy.types.Scene) -> str:
    """Return the operator that comes next in the work."""
    settings = scene.crowd_lod
    done = (
        settings.characters is not None,
        len(settings.groups) > 0,
        settings.levels is not None and not outdated(scene),
        bool(settings.shot_plan),
        settings.build is not None and not staleness.changed(scene),
    )
    name = next((name for name, made in zip(LABELS, done, strict=False) if not made), "crowd_lod.verify")
    return "crowd_lod.bake" if name == "crowd_lod.build" and settings.build is not None and BAKED in settings.build else name


def messages(scene: bpy.types.Scene) -> list[tuple[str, str]]:
    """Return (sentence, icon) of all that the user should know, the most urgent first."""
    settings, shown = scene.crowd_lod, viewport_overlay.shown_of(scene)
    problem, library = viewport_overlay.problem(scene), missing_library()
    errors = [problem, library]
    if settings.characters is not None:
        errors += [needs.camera(scene), settings.trouble]
    found = [(sentence, "ERROR") for sentence in errors if sentence]
    found += [(note, "INFO") for note in (shown.notes if shown else ())]
    if changed := staleness.changed(scene):
        found.append((f"Changed since Build: {', '.join(changed)}", "FILE_REFRESH"))
    if lods := outdated(scene):
        found.append((lods, "FILE_REFRESH"))
    return [*found, (f"Next: {LABELS[following(scene)]}", "FORWARD")]
