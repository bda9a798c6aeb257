"""Rigs: clean copies of a character's armatures that play its recorded action.

Models hold the recorded motion; a character's rigs share them.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from ...crowd_lod.progress import Pauses, Workload
from ..blender import mesh_data, removal
from ..blender.objects import copy_unlinked
from ..blender.performance import Performance
from ..scene.characters.bone_motion import (
    NEAR,
    ROUNDING,
    Bones,
    channels,
    split_scale,
    turned_shortly,
)
from ..scene.characters.rig_needs import refusal
from .close_recording import MotionRecording, record_closely, refine

STILL = 1e-6  # meters, and radians: an object that moves by less stands
TRACKS = "Crowd LOD tracks"  # a rig whose bones carry objects
LINEAR = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value


@dataclass(frozen=True)
class Model:
    """The data from which the rigs of one character are made.

    rigs: for each of its armatures, and for TRACKS, the data and the action that all its rigs
        share.
    carried: object that moves as a whole -> the bone that carries it.
    stands: object -> (4, 4), its matrix in the character's space at the first frame.
    length: frames of the action.
    """

    rigs: dict[str, tuple[bpy.types.Armature, bpy.types.Action]]
    carried: dict[bpy.types.Object, str]
    stands: dict[bpy.types.Object, np.ndarray]
    length: float


def model_of(
    name: str, recording: MotionRecording, origin: np.ndarray, blocks: dict[bpy.types.ID, str]
) -> Model:
    """Return the model of the character `name` from its recorded motion.

    recording: of its action, from its first frame to its last.
    origin: (3,) meters, the character's origin.
    blocks: gets the new data-blocks with their final names.
    """
    times = recording.times
    places = recording.places
    shift = np.eye(4)
    shift[:3, 3] = -np.asarray(origin)
    back = np.linalg.inv(shift)
    carried = {}
    tracks = Bones()
    bones_of: dict[bytes, str] = {}  # LODs of one object move alike
    for number, (item, matrices) in enumerate(places.items()):
        moves = matrices @ np.linalg.pinv(matrices[0])
        if np.abs(moves - np.eye(4)).max() > STILL:
            known = bones_of.get(matrices.tobytes())
            carried[item] = bones_of[matrices.tobytes()] = known or f"object {number:03d}"
            if known:
                continue
            tracks.rest[carried[item]], _ = split_scale(matrices[0])
            tracks.lengths.append(0.1)
            tracks.moves.append(moves)
    tracks.moves = np.moveaxis(tracks.moves, 0, 1) if carried else []
    rigs = {}
    for armature, motion in {**recording.bones, **({TRACKS: tracks} if carried else {})}.items():
        if not motion.rest:
            continue
        rest = {bone: shift @ matrix for bone, matrix in motion.rest.items()}
        data = _armature(f"{name} {armature}", rest, dict(zip(rest, motion.lengths, strict=True)))
        action = bpy.data.actions.new(f"{name} {armature}")
        blocks |= {data: f"{name} {armature}", action: f"{name} {armature}"}
        for bone, moves in zip(rest, np.moveaxis(motion.moves, 1, 0), strict=True):
            _bake(
                action, bone, np.linalg.inv(rest[bone]) @ (shift @ moves @ back) @ rest[bone], times
            )
        rigs[armature] = data, action
    return Model(
        rigs,
        carried,
        {item: shift @ matrices[0] for item, matrices in places.items()},
        times[-1] - times[0],
    )


def _armature(
    name: str, rest: dict[str, np.ndarray], lengths: dict[str, float]
) -> bpy.types.Armature:
    """Return armature data with bones at `rest`, matrices (4, 4), none with a parent."""
    data = bpy.data.armatures.new(name)
    holder = bpy.data.objects.new(name, data)
    stage = bpy.data.scenes.new(".Crowd LOD rig")
    try:
        stage.collection.objects.link(holder)
        layer = stage.view_layers[0]
        layer.objects.active = holder
        with bpy.context.temp_override(
            scene=stage, view_layer=layer, object=holder, active_object=holder
        ):
            bpy.ops.object.mode_set(mode="EDIT")
            for bone, matrix in rest.items():
                edit_bone = data.edit_bones.new(bone)
                edit_bone.tail = 0.0, lengths[bone], 0.0
                edit_bone.matrix = Matrix(matrix.tolist())
            bpy.ops.object.mode_set(mode="OBJECT")
    finally:
        removal.remove([stage, holder])
    return data


def _bake(action: bpy.types.Action, bone: str, basis: np.ndarray, times: np.ndarray) -> None:
    """Write the keys of a bone into `action` at `times` (k,), frames.

    basis: (k, 4, 4), the bone's matrices relative to its rest.
    """
    if not action.slots:
        slot = action.slots.new("OBJECT", "Rig")
        action.layers.new("Rig").strips.new(type="KEYFRAME").channelbag(slot, ensure=True)
    curves = action.layers[0].strips[0].channelbags[0].fcurves
    places, turns, sizes = np.split(channels(basis), [3, 7], axis=1)
    columns = {
        "location": places,
        "rotation_quaternion": turned_shortly(turns),
        "scale": sizes,
    }
    for path, values in columns.items():
        for index, column in enumerate(values.T):
            still = np.ptp(column) < ROUNDING
            at_rest = (
                1.0 if path == "scale" or (path == "rotation_quaternion" and index == 0) else 0.0
            )
            if still and path != "rotation_quaternion" and abs(column[0] - at_rest) < ROUNDING:
                continue  # each curve costs time in each rig at each frame
            keys = np.stack([times[:1], column[:1]] if still else [times, column], axis=1)
            curve = curves.new(
                f'pose.bones["{bpy.utils.escape_identifier(bone)}"].{path}', index=index
            )
            fill_curve(curve, keys)


def fill_curve(curve: bpy.types.FCurve, keys: np.ndarray) -> None:
    """Fill the curve with straight lines through `keys` (k, 2)."""
    points = curve.keyframe_points
    points.add(len(keys))
    points.foreach_set("co", np.float32(keys).ravel())
    points.foreach_set("interpolation", np.full(len(keys), LINEAR, np.int32))
    curve.update()


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
        pauses = Pauses()
        for time in moments:
            performance.go_to(character.stage, time)
            distances.append(measure_copies(copies, character.actors, character.stage, origin))
            yield from pauses.after(work.did(1), performance.rest)
        return distances
    finally:
        performance.rest()
        removal.remove([*rigs.values(), *copies.values()])
