"""From the scene's settings to the core's crowd: groups, map, trajectory, plan."""

from collections.abc import Generator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import bpy
import numpy as np

from ...crowd_lod.crowd.agents import Action, Group
from ...crowd_lod.crowd.maps import FARTHEST
from ...crowd_lod.culling.camera import Camera
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame import Frame, plan
from ...crowd_lod.frame.shadows import Surroundings, surround
from ...crowd_lod.levels.assignment import MOST_LEVELS, LevelPolicy
from ...crowd_lod.progress import aside, finished, share
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import kept_meshes, scene_data, stored_values
from ..blender.cameras import read_cameras, read_shutter
from ..blender.operator import Stepwise
from ..blender.performance import Part, Performance, performance_of
from ..blender.props import group_of
from ..characters.action_troubles import told_of_actions
from ..characters.character_extent import SOLES, Act, bounds, frames_of, hangs, posing, sole, standing, walked
from ..characters.characters import GROUP, all_characters, characters_of, told_of_left_out, told_of_unsaved
from ..characters.glow import told_of_glow
from ..characters.take_action import told_of_gliding
from ..machine import map_areas
from ..machine.scene_world import actions_named, bias_of, check_maps
from ..settings import needs
from ..settings.lengths import set_lengths
from ..sources import crowd_sources
from .plausible import told_of_extent, told_of_feet, told_of_plausibility
from .shot_reference import use_of
from .stuck_agents import find

STANDS = 0.01  # of a character's size: feet that walk less in a cycle stand, and the action plays by time
OF_LEVELS = (
    "vertices",
    "triangles",
    "deviations",
    "bounds",
    "rms",
    "worst",
    "diagonal",
    "shaded",
)  # what is known of a group's LOD meshes


def measure_groups(scene: bpy.types.Scene) -> tuple[Group, ...]:
    """Measure all groups in one go; see `measuring_groups`."""
    return finished(measuring_groups(scene))


def measuring_groups(
    scene: bpy.types.Scene, reaches: Mapping[str, tuple[float, float, float]] = {}
) -> Generator[float, None, tuple[Group, ...]]:
    """Measure bounding sphere, stride and period of all groups.

    Yields the progress, 0 to 1, and returns the groups. Measurements of LOD meshes are kept.

    reaches: (lowest, center, radius) by group, for groups that are not to be measured.
    """
    settings = scene.crowd_lod
    fps, meters = scene.render.fps / scene.render.fps_base, scene_data.meters(scene)
    known = {}
    with suppress(CrowdError):  # what is spoilt is measured anew
        known = {group.name: group for group in groups_of(settings)}
    measured, cast = {}, all_characters(scene)
    for g, (name, objects, origin, variant_of, chance) in enumerate(cast):
        performance, on_ground = performance_of(name, objects, actions_named(scene, name)), stands(settings, name)
        acted: list[Act] = []
        base = measured.get(variant_of)  # props are no feet
        if name in reaches and len(performance.parts) == 1:
            low, center, radius = reaches[name]
        else:
            acted = yield from share(_acted(objects, performance), g / len(cast), (g + 1) / len(cast))
            # while two actions mix, feet may dip into the ground: nobody is lifted for that
            plain = [act for part, act in zip(performance.parts, acted, strict=True) if not part.mixed]
            low = base.lowest if base else standing(plain, origin[2])
            center, radius = bounds(objects[0].name, (*origin[:2], origin[2] + low * on_ground), *(act.poses for act in acted))
        first, *others = performance.parts
        found = Group(name, center, radius, 0.0, (first.last - first.first) / fps, lowest=low, on_ground=on_ground)
        if acted:
            found = replace(found, height=float(np.median([np.ptp(pose[:, 2]) for pose in acted[0].poses])))
        if base:
            found = replace(found, stride=base.stride, actions=base.actions, variant_of=variant_of)
        else:
            told = _custom(settings.characters, name, "stride") / meters
            found = replace(found, stride=told or first.root.way, way=first.root.way)
            actions = {part.name: _action(part, act, fps, 2 * radius, meters) for part, act in zip(others, acted[1:], strict=True)}
            for part in (part for part in others if part.mixed):  # a cross-fade goes at the rate of the action to come
                actions[part.name] = replace(actions.get(part.mixed[1].name, found.action("")), name=part.name, way=0.0)
            found = replace(found, actions=tuple(actions.values()))
        kept = {key: getattr(known[name], key) for key in (*OF_LEVELS, "share", "scale")} if name in known else {}
        measured[name] = replace(found, chance=chance, **kept)
    return tuple(measured.values())


def _acted(objects: list[bpy.types.Object], performance: Performance) -> Generator[float, None, list[Act]]:
    """Measure the extent and the soles of `objects` over each action of the performance; see `posing`."""
    acts, count = [], len(performance.spans)
    for k, span in enumerate(performance.spans):
        poses = yield from share(posing(objects, frames_of(*span), performance), k / count, (k + 0.8) / count)
        soles: list[tuple[float, float]] = []
        for number in SOLES:
            looking = posing(objects, frames_of(*span, number), performance, sole)
            soles = yield from share(looking, (k + 0.8) / count, (k + 1) / count)
            if not hangs(soles):
                break
        acts.append(Act(poses, soles))
    return acts


def _action(part: Part, act: Act, fps: float, size: float, meters: float) -> Action:
    """Return the Action that a group plays as `part`; act: of it.

    size: of the group, in units of `meters`.
    """
    feet = walked(act)
    own = part.stride / meters if part.action is not None and part.action.get("stride") else part.stride
    stride, feet = (each if each > STANDS * size else 0.0 for each in (own or feet, feet))
    return Action(part.name, stride, (part.last - part.first) / fps, feet, part.root.way)


def stands(settings, name: str) -> bool:
    """Return whether the group `name`, or that which it is a variant of, is to stand on its lowest point."""
    entry = settings.groups.get(name) or settings.groups.get(group_of(name))
    return entry is None or entry.on_ground


def store_groups(settings, groups: tuple[Group, ...]) -> None:
    """Store the measured groups in the scene's settings.

    Groups of the same name keep their own thresholds, finest LOD, share and scale.
    """
    own = {
        g.name: (g.own_thresholds, tuple(g.thresholds), tuple(g.sizes), g.finest, g.share, tuple(g.scale)) for g in settings.groups
    }
    settings.groups.clear()
    for group in groups:
        entry = settings.groups.add()
        # see set_down
        for name in (
            "name",
            "center",
            "radius",
            "stride",
            "period",
            "diagonal",
            "on_ground",
            "lowest",
            "share",
            "scale",
            "variant_of",
            "chance",
        ):
            setattr(entry, name, getattr(group, name))
        for name in ("vertices", "triangles", "deviations", "bounds", "rms", "worst"):
            values = getattr(group, name)
            setattr(entry, name, (*values, *[0] * (MOST_LEVELS - len(values))))
        entry.actions.clear()
        for action in group.actions:
            own_action = entry.actions.add()
            own_action.name, own_action.stride, own_action.period = action.name, action.stride, action.period
        entry.shaded = (*group.shaded, *[-1] * (MOST_LEVELS - len(group.shaded)))
        if group.name in own:
            entry.own_thresholds, entry.thresholds, entry.sizes, entry.finest, entry.share, entry.scale = own[group.name]


def set_down(entry: bpy.types.PropertyGroup) -> None:
    """Update a group after on_ground changed: move its sphere and LODs to its feet."""
    entry.center += -entry.lowest if entry.on_ground else entry.lowest
    for variant in entry.id_data.crowd_lod.groups:
        if variant.variant_of == entry.name and variant.on_ground != entry.on_ground:
            variant.on_ground = entry.on_ground
    if entry.lowest:
        with suppress(CrowdError):  # there are no characters; nothing shows LODs then
            _place_levels(entry.id_data)


def _place_levels(scene: bpy.types.Scene) -> None:
    """Place the LODs of each group of `scene` at its feet."""
    settings = scene.crowd_lod
    levels = settings.levels.children if settings.levels is not None and not scene_data.shared(scene, "levels") else ()
    origins = {name: origin for name, _, origin in characters_of(scene)} if levels else {}
    feet = {group.name: group.feet for group in groups_of(settings)}
    for home in (home for level in levels for home in level.children):
        name = home.get(GROUP)
        if name in origins and name in feet:
            home.instance_offset = (*origins[name][:2], origins[name][2] + feet[name])


def _custom(top: bpy.types.Collection, name: str, key: str) -> float:
    """Return the custom property `key` of the group `name`, or 0.

    CrowdError if it is not a number from 0 to FARTHEST.
    """
    owner = top.children.get(name) or top.objects.get(name)
    if key not in owner:
        return 0.0
    return float(stored_values.read(owner, key, float, "set a number of meters, or remove it", bounds=(0, FARTHEST)))


def groups_of(settings) -> tuple[Group, ...]:
    """Return the measured groups of the settings."""
    return tuple(_group(g, lead_of(g), count_of(settings)) for g in settings.groups)


def lead_of(entry: bpy.types.PropertyGroup) -> bpy.types.PropertyGroup:
    """Return the entry of the settings that an entry of a group is a variant of; itself if of none."""
    return entry.variant_of and entry.id_data.crowd_lod.groups.get(entry.variant_of) or entry


def _group(entry, lead, count: int) -> Group:
    """Return the Group that `entry` of the settings holds, with at most `count` LODs.

    lead: see lead_of. CrowdError if its measurements are invalid.
    """
    made = sum(n > 0 for n in entry.triangles[:count])
    measured = made if entry.diagonal else 0
    # Blender keeps no infinity
    shaded = [np.inf if each > 1e30 else each for each in entry.shaded[:measured]]
    group = Group(
        entry.name,
        entry.center,
        entry.radius,
        entry.stride,
        entry.period,
        vertices=tuple(entry.vertices[:made]),
        triangles=tuple(entry.triangles[:made]),
        deviations=tuple(entry.deviations[:measured]),
        # a file of before bounds has none
        bounds=tuple(map(max, entry.bounds[:measured], entry.deviations[:measured])),
        rms=tuple(entry.rms[:measured]),
        worst=tuple(entry.worst[:measured]),
        diagonal=entry.diagonal,
        shaded=tuple(shaded) if all(each >= 0 for each in shaded) else (),
        lowest=entry.lowest,
        on_ground=entry.on_ground,
        share=round(lead.share, 6),
        scale=(round(min(lead.scale), 6), round(max(lead.scale), 6)),
        variant_of=entry.variant_of,
        chance=round(entry.chance, 6),
        actions=tuple(Action(action.name, action.stride, action.period) for action in entry.actions),
    )
    sizes = (
        group.share,
        group.chance,
        *group.scale,
        *(value for action in group.actions for value in (action.stride, action.period)),
        group.radius,
        group.stride,
        group.period,
        group.diagonal,
        *group.deviations,
        *group.bounds,
        *group.rms,
        *group.vertices,
    )
    if not all(0 <= size < np.inf for size in sizes) or not np.isfinite([group.center, group.lowest, *group.worst]).all():
        raise CrowdError(f"The measurements of the character group {group.name} are damaged: press Populate, then Make LOD Meshes.")
    return group


def count_of(settings, choice: str = "") -> int:
    """Return the number of LODs.

    By ratio that is the setting, by tolerance the number of LODs made, or 1 before they are.

    choice: BY_RATIO or BY_TOLERANCE in place of the settings' own.
    """
    if (choice or settings.choice) == "BY_RATIO":
        return settings.level_count
    return len(settings.levels.children) if settings.levels is not None else 1


def home_of(level: bpy.types.Collection, g: int, name: str) -> bpy.types.Collection:
    """Return the collection of the group `name` in the collection `level` of one LOD.

    CrowdError if it has no LOD meshes.

    g: index of the group.
    """
    home = level.children[g] if g < len(level.children) else None
    if home is None or not home.objects or home.get(GROUP, name) != name:
        raise CrowdError(f"The character group {name} has no LOD meshes in {level.name}: press Make LOD Meshes again.")
    return home


def policy_of(settings, choice: str = "") -> LevelPolicy:
    """Return the LOD policy of the settings.

    By tolerance, a LOD begins where its deviation shows that many pixels.

    choice: BY_RATIO or BY_TOLERANCE in place of the settings' own.
    """
    tolerant = (choice or settings.choice) == "BY_TOLERANCE"
    leads = [lead_of(group) for group in settings.groups]
    own = [_thresholds(group, settings) if group.own_thresholds and not tolerant else () for group in leads]
    return LevelPolicy(
        thresholds=(0.0,) * (count_of(settings, choice) - 1) if tolerant else _thresholds(settings, settings),
        group_thresholds=tuple(own) if any(own) else (),
        metric="PIXELS" if tolerant else settings.metric,
        tolerance=round(max(settings.tolerance, settings.memory_tolerance), 6) if tolerant else None,
        finest=tuple(group.finest for group in settings.groups) if tolerant and settings.memory_tolerance else (),
        margin=settings.margin if settings.margin_kind == "FIXED" else None,
        drop_lost=settings.drop_lost,
        shading=tolerant and settings.shading_counts,
    )


def _thresholds(owner, settings) -> tuple[float, ...]:
    """Return the thresholds of `owner`, settings or group, for the settings' metric."""
    chosen = owner.sizes if settings.metric == "PIXELS" else owner.thresholds
    return tuple(round(t, 6) for t in chosen[: settings.level_count - 1])


def trajectory_of(
    scene: bpy.types.Scene, groups: tuple[Group, ...] | None = None, depsgraph: bpy.types.Depsgraph | None = None
) -> Trajectory:
    """Return the scene's crowd over time, cached while its inputs stay the same.

    CrowdError if the crowd is not populated or a setting is bad.

    groups: measured groups in place of those that the settings hold.
    depsgraph: where objects are evaluated whose points are agents; the view layer's own if None.
    """
    groups = groups or groups_of(scene.crowd_lod)
    if not groups:
        raise CrowdError(f"The crowd of the scene {scene.name} is not populated: press Populate in the Crowd panel.")
    return crowd_sources.together(scene, groups, depsgraph)


def frame_of(  # noqa: PLR0913 - most are at hand, and read if not
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    time: float | None = None,
    camera: Camera | Sequence[Camera] | None = None,
    trajectory: Trajectory | None = None,
    around: Surroundings | None = None,
    shutter: Sequence[tuple[float, Sequence[Camera]]] | None = None,
) -> Frame:
    """Return the plan of the crowd at `time`, with the LODs of the scene's shot plan if it has one.

    time: frames of the animation; the scene's own if None (see scene_data.time_of).
    camera: one camera, or the eyes; the active ones as `depsgraph` has them if None.
    trajectory: the scene's, if it is at hand.
    around: with it, agents that the camera does not see but that still matter are found, too.
    shutter: with motion blur, times and cameras of the open shutter; read from the scene if None.
    """
    if time is None:
        time = scene_data.time_of(scene)
    trajectory, settings = trajectory or trajectory_of(scene, depsgraph=depsgraph), scene.crowd_lod
    eyes = camera or read_cameras(scene, depsgraph)
    shutter = read_shutter(scene, time) if shutter is None else shutter
    bias = bias_of(settings)
    use = use_of(settings, trajectory, policy_of(settings), bias, time, (eyes,) if isinstance(eyes, Camera) else eyes)
    frame = plan(trajectory, eyes, policy_of(settings), time, shutter, bias)
    return use.applied(frame if around is None else surround(frame, around))  # who is hidden casts no shadow


def populating(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> Generator[float, None, tuple[str, list[str]]]:
    """Measure the characters of `scene` and place the crowd: yield the progress.

    Returns a sentence on the result, and those that warn. CrowdError, before anything changes, if a setting is bad.
    """
    settings = scene.crowd_lod
    crowds = crowd_sources.crowds_of(settings)
    set_lengths(scene)
    for crowd in crowds:
        map_areas.make(crowd, depsgraph)
    check_maps(settings)
    with kept_meshes.taken_back(crowds):
        yield from crowd_sources.reading(crowds, settings.forward, depsgraph)
        groups = yield from measuring_groups(scene)
        trajectory = crowd_sources.populated(scene, groups, depsgraph)
        troubles = yield from aside(lambda: find(trajectory, scene_data.meters(scene)), lambda: 1.0)
        warnings = [troubles.sentence] if troubles.found else []
        warnings += [
            *told_of_feet(scene, groups),
            *told_of_extent(scene, groups),
            *told_of_plausibility(scene, groups, crowds, trajectory.parts, depsgraph),
            *crowd_sources.notes(crowds, trajectory),
            *told_of_left_out(scene),
            *told_of_unsaved(scene),
            *told_of_actions(scene, groups),
            *told_of_gliding(scene),
            *told_of_glow(scene),
        ]
    store_groups(settings, groups)
    _place_levels(scene)
    said = [] if troubles.found else [troubles.sentence]
    settings.trouble = "\n".join(filter(None, (*warnings, *said)))
    agents = f"{len(trajectory.start):,} agent{'s' * (len(trajectory.start) != 1)} in {len(groups)} character group{'s' * (len(groups) > 1)}."
    sources = [part.told for part in trajectory.parts]
    return " ".join(filter(None, (agents, *sources, *warnings, *said))), warnings


class CROWDLOD_OT_populate(Stepwise, bpy.types.Operator):
    """Measure the characters and place the crowd at its first frame"""

    bl_idname = "crowd_lod.populate"
    bl_label = "Populate"
    needs = (needs.characters,)

    def steps(self, context) -> Generator[float, None, str]:
        said, warnings = yield from populating(context.scene, context.evaluated_depsgraph_get())
        context.scene.crowd_lod.overlay = True
        for warning in warnings:
            self.report({"WARNING"}, warning)
        return said


CLASSES = (CROWDLOD_OT_populate,)
