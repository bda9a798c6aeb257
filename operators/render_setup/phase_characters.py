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

Wanted = Sequence[Container[int]]  # of each LOD the characters of a Library that it has


@dataclass(frozen=True)
class Cast:
    """The characters that a build shows, not yet in any scene.

    posed: (G,) intp, see Library.
    collections: for each LOD its characters, each a collection's name and objects. Sorted by name
        they stand in the order of the Library.
    rigs: the armature objects that move the characters.
    names: each new block's final name, given once the blocks of an earlier build are gone.
    notes: sentences on what the characters do not show as it is.
    wanted: the characters made, None for all.
    stands_for: object -> the LOD's object that it shows.
    images: where images are scaled, bytes of the characters' images (unscaled, as they are).
    """

    posed: np.ndarray
    collections: list[list[tuple[str, list[bpy.types.Object]]]]
    rigs: list[bpy.types.Object] = field(default_factory=list)
    names: dict[bpy.types.ID, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    wanted: Wanted | None = None
    stands_for: dict[bpy.types.Object, bpy.types.Object] = field(default_factory=dict)
    images: tuple[int, int] | None = None


@dataclass
class _Actors:
    """One group while it is made.

    g, name: its number and name.
    homes: its LODs' collections.
    stage, actors: see as_rendered.
    performance: what it plays.
    models: of each of the actions that agents play, if rigs can show the group.
    made: the rigs that were made so far, by model, rate and class: variants of a group share them.
    """

    g: int
    name: str
    homes: list[bpy.types.Collection]
    stage: bpy.types.Scene
    actors: dict[bpy.types.Object, bpy.types.Object]
    performance: Performance
    models: list[rigs.Model]
    made: dict[tuple[int, float, int], dict[str, bpy.types.Object]]


# Of each group, see Library, and the model of each action, if rigs can show it; sentences on what
# does not show as it is; the new data-blocks and what they are to be called.
LibraryRead = tuple[np.ndarray, list[list[rigs.Model]], list[str], dict[bpy.types.ID, str]]


def read_library(scene: bpy.types.Scene, settings) -> Generator[float, None, LibraryRead]:
    """Find out which groups of `scene` rigs can show; yields the progress and returns what it
    found. Closed early, it leaves nothing behind."""
    characters = characters_of(scene)
    levels = settings.levels.children
    played = trajectory_of(scene).gaits.actions
    count = policy_of(settings).count
    measured = groups_of(settings)
    check_measured(characters, measured)
    posed = np.zeros(len(characters), np.intp)
    models = []
    notes = []
    blocks = {}
    done = False
    performances = [
        group_performance(group, own)
        for group, (_, own, _) in zip(measured, characters, strict=True)
    ]
    lead = leads(characters, measured)
    try:
        for g, (name, _, _) in enumerate(characters):
            performance = performances[g]
            family = [v for v, own in enumerate(lead) if own == g]
            homes = [
                home_of(level, v, characters[v][0]) for v in family for level in levels[:count]
            ]
            own = []
            reason = ""
            if lead[g] != g:
                posed[g] = posed[lead[g]]
                own = models[lead[g]]
            elif all(performance.only(action).still for action in played):
                posed[g] = 1
            else:
                with as_rendered(item for home in homes for item in home.objects) as staged:
                    who = rigs.Acting(
                        name, homes, *staged, measured[g].diagonal or 2 * measured[g].radius
                    )
                    making = _models(who, [performance.only(action) for action in played], blocks)
                    own, reasons = yield from share(
                        making, g / len(characters), (g + 1) / len(characters)
                    )
                reason = " ".join(reasons)
                if len(own) < len(played):
                    posed[g] = POSES
                    own = []
                    frames = max(
                        last - first
                        for action in played
                        for first, last in performance.only(action).spans
                    )
                    stands = stands_for(frames, scene.render.fps / scene.render.fps_base)
                    reason = (
                        f"{name} is shown as {POSES} still poses, {stands}, so its limbs "
                        f"have no motion blur: {reasons[-1]}."
                    )
            if reason:
                notes.append(reason)
            models.append(own)
            yield (g + 1) / len(characters)
        done = True
    finally:
        if not done:
            bpy.data.batch_remove(list(blocks))
    return posed, models, notes, blocks


def _models(
    character: rigs.Acting, acts: list[Performance], made: dict
) -> Generator[float, None, tuple[list[rigs.Model], list[str]]]:
    """Make a model of each of `acts`, until rigs cannot show one; yields the progress.

    Returns (models, sentences on how far they are off, or at the end why one cannot be shown).
    """
    models = []
    sentences = []
    before = set(made)
    for k, act in enumerate(acts):
        alike = [
            model for model, known in zip(models, acts, strict=False) if known.parts == act.parts
        ]
        if alike:  # its own action, for one that another group plays
            models.append(alike[0])
            continue
        model, reason = yield from share(
            rigs.modeled(character, act, made), k / len(acts), (k + 1) / len(acts)
        )
        sentences += [reason] * bool(reason)
        if model is None:
            blocks = [block for block in made if block not in before]
            for block in blocks:
                del made[block]
            bpy.data.batch_remove(blocks)
            return [], sentences
        models.append(model)
    return models, sentences


def make_cast(
    scene: bpy.types.Scene, settings, wanted: Wanted | None = None, read: LibraryRead | None = None
) -> Generator[float, None, Cast]:
    """Make the characters that agents of `scene` may show.

    wanted: those to make; None makes all of the LODs that the policy has.
    read: the result of read_library, whose blocks then belong to the Cast.

    Yields the progress, 0 to 1, and returns the Cast. Closed early, it leaves nothing behind.
    """
    if read is None:
        read = yield from share(read_library(scene, settings), 0.0, 0.5)
    posed, models, notes, made = read
    characters = characters_of(scene)
    levels = settings.levels.children
    count = policy_of(settings).count
    trajectory = trajectory_of(scene)
    first = Library(posed).first(trajectory.gaits)
    finest = policy_of(settings).finest or [0] * len(characters)
    cast = Cast(posed, [[] for _ in range(count)], notes=notes, wanted=wanted)
    done = False
    cast.names.update(made)
    performed: dict = {}
    try:
        for g, (name, objects, _) in enumerate(characters):
            homes = [home_of(level, g, name) for level in levels[:count]]
            with as_rendered(item for home in homes for item in home.objects) as (stage, actors):
                performance = group_performance(trajectory.groups[g], objects)
                group = _Actors(g, name, homes, stage, actors, performance, models[g], performed)
                for number in range(first[g], first[g + 1]):
                    of_levels = [
                        k
                        for k in range(count)
                        if (k >= finest[g] if wanted is None else number in wanted[k])
                    ]
                    if wanted is None:  # without them the others would not be found by their number
                        for left_out in cast.collections[: finest[g]]:
                            left_out.append((f"{number:05d} {name} left out", []))
                    if of_levels:
                        own = number - int(first[g])
                        if posed[g]:
                            action, pose = divmod(own, int(posed[g]))
                            act = performance.only(trajectory.gaits.actions[action])
                            _pose(cast, group, number, (act, pose / posed[g]), of_levels)
                        else:
                            _rig(cast, group, number, own, of_levels, trajectory)
                    yield 0.5 + 0.5 * number / first[-1]
        if settings.scale_textures:
            *images, told = yield from scale_textures(scene, settings, cast.stands_for, cast.names)
            cast = replace(cast, images=tuple(images), notes=[*notes, *told])
        done = True
    finally:
        if not done:
            bpy.data.batch_remove(list(cast.names))
    idle = [block for block in made if not block.users]  # of groups of which nobody is shown
    for block in idle:
        del cast.names[block]
    bpy.data.batch_remove(idle)
    for block in cast.names:
        block[OWNED] = True
    return cast


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
    which, phase_class = divmod(place, gaits.classes)
    action, rate = gaits.plays[group.g][which]
    model = group.models[action]
    (span,) = group.performance.only(gaits.actions[action]).spans
    title = f"{group.name} {number:05d}"
    key = id(model), rate, phase_class
    if key not in group.made:
        rig_of = rigs.perform(
            model, title, rate * trajectory.seconds_per_frame, phase_class / gaits.classes, span
        )
        group.made[key] = rig_of
        cast.rigs.extend(rig_of.values())
        cast.names.update((rig, f"{title} {armature}") for armature, rig in rig_of.items())
    rig_of = group.made[key]
    copies = []
    home = None
    for k in of_levels:
        # a group with fewer LODs than others shows its last in their place
        if group.homes[k] != home:
            copies = [rigs.dress(item, model, rig_of) for item in group.homes[k].objects]
            home = group.homes[k]
            cast.stands_for.update(zip(copies, home.objects, strict=True))
            cast.names.update(
                (copy, f"{item.name} {number:05d}")
                for copy, item in zip(copies, home.objects, strict=True)
            )
        cast.collections[k].append((f"{number:05d} {group.name} LOD {k}", copies))


def _pose(
    cast: Cast,
    group: _Actors,
    number: int,
    act_and_phase: tuple[Performance, float],
    of_levels: list[int],
) -> None:
    """Put character `number` into the LODs of `cast`: the group in an action at a phase,
    `act_and_phase`.
    """
    act, phase = act_and_phase
    ((first, last),) = act.spans
    act.go_to(group.stage, first + (last - first) * phase)
    depsgraph = group.stage.view_layers[0].depsgraph
    stills = []
    home = None
    for k in of_levels:
        if group.homes[k] != home:
            home = group.homes[k]
            stills = [
                _still(
                    cast, item, home, group.actors[item].evaluated_get(depsgraph), depsgraph, number
                )
                for item in home.objects
            ]
        cast.collections[k].append((f"{number:05d} {group.name} LOD {k}", stills))
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
