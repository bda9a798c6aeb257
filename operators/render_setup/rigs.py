"""Rigs: clean copies of a character's armatures that play its baked action.

There is one rig per phase class; all share one mesh. A rig has a bone for each bone that deforms
the character, and one for each object that moves as a whole. The world-space motion that the
action, constraints, IK and drivers give these is baked into one action that all rigs share. Each
rig plays it by a strip of its own, whose time cycles through the action for ever
(docs/notes/costs.md).
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from ...crowd_lod.progress import Workload
from ..blender import mesh_data, removal
from ..blender.object_copies import copy_unlinked
from ..blender.performance import Performance
from ..characters.bone_motion import NEAR
from ..characters.rig_needs import refusal
from .close_recording import record_closely, refine
from .rig_models import TRACKS, Model, fill_curve, model_of

FARTHEST = 1_048_574  # frames: Blender's last
# of the character's diagonal: how far rigs may be off where more keys do not help; posed meshes of
# a long action are farther off
ACCEPTED = 0.01


def perform(
    model: Model, title: str, rate: float, phase: float, span: tuple[float, float]
) -> dict[str, bpy.types.Object]:
    """Make a rig for each armature of `model`; return them by the armature's name.

    A rig stands about the origin and plays its action from `span`, frames. It is at `phase` in
    frame 0 and advances by `rate` cycles a frame.
    """
    rigs = {}
    first, last = span
    for armature, (data, action) in model.rigs.items():
        rig = rigs[armature] = bpy.data.objects.new(f"{title} {armature}", data)
        # Makes the pose. Without it Blender crashes as soon as an animation editor is drawn.
        rig.data = data
        track = rig.animation_data_create().nla_tracks.new()
        strip = track.strips.new("Phase", 0, action)
        strip.use_animated_time = True
        strip.extrapolation = "HOLD"
        strip.frame_start_ui = -FARTHEST
        strip.frame_end_ui = FARTHEST
        time = strip.fcurves.find("strip_time")
        if rate:
            begin = -phase / rate
            fill_curve(time, np.array([(begin, first), (begin + 1 / rate, last)]))
            round_and_round = time.modifiers.new("CYCLES")
            round_and_round.mode_before = round_and_round.mode_after = "REPEAT"
        else:
            fill_curve(time, np.array([(0.0, first + phase * (last - first))]))
    return rigs


def dress(
    item: bpy.types.Object, model: Model, rigs: dict[str, bpy.types.Object], actor=None
) -> bpy.types.Object:
    """Return a copy of the LOD object `item` that a class's `rigs` move and deform.

    It shares the object's mesh. actor: copy this object instead, if given.
    """
    copy = copy_unlinked(actor or item)
    copy.animation_data_clear()
    copy.constraints.clear()
    bent_by = item.parent if item.parent_type == "ARMATURE" else None
    copy.parent = None
    copy.parent_type = "OBJECT"
    if item in model.carried:
        rig = rigs[TRACKS]
        bone = model.carried[item]
        copy.parent = rig
        copy.parent_type = "BONE"
        copy.parent_bone = bone
        rest = rig.data.bones[bone]
        copy.matrix_parent_inverse = (
            rest.matrix_local @ Matrix.Translation((0.0, rest.length, 0.0))
        ).inverted()
    copy.matrix_basis = Matrix(model.stands[item].tolist())
    if bent_by is not None:  # as such a parent does, before all modifiers
        copy.modifiers.new(bent_by.name, "ARMATURE").object = bent_by
        copy.modifiers.move(len(copy.modifiers) - 1, 0)
    for modifier in copy.modifiers:
        if modifier.type == "ARMATURE" and modifier.object is not None:
            modifier.object = rigs.get(modifier.object.name)
    return copy


def measure_copies(copies: dict, actors: dict, stage: bpy.types.Scene, origin: np.ndarray) -> float:
    """Return the largest distance of a vertex in `copies` from the original, meters.

    copies: object -> its copy about the world's origin.
    actors: object -> the object that shows it in `stage`, where both are at the same phase now.

    Infinite if the numbers of vertices differ.
    """
    depsgraph = stage.view_layers[0].depsgraph
    worst = 0.0
    for item, copy in copies.items():
        mine, original = (
            mesh_data.world_points(each.evaluated_get(depsgraph)) for each in (copy, actors[item])
        )
        if mine.shape != original.shape:
            return np.inf
        worst = max(worst, float(np.linalg.norm(mine + origin - original, axis=1).max(initial=0.0)))
    return worst


@dataclass(frozen=True)
class Acting:
    """A character that plays.

    name: of its group.
    homes: the collections of its LODs.
    stage, actors: see as_rendered.
    diagonal: meters.
    """

    name: str
    homes: Sequence[bpy.types.Collection]
    stage: bpy.types.Scene
    actors: dict
    diagonal: float


def make_model(
    character: Acting, performance: Performance, blocks: dict
) -> Generator[float, None, tuple[Model | None, str]]:
    """Make the model of one action of a character, with as many keys as it needs.

    The rigs should show it within NEAR of its diagonal; more keys are tried as long as they help.

    performance: that of this action alone.
    blocks: gets the new data-blocks with their final names.

    Yields the progress. Returns (Model, a sentence on how far off it is if that is more than NEAR),
    or (None, the reason why no rigs can show it).
    """
    actors = character.actors
    origin = np.array(character.homes[0].instance_offset, np.float64)
    diagonal = character.diagonal
    (played,) = performance.names
    name = f"{character.name} {played}".rstrip()
    reason = refusal(list(actors))
    if reason:
        return None, reason
    # between keys, for the vertices that each bone moves farthest
    allowed = NEAR * diagonal / 1.1
    work = Workload(1)  # of what is left each part takes about half
    recording = yield from work.take(record_closely(actors, performance, allowed), 0.5)
    while True:
        model = model_of(name, recording, origin, blocks)
        comparing = _off(model, character, performance, recording.to_compare())
        *between_keys, at_key = yield from work.take(comparing, work.left / 2)
        off = max([*between_keys, at_key]) / diagonal
        is_off_at_keys = max(between_keys, default=0.0) < 2 * at_key  # more keys do not mend it
        if off <= NEAR or is_off_at_keys or np.isinf(off):
            break
        # modifiers take vertices farther than bones do
        allowed = min(allowed, recording.off.max()) * NEAR / off / 1.1
        refining = refine(recording, actors, performance, allowed)
        finer = yield from work.take(refining, work.left / 2)
        if len(finer.times) == len(recording.times):
            break
        recording = finer
        _drop(model, blocks)
    if off <= NEAR:
        return model, ""
    if off <= ACCEPTED:
        return (
            model,
            f"Between keyframes the rigs of {name} are off by up to {off:.2%} of its size "
            f"({1000 * off * diagonal:.2g} mm).",
        )
    _drop(model, blocks)
    return (
        None,
        f"rigs would be off by {off:.2%} of its size"
        if np.isfinite(off)
        else "its number of vertices changes during the action",
    )


def _drop(model: Model, blocks: dict[bpy.types.ID, str]) -> None:
    """Remove the data-blocks of `model`, also from `blocks`."""
    doomed = [block for pair in model.rigs.values() for block in pair]
    for block in doomed:
        del blocks[block]
    removal.remove(doomed)


def _off(
    model: Model, character: Acting, performance: Performance, moments: np.ndarray
) -> Generator[float, None, list[float]]:
    """Find how far off a rig of `model` shows the character at the moments.

    Yields the progress and returns a distance for each moment, meters.
    """
    (span,) = performance.spans
    origin = np.array(character.homes[0].instance_offset, np.float64)
    length = max(span[1] - span[0], 1.0)
    rigs = perform(model, "Crowd LOD trial", 1 / length, -span[0] / length, span)
    copies = {item: dress(item, model, rigs, actor) for item, actor in character.actors.items()}
    try:
        for block in (*rigs.values(), *copies.values()):
            character.stage.collection.objects.link(block)
        distances = []
        work = Workload(len(moments))
        for time in moments:
            performance.go_to(character.stage, time)
            distances.append(measure_copies(copies, character.actors, character.stage, origin))
            performance.rest()
            yield work.did(1)
        return distances
    finally:
        performance.rest()
        removal.remove([*rigs.values(), *copies.values()])
