"""The characters that a build's agents instance.

For each LOD of each character group there is a copy per phase class, moved by a rig that all LODs
share. Where no rig can show the group, there are the LOD's meshes in even poses of its action.
"""

from collections.abc import Callable, Container, Generator, Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np
from mathutils import Matrix

from ...crowd_lod.animation.phase_classes import Cast
from ...crowd_lod.progress import Workload
from ...crowd_lod.shot.needed_meshes import hold_shown, stand_ins
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import removal
from ..blender.evaluation import as_rendered
from ..blender.named_actions import group_performance
from ..blender.objects import mesh_like
from ..blender.ownership import OWNED
from ..blender.performance import Performance
from ..blender.removal import removed_on_failure
from ..lods.deviation import SOLID
from ..scene.scene_crowd import SceneCrowd, home_of
from ..scene.shot_reference import planned_meshes
from . import rigs
from .group_models import GroupModels, read_models

# Of each LOD, the numbers of the characters that it gets (see Cast).
Selection = Sequence[Container[int]]
Mesh = tuple[int, int]  # a LOD and a character's number
# The characters that a LOD's collection holds, by number: each with the mesh that it shows.
Shelf = Sequence[tuple[int, Mesh]]


@dataclass(frozen=True)
class BuiltCharacters:
    """The characters that a build shows, not yet in any scene.

    posed: (G,) intp, see Cast.
    collections: for each LOD its characters, each a collection's name and objects. Sorted by name
        they stand in the order of the Cast.
    rigs: the armature objects that move the characters.
    names: each new block's final name, given once the blocks of an earlier build are gone.
    notes: sentences on what the characters do not show as it is.
    unplanned: sentences on baked frames that do not follow the shot plan.
    """

    posed: np.ndarray
    collections: list[list[tuple[str, list[bpy.types.Object]]]]
    rigs: list[bpy.types.Object] = field(default_factory=list)
    names: dict[bpy.types.ID, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    unplanned: str = ""


@dataclass
class _GroupInMaking:
    """A group while its characters are made.

    g, name: its number and name.
    homes: its LODs' collections.
    stage, actors: see as_rendered.
    performance: what it plays.
    models: of each of the actions that agents play, if rigs can show the group.
    rig_of: the rigs made so far, by model, rate and class; a group and its parts share them.
    """

    g: int
    name: str
    homes: list[bpy.types.Collection]
    stage: bpy.types.Scene
    actors: dict[bpy.types.Object, bpy.types.Object]
    performance: Performance
    models: list[rigs.Model]
    rig_of: dict[tuple[int, float, int], dict[str, bpy.types.Object]]


def make_characters(
    crowd: SceneCrowd,
    selection: Selection | None = None,
    group_models: GroupModels | None = None,
    of_plan: np.ndarray | None = None,
) -> Generator[float, None, BuiltCharacters]:
    """Make the characters that agents of the crowd may show.

    selection: the characters to make; None makes all of the LODs that the policy has.
    group_models: the result of read_models, whose blocks then belong to the BuiltCharacters.
    of_plan: what meshes_of_plan returns; without a selection, no other meshes are made.

    Yields the progress, 0 to 1, and returns the BuiltCharacters. Closed early, it leaves nothing.
    """
    work = Workload(1 if group_models else 2)
    if group_models is None:
        group_models = yield from work.take(read_models(crowd), 1)
    built = BuiltCharacters(
        group_models.posed,
        [[] for _ in range(crowd.policy.count)],
        notes=group_models.notes,
    )
    built.names.update(group_models.blocks)
    with removed_on_failure(built.names):
        if selection is None:
            shelves = _live_shelves(crowd, group_models.posed, of_plan)
        else:
            numbers = range(Cast(group_models.posed).first(crowd.trajectory.gaits)[-1])
            shelves = [
                [(number, (level, number)) for number in numbers if number in selected]
                for level, selected in enumerate(selection)
            ]
        yield from work.take(_fill_collections(crowd, group_models, shelves, built), 1)
    idle = [
        block for block in group_models.blocks if not block.users
    ]  # of groups that nobody shows
    for block in idle:
        del built.names[block]
    removal.remove(idle)
    for block in built.names:
        block[OWNED] = True
    return built


def _live_shelves(crowd: SceneCrowd, posed: np.ndarray, of_plan: np.ndarray | None) -> list[Shelf]:
    """Return the shelves of a live build: on each all characters, or what stands in for them.

    posed: of the Cast. The build holds all meshes, or those `of_plan`; never LODs finer than
    the policy has.
    """
    policy = crowd.policy
    cast = Cast(posed)
    gaits = crowd.trajectory.gaits
    finest = np.array(policy.finest or [0] * len(posed))
    is_held = np.arange(policy.count)[:, None] >= finest[cast.owner(gaits)]
    if of_plan is not None:
        is_held &= hold_shown(of_plan, crowd.cast, cast, gaits)
    levels, numbers = stand_ins(is_held, cast.roles(gaits)).tolist()
    return [list(enumerate(zip(*row, strict=True))) for row in zip(levels, numbers, strict=True)]


def meshes_of_plan(crowd: SceneCrowd) -> Generator[float, None, np.ndarray | None]:
    """Read which meshes the frames of the crowd's shot plan show, (K, L) bool.

    They are LODs of the characters that the crowd's cast numbers. Yields the progress. Returns
    None without a plan that holds.
    """
    shown = yield from planned_meshes(crowd)
    size = crowd.policy.count, int(crowd.cast.first(crowd.trajectory.gaits)[-1])
    return shown if shown is not None and shown.shape == size else None


def _fill_collections(
    crowd: SceneCrowd, group_models: GroupModels, shelves: Sequence[Shelf], built: BuiltCharacters
) -> Generator[float, None, None]:
    """Make what the shelves show, and put it into the collections of `built`.

    Yields the progress.
    """
    names = [name for name, _, _ in crowd.characters]
    owner = Cast(built.posed).owner(crowd.trajectory.gaits)
    of_numbers: dict[int, set[int]] = {}
    for shelf in shelves:
        for _, (level, number) in shelf:
            of_numbers.setdefault(number, set()).add(level)
    objects = yield from _make_characters(crowd, group_models, of_numbers, built)
    for level, shelf in enumerate(shelves):
        built.collections[level].extend(
            (f"{number:05d} {names[owner[number]]} LOD {level}", objects[mesh])
            for number, mesh in shelf
        )


def _make_characters(
    crowd: SceneCrowd,
    group_models: GroupModels,
    of_numbers: dict[int, set[int]],
    built: BuiltCharacters,
) -> Generator[float, None, dict[Mesh, list[bpy.types.Object]]]:
    """Make the LODs of characters in `of_numbers`: yield the progress, return their objects."""
    trajectory = crowd.trajectory
    levels = crowd.settings.levels.children[: len(built.collections)]
    first = Cast(built.posed).first(trajectory.gaits)
    rig_of: dict = {}
    objects: dict[Mesh, list[bpy.types.Object]] = {}
    work = Workload(int(first[-1]))
    for g, (name, own_objects, _) in enumerate(crowd.characters):
        homes = [home_of(level, g, name) for level in levels]
        with as_rendered(item for home in homes for item in home.objects) as (stage, actors):
            performance = group_performance(trajectory.groups[g], own_objects)
            models = group_models.models[g]
            group = _GroupInMaking(g, name, homes, stage, actors, performance, models, rig_of)
            for number in range(first[g], first[g + 1]):
                of_levels = sorted(of_numbers.get(number, ()))
                place = number - int(first[g])
                if of_levels:
                    made = _make_character(built, group, number, place, of_levels, trajectory)
                    objects |= {(level, number): items for level, items in made.items()}
                yield work.did(1)
    return objects


def _make_character(
    built: BuiltCharacters,
    group: _GroupInMaking,
    number: int,
    place: int,
    of_levels: list[int],
    trajectory: Trajectory,
) -> dict[int, list[bpy.types.Object]]:
    """Return the objects of a character by its LODs: in a pose, or moved by a rig.

    number: its number among all characters.
    place: its number in the group.
    """
    poses = int(built.posed[group.g])
    if not poses:
        return _rig(built, group, number, place, of_levels, trajectory)
    action, pose = divmod(place, poses)
    act = group.performance.only(trajectory.gaits.actions[action])
    return _pose(built, group, number, act, pose / poses, of_levels)


def _rig(
    built: BuiltCharacters,
    group: _GroupInMaking,
    number: int,
    place: int,
    of_levels: list[int],
    trajectory: Trajectory,
) -> dict[int, list[bpy.types.Object]]:
    """Return the objects of a character by its LODs, moved by a rig; see _make_character."""
    gaits = trajectory.gaits
    pace, phase_class = divmod(place, gaits.classes)
    action, rate = gaits.plays[group.g][pace]
    model = group.models[action]
    (span,) = group.performance.only(gaits.actions[action]).spans
    title = f"{group.name} {number:05d}"
    key = id(model), rate, phase_class
    if key not in group.rig_of:
        cycles = rate * trajectory.seconds_per_frame
        new_rigs = rigs.perform(model, title, cycles, phase_class / gaits.classes, span)
        group.rig_of[key] = new_rigs
        built.rigs.extend(new_rigs.values())
        built.names.update((rig, f"{title} {armature}") for armature, rig in new_rigs.items())

    def moved(home: bpy.types.Collection) -> list[bpy.types.Object]:
        copies = [rigs.dress(item, model, group.rig_of[key]) for item in home.objects]
        for copy, item in zip(copies, home.objects, strict=True):
            built.names[copy] = f"{item.name} {number:05d}"
        return copies

    return _by_level(group, of_levels, moved)


def _by_level(
    group: _GroupInMaking,
    of_levels: list[int],
    copied: Callable[[bpy.types.Collection], list[bpy.types.Object]],
) -> dict[int, list[bpy.types.Object]]:
    """Return what `copied` makes of each LOD's collection, by the LOD.

    A group with fewer LODs than others shows its last in their place.
    """
    homes = {level: group.homes[level] for level in of_levels}
    objects = {home: copied(home) for home in dict.fromkeys(homes.values())}
    return {level: objects[home] for level, home in homes.items()}


def _pose(
    built: BuiltCharacters,
    group: _GroupInMaking,
    number: int,
    act: Performance,
    phase: float,
    of_levels: list[int],
) -> dict[int, list[bpy.types.Object]]:
    """Return the objects of a still character by its LODs; see _make_character.

    act: the action of its pose; phase: the place of the pose in it, in [0, 1).
    """
    ((first, last),) = act.spans
    act.go_to(group.stage, first + (last - first) * phase)
    depsgraph = group.stage.view_layers[0].depsgraph

    def posed(home: bpy.types.Collection) -> list[bpy.types.Object]:
        return [
            _still(
                built, item, home, group.actors[item].evaluated_get(depsgraph), depsgraph, number
            )
            for item in home.objects
        ]

    stills = _by_level(group, of_levels, posed)
    act.rest()
    return stills


def _still(
    built: BuiltCharacters,
    item: bpy.types.Object,
    home: bpy.types.Collection,
    evaluated,
    depsgraph,
    number: int,
) -> bpy.types.Object:
    """Return a still copy of the LOD object `item`, as `evaluated`.

    It keeps slots, visibility and custom properties. Objects without faces, and hair, move with
    their parent but keep their shape. The copy stands about the origin as the object stands about
    the offset of the collection `home`: geometry nodes instance collections without their offsets.
    """
    mesh = None
    if item.type in SOLID:
        mesh = bpy.data.meshes.new_from_object(
            evaluated, preserve_all_data_layers=True, depsgraph=depsgraph
        )
    matrix = Matrix.Translation(-home.instance_offset) @ evaluated.matrix_world
    still = item.copy() if mesh is None or item.type == "MESH" else mesh_like(item, mesh)
    built.names[still] = f"{item.name} {number:05d}"
    still.animation_data_clear()
    still.constraints.clear()
    still.parent = None
    still.matrix_world = matrix
    if mesh is None:
        return still
    still.modifiers.clear()
    # what location, rotation and scale cannot say
    skew = still.matrix_basis.inverted_safe() @ matrix
    if np.abs(np.array(skew) - np.eye(4)).max() > 1e-5:
        mesh.transform(skew)
    still.data = mesh
    built.names[mesh] = built.names[still]
    still.vertex_groups.clear()  # done with, and half of the memory
    return still
