"""The settings and the shot that LODs were made for, and a forecast of what others would change."""

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.crowd.paces import mixed_in
from ...crowd_lod.culling.camera import Camera
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import number
from ...crowd_lod.frame.frame_range import spread_evenly
from ...crowd_lod.levels.cost_model import Holdings
from ...crowd_lod.levels.lengths import DARKER, NEAR_ENOUGH, allowed_lengths, read_curve
from ...crowd_lod.levels.selection import GroupShot, View
from ..blender import provenance, scene_data
from ..blender.cameras import read_cameras
from ..blender.machine_costs import costs_of
from ..blender.sidebar_answers import hold
from ..characters.cast_provenance import cast_inputs, of_characters
from ..characters.stored_groups import count_of
from ..machine.scene_world import actions_named
from ..scene.scene_crowd import GROUP
from ..scene.shot_exceptions import digest_of
from ..scene.shot_reference import OVERRIDES
from ..settings.budgets import NO_BUDGET, budget_words, holds_anyway, limits_levels
from .level_objects import GIVEN
from .selection import MOST_FRAMES, Limits, choose_candidates

# custom properties of the collection of all LODs: what they were made for, and what they were
# chosen from
MADE_FOR = "crowd_lod_made_for"
CHOSEN_FROM = "crowd_lod_chosen_from"
# changes after which there are other candidates than those that LODs were chosen from
UNFORESEEN = {"actions", "decimation", "character groups"}


@dataclass(frozen=True)
class Forecast:
    """About what Make LOD Meshes would change.

    farther: LODs begin at so many times the distance.
    rows: of each group whose LODs would change, its name, the parts of the triangles that its LODs
        have now, and those that they would have.
    """

    farther: float
    rows: tuple[tuple[str, tuple[float, ...], tuple[float, ...]], ...]

    @property
    def short(self) -> str:
        """Return the change in a line: how many groups would have coarser LODs, finer or none."""
        without = sum(len(then) == 1 for _, _, then in self.rows)
        coarser = sum(_mean(then) < _mean(now) for _, now, then in self.rows)
        counts = {
            "coarser": coarser,
            "finer": len(self.rows) - coarser - without,
            "without LODs": without,
        }
        parts = [
            f"{count} {'group' if count == 1 else 'groups'} {which}"
            for which, count in counts.items()
            if count
        ]
        return f"About: {', '.join(parts)}" if parts else "About the same LODs would do"

    @property
    def sentence(self) -> str:
        """Return the change in full."""
        parts = [f"{name} from {_parts(now)} to {_parts(then)}" for name, now, then in self.rows]
        where = (
            "where they did"
            if abs(self.farther - 1) < 0.005
            else f"at {number(self.farther)} times the distance"
        )
        change = (
            f"would change, about: {'; '.join(parts)}"
            if parts
            else "would keep about the same LODs"
        )
        return f"LODs begin {where} when they were made. Make LOD Meshes {change}."


def _mean(ratios: Sequence[float]) -> float:
    """Return the mean part of LODs beside the character; 1 if there are none."""
    return sum(ratios[1:]) / len(ratios[1:]) if len(ratios) > 1 else 1.0


def _parts(ratios: Sequence[float]) -> str:
    """Return the parts of the triangles that a group's LODs have, in words."""
    return (
        f"{', '.join(f'{100 * ratio:g}' for ratio in ratios)}% of the triangles"
        if len(ratios) > 1
        else "no LODs"
    )


def note_shot(
    scene: bpy.types.Scene,
    groups: Sequence[Group],
    shots: Sequence[GroupShot | None],
    keep: Sequence[Sequence[int]],
    inputs: Mapping[str, str],
) -> None:
    """Store in the scene's LODs what they were made for, and what they were chosen from.

    groups: with values of all their candidates.
    shots: where each group's agents are; None: not chosen by tolerance.
    keep: for each group, the candidates that it has.
    inputs: digests of the characters, see of_characters.
    """
    top = scene.crowd_lod.levels
    provenance.keep(top, MADE_FOR, _facts(scene) | inputs | _overrides(scene.crowd_lod))
    top[CHOSEN_FROM] = json.dumps(
        {
            "camera": _scale(scene),
            "given": any(GIVEN in item for item in top.all_objects),
            "groups": [
                {
                    "name": group.name,
                    "radius": float(group.radius),
                    "diagonal": float(group.diagonal),
                    "triangles": [*map(int, group.triangles)],
                    "bounds": [*map(float, group.bounds)],
                    "shaded": [*map(float, group.shaded)],
                    "characters": shot.characters,
                    "holdings": vars(shot.holdings),
                    "keep": [*map(int, indices)],
                    "views": [
                        _packed(view.counted()) for view in spread_evenly(shot.views, MOST_FRAMES)
                    ],
                }
                for group, shot, indices in zip(groups, shots, keep, strict=True)
                if shot is not None
            ],
        }
    )


def _packed(view: View) -> list:
    about = np.array(
        [
            np.round(1000 * np.log(view.distance)),
            view.character,
            np.broadcast_to(view.agents, view.character.shape),
        ]
    )
    text = base64.b64encode(zlib.compress(about.astype(np.int32).tobytes())).decode()
    return [view.camera.pixels_per_unit, view.nearest, view.farthest, text]


def _unpacked(stored: list, camera: Camera, farther: float) -> View:
    density, nearest, farthest, text = stored
    about = (
        np.frombuffer(zlib.decompress(base64.b64decode(text)), np.int32)
        .reshape(3, -1)
        .astype(np.intp)
    )
    return View(
        replace(camera, density=density * farther),
        nearest,
        farthest,
        np.exp(about[0] / 1000),
        about[1],
        about[2],
    )


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


def _forecast_inputs(scene: bpy.types.Scene) -> tuple:
    settings = scene.crowd_lod
    stored = settings.levels.get(CHOSEN_FROM) if settings.levels is not None else None
    return stored, _facts(scene), _scale(scene), settings.shading_counts, provenance.changes


@hold(_forecast_inputs)
def forecast(scene: bpy.types.Scene) -> Forecast | None:
    """Return about what making LODs anew would change; None if that is not known.

    It rests on the agents that the shot showed when the LODs were made: agents that another
    lens leaves out, or brings in, do not count. No LOD is made or measured. It is not known
    with a limit of memory or a budget, for to try tolerances until LODs fit takes seconds; by
    ratio; with LODs that artists gave; and where the candidates themselves would be others
    (UNFORESEEN).
    """
    settings = scene.crowd_lod
    stored = settings.levels.get(CHOSEN_FROM) if settings.levels is not None else None
    if not isinstance(stored, str) or settings.memory or settings.choice != "BY_TOLERANCE":
        return None
    if limits_levels(settings):
        return None
    news = changed(scene)
    if not news or UNFORESEEN & set(news) or edited(scene):
        return None
    # a script may have put anything there
    with suppress(CrowdError, ValueError, LookupError, TypeError, zlib.error):
        return _forecast(scene, json.loads(stored))
    return None


def _forecast(scene: bpy.types.Scene, stored: dict) -> Forecast | None:
    """Choose again from what is `stored`, as the camera is now."""
    settings = scene.crowd_lod
    camera = _camera(scene)
    now = _scale(scene)
    before = stored["camera"]
    if stored["given"] or camera is None or not now or not before or now[0] != before[0]:
        return None
    closer = now[1] / before[1]
    costs = costs_of(scene)
    shading = settings.shading_counts
    shots = [
        GroupShot(
            [_unpacked(view, camera, closer) for view in entry["views"]],
            entry["characters"],
            costs,
            shading,
            Holdings(**entry["holdings"]),
        )
        for entry in stored["groups"]
    ]
    groups = [
        _foreseen(settings, entry, shot)
        for entry, shot in zip(stored["groups"], shots, strict=True)
    ]
    known = [range(len(group.triangles)) for group in groups]
    keep = choose_candidates(
        Limits(settings.tolerance), groups, shots, 1.0, known, [()] * len(groups)
    ).keep
    rows = []
    for entry, group, then in zip(stored["groups"], groups, keep, strict=True):
        before = _ratios(entry["triangles"], entry["keep"])
        after = _ratios(group.triangles, then)
        if before != after:
            rows.append((entry["name"], before, after))
    tolerance = provenance.read_inputs(settings.levels, MADE_FOR)["tolerance"]
    return Forecast(closer * float(tolerance.split()[0]) / settings.tolerance, tuple(rows))


def _foreseen(settings, stored: dict, shot: GroupShot) -> Group:
    """Return the group with about the candidates that it would have now.

    stored: those that it had.
    """
    bounds, triangles, shaded = (
        np.array(stored[name]) for name in ("bounds", "triangles", "shaded")
    )
    tolerance = round(settings.tolerance, 6)
    finest = stored["diagonal"] / triangles[0]
    lengths = allowed_lengths(
        shot.views, stored["radius"], tolerance, finest, finer=DARKER if len(shaded) else 1.0
    )
    made = bounds[stored["keep"]]
    near = [made[(made >= NEAR_ENOUGH * length) & (made <= length)] for length in lengths]
    lengths = [
        float(fitting.max(initial=0)) or length
        for fitting, length in zip(near, lengths, strict=True)
    ]
    deviates = bounds > 0
    columns = {"triangles": -1.0, "shaded": 1.0} if len(shaded) else {"triangles": -1.0}
    values = {
        name: read_curve(
            lengths,
            list(zip(bounds[deviates], np.array(stored[name])[deviates], strict=True)),
            power,
        )
        for name, power in columns.items()
    }
    return Group(
        stored["name"],
        0.0,
        stored["radius"],
        0.0,
        1.0,
        triangles=(
            int(triangles[0]),
            *values["triangles"].round().astype(int).clip(1, triangles[0]).tolist(),
        ),
        deviations=(0.0, *lengths),  # a group has bounds only if it was measured
        shaded=(0.0, *values["shaded"].tolist()) if len(shaded) else (),
        diagonal=stored["diagonal"],
    )


def _ratios(triangles: Sequence[int], keep: Sequence[int]) -> tuple[float, ...]:
    """Return the parts of the character's triangles that the candidates to `keep` have."""
    return tuple(float(f"{triangles[k] / triangles[0]:.2g}") for k in keep)


def _camera(scene: bpy.types.Scene) -> Camera | None:
    try:
        return read_cameras(scene, scene.view_layers[0].depsgraph)[0]
    except CrowdError:
        return None


def _scale(scene: bpy.types.Scene) -> list:
    """Return [kind of camera, what its pixels per unit go by]; [] without a camera.

    If the lens moves, this is the resolution alone.
    """
    camera = _camera(scene)
    if camera is None:
        return []
    return [camera.kind, camera.pixels_per_unit if "lens" in _facts(scene) else camera.pixels[0]]


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
        names.update(*(actions_named(scene, group.name) for group in scene.crowd_lod.groups))
    plain = sorted(name for name in names if not mixed_in(name))
    return ", ".join(["the own", *plain]) + (" with cross-fades" if len(plain) < len(names) else "")
