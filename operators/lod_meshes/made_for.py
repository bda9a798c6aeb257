"""The settings and the shot that LODs were made for, and what has changed since."""

from collections.abc import Mapping
from contextlib import suppress

import bpy

from ...crowd_lod.crowd.paces import mixed_in
from ...crowd_lod.errors import CrowdError
from ..blender import provenance, scene_data
from ..characters.cast_provenance import cast_inputs, of_characters
from ..characters.characters import all_characters
from ..characters.stored_groups import count_of
from ..machine.scene_world import actions_named
from ..scene.scene_crowd import GROUP
from ..scene.shot_exceptions import digest_of
from ..scene.shot_reference import OVERRIDES
from ..settings.budgets import NO_BUDGET, budget_words, holds_anyway, limits_levels

MADE_FOR = "crowd_lod_made_for"  # custom property of the collection of all LODs


def inputs_of(scene: bpy.types.Scene) -> dict[str, str]:
    """Return what LODs depend on now besides their characters, by name."""
    return _facts(scene) | _overrides(scene.crowd_lod)


def note_inputs(scene: bpy.types.Scene, made_for: Mapping[str, str]) -> None:
    """Store in the scene's LODs what they were made for.

    made_for: of_characters and inputs_of, as they were when the work began.
    """
    provenance.keep(scene.crowd_lod.levels, MADE_FOR, made_for)


def changed(scene: bpy.types.Scene) -> dict[str, tuple[str, str]]:
    """Return what has changed since the LODs were made: {name: (then, now)}.

    Also LODs and groups that the settings ask for and that are not there: nothing else is known of
    LODs that do not say what they were made for. For characters that were edited see edited().
    """
    settings = scene.crowd_lod
    if settings.levels is None:
        return {}
    before = provenance.read_inputs(settings.levels, MADE_FOR)
    now = _facts(scene)
    if "budget" in now and before.get("budget") == NO_BUDGET and holds_anyway(settings):
        del now["budget"]  # LODs for it would be the same
    return _lacks(settings) | {
        name: (before[name], now[name])
        for name in now
        if name in before and before[name] != now[name]
    }


def edited(scene: bpy.types.Scene) -> list[str]:
    """Return the characters edited since their LODs were made, such as "the character adult"."""
    if scene.crowd_lod.levels is None:
        return []
    before = of_characters(provenance.read_inputs(scene.crowd_lod.levels, MADE_FOR))
    now = of_characters(cast_inputs(scene)) if before else {}
    return [name for name in now if name in before and before[name] != now[name]]


def _lacks(settings) -> dict[str, tuple[str, str]]:
    """Return how many LODs and groups there are, if the settings ask for others; as `changed`."""
    levels = settings.levels.children
    asked = count_of(settings)
    changes = {"levels": (str(len(levels)), str(asked))} if len(levels) < asked else {}
    names = [group.name for group in settings.groups]
    homes = [*levels[0].children] if levels else []
    if names and len(homes) != len(names):
        return changes | {"character groups": (str(len(homes)), str(len(names)))}
    renamed = [
        (home[GROUP], name)
        for home, name in zip(homes, names, strict=False)
        if home.get(GROUP, name) != name
    ]
    if renamed:
        changes["character groups"] = tuple(
            ", ".join(column) for column in zip(*renamed, strict=True)
        )
    return changes


def outdated(scene: bpy.types.Scene) -> str:
    """Return a sentence on what has changed since the LODs were made; "" if nothing."""
    news = ", ".join(f"{name} {then} (now {now})" for name, (then, now) in changed(scene).items())
    names = provenance.name_inputs(edited(scene) + _overrides_edited(scene.crowd_lod))
    told = [f"for {news}"] * bool(news) + [f"before {names} changed"] * bool(names)
    return f"LODs were made {', '.join(told)}" if told else ""


def _overrides(settings) -> dict[str, str]:
    """Return the digest of the overrides by their name; {} where LODs do not depend on them."""
    if not limits_levels(settings):
        return {}
    return {OVERRIDES: provenance.text_digest(digest_of(settings))}


def _overrides_edited(settings) -> list[str]:
    """Return [OVERRIDES] if LODs were chosen for a budget under others than there are now."""
    before = provenance.read_inputs(settings.levels, MADE_FOR) if settings.levels else {}
    now = _overrides(settings)
    return [name for name in now if name in before and before[name] != now[name]]


def to_make_again(scene: bpy.types.Scene) -> str:
    """Return a sentence on why a build should wait until LODs are made again; "" if it need not."""
    settings = scene.crowd_lod
    if settings.choice == "BY_TOLERANCE" and settings.memory != settings.memory_made:
        return (
            "Memory for Characters has changed since the LOD meshes were made: press Make LOD "
            "Meshes, and Build again."
        )
    if names := edited(scene):
        return (
            f"Since the LOD meshes were made, {provenance.name_inputs(names)} changed: press Make "
            f"LOD Meshes, and Build again."
        )
    return ""


def _facts(scene: bpy.types.Scene) -> dict[str, str]:
    """Return what the LODs depend on, besides the crowd. A lens that moves is left out."""
    settings = scene.crowd_lod
    render = scene.render
    camera = scene.camera
    if settings.choice == "BY_RATIO":
        return {
            "ratios": ", ".join(
                f"{ratio:.3g}" for ratio in settings.ratios[1 : settings.level_count]
            )
        }
    part = render.resolution_percentage / 100
    facts = {
        "tolerance": f"{settings.tolerance:g} px",
        "memory": f"{settings.memory:g} MB",
        "budget": budget_words(settings),
        "resolution": f"{render.resolution_x * part:.0f} x {render.resolution_y * part:.0f}",
        "engine": scene_data.engine_of(scene).capitalize(),
        "actions": _actions(scene),
    }
    if camera is not None and camera.type == "CAMERA" and camera.data.animation_data is None:
        data = camera.data
        facts["lens"] = (
            f"{data.ortho_scale * scene_data.meters(scene):.4g} m wide"
            if data.type == "ORTHO"
            else f"{data.lens:.4g} mm"
        )
    return facts


def _actions(scene: bpy.types.Scene) -> str:
    """Return the actions in which LODs are measured, in words."""
    names: set[str] = set()
    with suppress(CrowdError):  # a bad state machine is told elsewhere
        names.update(*(actions_named(scene, each.name) for each in all_characters(scene)))
    plain = sorted(name for name in names if not mixed_in(name))
    return ", ".join(["the own", *plain]) + (" with cross-fades" if len(plain) < len(names) else "")
