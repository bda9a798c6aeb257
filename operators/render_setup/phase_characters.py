"""The characters that a build's agents instance.

For each LOD of each character group there is a copy per phase class, moved by a rig that all LODs
share. Where no rig can show the group, there are the LOD's meshes in even poses of its action.
"""

from collections.abc import Container, Generator, Sequence
from dataclasses import dataclass, field, replace

import bpy
import numpy as np
from mathutils import Matrix

from ...crowd_lod.animation.phase_classes import Library
from ...crowd_lod.progress import share
from ...crowd_lod.sources.trajectory import Trajectory
from ..blender import mesh_data
from ..blender.cleanup import removed_on_failure
from ..blender.named_actions import group_performance
from ..blender.ownership import OWNED
from ..blender.performance import Performance
from ..blender.render_evaluation import as_rendered
from ..characters.characters import check_measured
from ..characters.rig_needs import POSES, leads, stands_for
from ..characters.stored_groups import groups_of
from ..lod_meshes.deviation import SOLID
from ..scene.scene_crowd import characters_of, home_of, policy_of, trajectory_of
from . import rigs
from .scaled_textures import scale_textures

# Of each LOD, the numbers of the characters that it gets (see Library).
Selection = Sequence[Container[int]]


@dataclass(frozen=True)
class Cast:
    """The characters that a build shows, not yet in any scene.

    posed: (G,) intp, see Library.
    collections: for each LOD its characters, each a collection's name and objects. Sorted by name
        they stand in the order of the Library.
    rigs: the armature objects that move the characters.
    names: each new block's final name, given once the blocks of an earlier build are gone.
    notes: sentences on what the characters do not show as it is.
    selection: the characters that were made, None for all.
    stands_for: object -> the LOD's object that it shows.
    images: where images are scaled, bytes of the characters' images (unscaled, as they are).
    """

    posed: np.ndarray
    collections: list[list[tuple[str, list[bpy.types.Object]]]]
    rigs: list[bpy.types.Object] = field(default_factory=list)
    names: dict[bpy.types.ID, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    selection: Selection | None = None
    stands_for: dict[bpy.types.Object, bpy.types.Object] = field(default_factory=dict)
    images: tuple[int, int] | None = None


@dataclass
class _Actors:
    """A group while its characters are made.

    g, name: its number and name.
    homes: its LODs' collections.
    stage, actors: see as_rendered.
    performance: what it plays.
    models: of each of the actions that agents play, if rigs can show the group.
    rig_of: the rigs made so far, by model, rate and class; variants of a group share them.
    """

    g: int
    name: str
    homes: list[bpy.types.Collection]
    stage: bpy.types.Scene
    actors: dict[bpy.types.Object, bpy.types.Object]
    performance: Performance
    models: list[rigs.Model]
    rig_of: dict[tuple[int, float, int], dict[str, bpy.types.Object]]


@dataclass(frozen=True)
class GroupModels:
    """Which groups rigs can show, and by which models.

    posed: (G,) intp, see Library.
    models: for each group the model of each action; [] where rigs cannot show the group.
    notes: sentences on what does not show as it is.
    blocks: the new data-blocks and their final names.
    """

    posed: np.ndarray
    models: list[list[rigs.Model]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    blocks: dict[bpy.types.ID, str] = field(default_factory=dict)


def read_library(scene: bpy.types.Scene) -> Generator[float, None, GroupModels]:
    """Model the groups of `scene` with rigs, where rigs can show them.

    Yields the progress. Closed early, it leaves nothing behind.
    """
    characters = characters_of(scene)
    actions = trajectory_of(scene).gaits.actions
    measured = groups_of(scene.crowd_lod)
    check_measured(characters, measured)
    library = GroupModels(np.zeros(len(characters), np.intp))
    lead = leads(characters, measured)
    with removed_on_failure(library.blocks):
        for g in range(len(characters)):
            if lead[g] == g:
                family = [v for v, leader in enumerate(lead) if leader == g]
                modeling = _model_group(scene, family, actions, library)
                yield from share(modeling, g / len(characters), (g + 1) / len(characters))
            else:  # a variant moves as its group does
                library.posed[g] = library.posed[lead[g]]
                library.models.append(library.models[lead[g]])
            yield (g + 1) / len(characters)
    return library


def _model_group(
    scene: bpy.types.Scene, family: list[int], actions: Sequence[str], library: GroupModels
) -> Generator[float, None, None]:
    """Add the models of a group, which also its variants use, to `library`.

    family: the numbers of the group and of its variants.
    actions: those that agents play.
    """
    g = family[0]
    settings = scene.crowd_lod
    characters = characters_of(scene)
    name, objects, _ = characters[g]
    measured = groups_of(settings)[g]
    performance = group_performance(measured, objects)
    acts = [performance.only(action) for action in actions]
    if all(act.still for act in acts):
        library.posed[g] = 1
        library.models.append([])
        return
    levels = settings.levels.children[: policy_of(settings).count]
    homes = [home_of(level, v, characters[v][0]) for v in family for level in levels]
    diagonal = measured.diagonal or 2 * measured.radius
    with as_rendered(item for home in homes for item in home.objects) as (stage, actors):
        character = rigs.Acting(name, homes, stage, actors, diagonal)
        models, reasons = yield from _models(character, acts, library.blocks)
    if len(models) == len(acts):
        library.notes.extend(filter(None, [" ".join(reasons)]))
        library.models.append(models)
        return
    library.posed[g] = POSES
    library.models.append([])
    frames = max(last - first for act in acts for first, last in act.spans)
    stands = stands_for(frames, scene.render.fps / scene.render.fps_base)
    library.notes.append(
        f"{name} is shown as {POSES} still poses, {stands}, so its limbs "
        f"have no motion blur: {reasons[-1]}."
    )


def _models(
    character: rigs.Acting, acts: list[Performance], blocks: dict[bpy.types.ID, str]
) -> Generator[float, None, tuple[list[rigs.Model], list[str]]]:
    """Make a model of each of `acts`, until rigs cannot show one.

    blocks: gets the new data-blocks and their final names.

    Yields the progress. Returns (models, sentences on how far they are off). Where an act cannot be
    shown, there are no models, and the last sentence says why.
    """
    models = []
    sentences = []
    before = set(blocks)
    for k, act in enumerate(acts):
        alike = [
            model for model, other in zip(models, acts, strict=False) if other.parts == act.parts
        ]
        if alike:  # its own action, in place of one that another group plays
            models.append(alike[0])
            continue
        modeling = rigs.make_model(character, act, blocks)
        model, reason = yield from share(modeling, k / len(acts), (k + 1) / len(acts))
        if reason:
            sentences.append(reason)
        if model is None:
            new_blocks = [block for block in blocks if block not in before]
            for block in new_blocks:
                del blocks[block]
            bpy.data.batch_remove(new_blocks)
            return [], sentences
        models.append(model)
    return models, sentences


def make_cast(
    scene: bpy.types.Scene,
    selection: Selection | None = None,
    library: GroupModels | None = None,
) -> Generator[float, None, Cast]:
    """Make the characters that agents of `scene` may show.

    selection: the characters to make; None makes all of the LODs that the policy has.
    library: the result of read_library, whose blocks then belong to the Cast.

    Yields the progress, 0 to 1, and returns the Cast. Closed early, it leaves nothing behind.
    """
    settings = scene.crowd_lod
    if library is None:
        library = yield from share(read_library(scene), 0.0, 0.5)
    cast = Cast(
        library.posed,
        [[] for _ in range(policy_of(settings).count)],
        notes=library.notes,
        selection=selection,
    )
    cast.names.update(library.blocks)
    with removed_on_failure(cast.names):
        yield from share(_make_characters(scene, library, cast), 0.5, 1.0)
        if settings.scale_textures:
            scaling = scale_textures(scene, settings, cast.stands_for, cast.names)
            *images, sentence = yield from scaling
            cast = replace(cast, images=tuple(images), notes=[*library.notes, *sentence])
    idle = [block for block in library.blocks if not block.users]  # of groups that nobody shows
    for block in idle:
        del cast.names[block]
    bpy.data.batch_remove(idle)
    for block in cast.names:
        block[OWNED] = True
    return cast


def _make_characters(
    scene: bpy.types.Scene, library: GroupModels, cast: Cast
) -> Generator[float, None, None]:
    """Put the characters of all groups into the collections of `cast`; yields the progress."""
    settings = scene.crowd_lod
    trajectory = trajectory_of(scene)
    characters = characters_of(scene)
    levels = settings.levels.children[: len(cast.collections)]
    finest = policy_of(settings).finest or [0] * len(characters)
    first = Library(cast.posed).first(trajectory.gaits)
    rig_of: dict = {}
    for g, (name, objects, _) in enumerate(characters):
        homes = [home_of(level, g, name) for level in levels]
        with as_rendered(item for home in homes for item in home.objects) as (stage, actors):
            performance = group_performance(trajectory.groups[g], objects)
            models = library.models[g]
            group = _Actors(g, name, homes, stage, actors, performance, models, rig_of)
            for number in range(first[g], first[g + 1]):
                of_levels = _levels_of(cast, number, finest[g])
                if cast.selection is None:  # without them the numbers of the others would be wrong
                    for characters_of_level in cast.collections[: finest[g]]:
                        characters_of_level.append((f"{number:05d} {name} left out", []))
                if of_levels:
                    place = number - int(first[g])
                    _make_character(cast, group, number, place, of_levels, trajectory)
                yield number / first[-1]


def _levels_of(cast: Cast, number: int, finest: int) -> list[int]:
    """Return the LODs that character `number` is made for; finest: the group's finest LOD."""
    count = len(cast.collections)
    if cast.selection is None:
        return list(range(finest, count))
    return [level for level in range(count) if number in cast.selection[level]]


def _make_character(
    cast: Cast,
    group: _Actors,
    number: int,
    place: int,
    of_levels: list[int],
    trajectory: Trajectory,
) -> None:
    """Put a character into the collections of LODs of `cast`: in a pose, or moved by a rig.

    number: its number among all characters.
    place: its number in the group.
    """
    poses = int(cast.posed[group.g])
    if not poses:
        _rig(cast, group, number, place, of_levels, trajectory)
        return
    action, pose = divmod(place, poses)
    act = group.performance.only(trajectory.gaits.actions[action])
    _pose(cast, group, number, (act, pose / poses), of_levels)


def _rig(
    cast: Cast,
    group: _Actors,
    number: int,
    place: int,
    of_levels: list[int],
    trajectory: Trajectory,
) -> None:
    """Put a character moved by a rig into the collections of LODs of `cast`.

    number: its number among all characters.
    place: its number in the group.
    """
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
        cast.rigs.extend(new_rigs.values())
        cast.names.update((rig, f"{title} {armature}") for armature, rig in new_rigs.items())
    copies = []
    home = None
    for level in of_levels:
        # a group with fewer LODs than others shows its last in their place
        if group.homes[level] != home:
            home = group.homes[level]
            copies = [rigs.dress(item, model, group.rig_of[key]) for item in home.objects]
            for copy, item in zip(copies, home.objects, strict=True):
                cast.stands_for[copy] = item
                cast.names[copy] = f"{item.name} {number:05d}"
        cast.collections[level].append((f"{number:05d} {group.name} LOD {level}", copies))


def _pose(
    cast: Cast,
    group: _Actors,
    number: int,
    act_and_phase: tuple[Performance, float],
    of_levels: list[int],
) -> None:
    """Put a still character into the collections of LODs of `cast`.

    number: its number among all characters.
    act_and_phase: the action and the phase, in [0, 1), of its pose.
    """
    act, phase = act_and_phase
    ((first, last),) = act.spans
    act.go_to(group.stage, first + (last - first) * phase)
    depsgraph = group.stage.view_layers[0].depsgraph
    stills = []
    home = None
    for level in of_levels:
        if group.homes[level] != home:
            home = group.homes[level]
            stills = []
            for item in home.objects:
                evaluated = group.actors[item].evaluated_get(depsgraph)
                stills.append(_still(cast, item, home, evaluated, depsgraph, number))
        cast.collections[level].append((f"{number:05d} {group.name} LOD {level}", stills))
    act.rest()


def _still(
    cast: Cast,
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
    still = item.copy() if mesh is None or item.type == "MESH" else mesh_data.mesh_like(item, mesh)
    cast.names[still] = f"{item.name} {number:05d}"
    cast.stands_for[still] = item
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
    cast.names[mesh] = cast.names[still]
    still.vertex_groups.clear()  # done with, and half of the memory
    return still
