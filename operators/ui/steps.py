"""The order of the work: which button comes next, and what there is to say about it."""

import bpy

from ...crowd_lod.simplification.decimate import missing_library
from ..blender.guard import troubles_of
from ..blender.sidebar_answers import keep_at_work
from ..lod_meshes.made_for import changed, edited, outdated
from ..overlay import viewport_overlay
from ..overlay.appearance import missing_groups
from ..render_setup import staleness
from ..render_setup.appended_builds import standing_still
from ..render_setup.render_setup import BAKED
from ..runs.verify_button import verdict_of
from ..scene.shot_reference import notes_on_file
from ..settings import needs
from ..sources import crowd_sources


@keep_at_work
def next_operator(scene: bpy.types.Scene) -> str:
    """Return the operator that comes next in the work; "" once the shot is proved."""
    settings = scene.crowd_lod
    frame = viewport_overlay.latest(scene)
    is_done = {
        "crowd_lod.characters_from_selection": settings.characters is not None,
        "crowd_lod.populate": len(settings.groups) > 0
        and not missing_groups(settings)
        and not crowd_sources.outdated(scene),
        "crowd_lod.make_levels": settings.levels is not None and not outdated(scene),
        "crowd_lod.plan_shot": bool(settings.shot_plan) and not (frame and frame.unplanned),
        builder_of(scene): settings.build is not None and not staleness.changed(scene),
        "crowd_lod.verify": verdict_of(scene).startswith("OK"),
    }
    return next((name for name, done in is_done.items() if not done), "")


def builder_of(scene: bpy.types.Scene) -> str:
    """Return the operator that made the scene's build, or that makes one."""
    build = scene.crowd_lod.build
    return "crowd_lod.bake" if build is not None and BAKED in build else "crowd_lod.build"


@keep_at_work
def news_of_lods(scene: bpy.types.Scene) -> list[str]:
    """Return what has changed since the LODs were made."""
    settings_changed = [f"{name} (was {then})" for name, (then, _) in changed(scene).items()]
    return settings_changed + edited(scene)


def label_of(operator: str) -> str:
    """Return the label of an operator, such as crowd_lod.populate."""
    return getattr(bpy.ops.crowd_lod, operator.partition(".")[2]).get_rna_type().name


@keep_at_work
def messages(scene: bpy.types.Scene) -> list[tuple[str, str]]:
    """Return (sentence, icon) of all that the user should know, the most urgent first."""
    settings = scene.crowd_lod
    drawn_frame = viewport_overlay.display_of(scene)
    errors = [
        viewport_overlay.problem(scene),
        missing_library(),
        standing_still(scene),
        *troubles_of(scene),
    ]
    if settings.characters is not None:
        errors.append(needs.camera(scene))
    lines = [(sentence, "ERROR") for sentence in dict.fromkeys(errors) if sentence]
    if operator := next_operator(scene):
        lines.append((f"Next: {label_of(operator)}", "FORWARD"))
    if names := staleness.changed(scene):
        lines.append((f"Changed since Build: {', '.join(names)}", "FILE_REFRESH"))
    lines += [
        (note, "FILE_REFRESH") for note in crowd_sources.outdated(scene) if note not in errors
    ]
    if lods := outdated(scene):
        lines.append((lods, "FILE_REFRESH"))
    if verdict := verdict_of(scene):
        lines.append((verdict, "CHECKMARK" if verdict.startswith("OK") else "ERROR"))
    # warnings of Populate do not stop the work: the next step is named before them
    if settings.characters is not None:
        lines += [(warning, "ERROR") for warning in settings.trouble.splitlines()]
    if note := notes_on_file(settings):
        lines.append((note, "INFO"))
    return [*lines, *((note, "INFO") for note in (drawn_frame.notes if drawn_frame else ()))]
