"""Rigs: clean copies of a character's armatures that play its baked action.

There is one rig per phase class; all share one mesh. A rig has a bone for each bone that deforms
the character, and one for each object that moves as a whole. The world-space motion that the
action, constraints, IK and drivers give these is baked into one action that all rigs share. Each
rig plays it by a strip of its own, whose time cycles through the action for ever
(docs/notes/costs.md).
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np
from mathutils import Matrix

from ..blender import mesh_data
from ..blender.animation import armatures_of
from ..blender.performance import Performance
from ..characters.rig_needs import deforming, refusal

FARTHEST = 1_048_574  # frames: Blender's last
# keys a frame of the action, and in all, at most
FINEST = 16
MOST_KEYS = 4096
# of the character's diagonal: how far what rigs show should be from what the character is
NEAR = 1e-4
# of it: how far it may be, where more keys do not help; posed meshes of a long action are farther
# off
ACCEPTED = 0.01
STILL = 1e-6  # meters, and radians: an object that moves by less stands
ROUNDING = 1e-5  # of a bone's place, turn and size: what changes by less does not change
TRACKS = "Crowd LOD tracks"  # a rig whose bones carry objects
LINEAR = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value


@dataclass
class Bones:
    """The motion of bones over time, in world space.

    rest: bone name -> (4, 4) matrix at rest, without scale.
    lengths: of each bone, meters.
    back: (bones, 4, 4), inverses of the bones' rest matrices in armature space.
    moves: per time (bones, 4, 4), the matrices that take a point that a bone deforms from its place
        at rest to its place then.
    """

    rest: dict[str, np.ndarray] = field(default_factory=dict)
    lengths: list[float] = field(default_factory=list)
    moves: list[np.ndarray] = field(default_factory=list)
    back: np.ndarray | None = None


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


def record(
    actors: dict, times: np.ndarray, performance: Performance
) -> Generator[float, None, tuple[dict[str, Bones], dict[bpy.types.Object, np.ndarray]]]:
    """Record the motion of objects and armatures at `times`, moments of the `performance`.

    actors: object -> the object that stands for it.

    Yields the progress and returns (armature name -> Bones, object -> matrices (len(times), 4, 4)).
    """
    armatures = armatures_of(list(actors))
    stage = bpy.data.scenes.new("Crowd LOD record")
    # nothing is deformed here, which would take the time
    bare = {item: _bare(actor) for item, actor in actors.items()}
    try:
        for block in (*armatures, *bare.values()):
            stage.collection.objects.link(block)
        bones = {rig.name: Bones() for rig in armatures}
        places = {item: [] for item in actors}
        bone_names = {rig: deforming(rig, list(actors)) for rig in armatures}
        for number, time in enumerate(times):
            performance.go_to(stage, time)
            depsgraph = stage.view_layers[0].depsgraph
            for item, own in bare.items():
                places[item].append(np.array(own.evaluated_get(depsgraph).matrix_world, np.float64))
            for rig in armatures:
                _note(bones[rig.name], rig.evaluated_get(depsgraph), bone_names[rig])
            performance.rest()
            yield (number + 1) / len(times)
        return bones, {item: np.array(found) for item, found in places.items()}
    finally:
        performance.rest()
        bpy.data.batch_remove([stage, *bare.values()])


def _bare(actor: bpy.types.Object) -> bpy.types.Object:
    """Return a copy of the object without modifiers that moves as it does."""
    copy = _alone(actor)
    copy.modifiers.clear()
    return copy


def _alone(item: bpy.types.Object) -> bpy.types.Object:
    """Return a copy of the object that is in no collection."""
    copy = item.copy()
    if copy.override_library:
        copy.make_local()
    # Blender puts a copy of a rigid body into the simulation
    for collection in copy.users_collection:
        collection.objects.unlink(copy)
    return copy


def _note(motion: Bones, rig: bpy.types.Object, names: list[str]) -> None:
    """Add the current motion of the evaluated rig's bones `names` to `motion`."""
    if not names:
        return
    world = np.array(rig.matrix_world, np.float64)
    bones = rig.pose.bones
    if motion.back is None:
        rests = [np.array(bones[name].bone.matrix_local, np.float64) for name in names]
        motion.back = np.linalg.inv(rests)
        for name, rest in zip(names, rests, strict=True):
            motion.rest[name], scale = _plain(world @ rest)
            motion.lengths.append(max(bones[name].bone.length * scale, 1e-4))
    matrices = np.empty((len(bones), 4, 4), np.float32)
    bones.foreach_get("matrix", matrices.ravel())  # column by column
    now = matrices[[bones.find(name) for name in names]].transpose(0, 2, 1).astype(np.float64)
    motion.moves.append(world @ now @ motion.back @ np.linalg.pinv(world))


def _plain(matrix: np.ndarray) -> tuple[np.ndarray, float]:
    """Return (the rotation and location nearest to `matrix` (4, 4), its mean scale)."""
    left, scales, right = np.linalg.svd(matrix[:3, :3])
    turned = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    plain = np.eye(4)
    plain[:3, :3] = turned
    plain[:3, 3] = matrix[:3, 3]
    return plain, float(scales.mean())


def model_of(
    name: str,
    bones: dict[str, Bones],
    places: dict,
    origin: np.ndarray,
    times: np.ndarray,
    blocks: dict,
) -> Model:
    """Return the model of the character `name` from its recorded motion.

    bones, places: from `record`, at `times`.
    origin: (3,) meters, the character's origin.
    times: (k,) frames of its action, from its first to its last.
    blocks: gets the new data-blocks with their final names.
    """
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
            tracks.rest[carried[item]], _ = _plain(matrices[0])
            tracks.lengths.append(0.1)
            tracks.moves.append(moves)
    tracks.moves = np.moveaxis(tracks.moves, 0, 1) if carried else []
    rigs = {}
    for armature, motion in {**bones, **({TRACKS: tracks} if carried else {})}.items():
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
    stage = bpy.data.scenes.new("Crowd LOD rig")
    try:
        stage.collection.objects.link(holder)
        layer = stage.view_layers[0]
        layer.objects.active = holder
        with bpy.context.temp_override(
            scene=stage, view_layer=layer, object=holder, active_object=holder
        ):
            bpy.ops.object.mode_set(mode="EDIT")
            for bone, matrix in rest.items():
                made = data.edit_bones.new(bone)
                made.tail = 0.0, lengths[bone], 0.0
                made.matrix = Matrix(matrix.tolist())
            bpy.ops.object.mode_set(mode="OBJECT")
    finally:
        bpy.data.batch_remove([stage, holder])
    return data


def _bake(action: bpy.types.Action, bone: str, basis: np.ndarray, times: np.ndarray) -> None:
    """Write the keys of a bone into `action` at `times` (k,), frames.

    basis: (k, 4, 4), the bone's matrices relative to its rest.
    """
    if not action.slots:
        slot = action.slots.new("OBJECT", "Rig")
        action.layers.new("Rig").strips.new(type="KEYFRAME").channelbag(slot, ensure=True)
    curves = action.layers[0].strips[0].channelbags[0].fcurves
    parts = [Matrix(matrix.tolist()).decompose() for matrix in basis]
    turns = np.array([turn for _, turn, _ in parts])
    signs = np.cumprod(np.sign(np.append(1.0, (turns[1:] * turns[:-1]).sum(axis=1))) + 0.0)
    turns *= np.where(signs == 0, 1.0, signs)[:, None]  # the short way round
    columns = {
        "location": [place for place, _, _ in parts],
        "rotation_quaternion": turns,
        "scale": [size for _, _, size in parts],
    }
    for path, values in columns.items():
        for index, column in enumerate(np.array(values, np.float64).T):
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
        track = rig.animation_data_create().nla_tracks.new()
        # which plays its one slot; to set that crashes Blender
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
    copy = _alone(actor or item)
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


def shown_off(copies: dict, actors: dict, stage: bpy.types.Scene, origin: np.ndarray) -> float:
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


def modeled(
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
    (span,) = performance.spans
    (played,) = performance.names
    name = f"{character.name} {played}".rstrip()
    reason = refusal(list(actors))
    if reason:
        return None, reason
    frames = max(span[1] - span[0], 1.0)
    keys = 1
    best = None
    nearest = np.inf
    most = int(np.clip(MOST_KEYS / frames, 1, FINEST))
    while True:
        times = performance.keys(keys)
        bones, places = yield from record(actors, times, performance)
        model = model_of(name, bones, places, origin, times, blocks)
        off = _off(model, character, performance, _looks(times, bones)) / diagonal
        gained = off < nearest / 2
        if off < nearest:
            best, model, nearest = model, best, off
        _drop(model, blocks)  # the one that is farther off
        if nearest <= NEAR or keys == most or not gained:
            break
        # the chords' error falls by squares
        keys = min(most, keys * max(2, int(np.ceil(1.1 * np.sqrt(off / NEAR)))))
    if nearest <= NEAR:
        return best, ""
    if nearest <= ACCEPTED:
        return (
            best,
            f"Between keyframes the rigs of {name} are off by up to {nearest:.2%} of its size.",
        )
    _drop(best, blocks)
    return (
        None,
        f"rigs would be off by {nearest:.2%} of its size"
        if best
        else "its number of vertices changes during the action",
    )


def _drop(model: Model | None, made: dict[bpy.types.ID, str]) -> None:
    """Remove the data-blocks of `model`, also from `made`."""
    blocks = [block for pair in model.rigs.values() for block in pair] if model else []
    for block in blocks:
        del made[block]
    bpy.data.batch_remove(blocks)


def _looks(times: np.ndarray, bones: dict[str, Bones]) -> np.ndarray:
    """Return the moments at which rigs are compared with the character, up to ten of them.

    Halfway between keys: five evenly over all, and four where the bones turn off their way most;
    and a recorded one.

    times: (k,), at which `bones` were recorded.
    """
    bends = np.zeros(len(times) - 1)
    for motion in bones.values():
        if motion.rest and len(times) > 2:
            rest = np.array(list(motion.rest.values()))
            ends = rest[:, None, :, 3] + np.array(motion.lengths)[:, None, None] * np.concatenate(
                [np.zeros((len(rest), 1, 4)), rest.transpose(0, 2, 1)[:, :3]], axis=1
            )
            way = np.einsum("kbij,bpj->kbpi", np.array(motion.moves), ends)
            bend = np.linalg.norm(np.diff(way, 2, axis=0), axis=-1).max(axis=(1, 2))
            bends = np.maximum(
                bends, np.maximum(np.append(bend[0], bend), np.append(bend, bend[-1]))
            )
    intervals = np.union1d(
        np.argsort(bends)[-4:], np.linspace(0, len(bends) - 1, 5).round().astype(int)
    )
    return np.append((times[:-1] + times[1:])[intervals] / 2, times[len(times) // 2])


def _off(model: Model, character: Acting, performance: Performance, moments: np.ndarray) -> float:
    """Return how far off a rig of `model` shows the character at the moments `moments`, at most,
    meters.
    """
    (span,) = performance.spans
    origin = np.array(character.homes[0].instance_offset, np.float64)
    length = max(span[1] - span[0], 1.0)
    rigs = perform(model, "Crowd LOD trial", 1 / length, -span[0] / length, span)
    copies = {item: dress(item, model, rigs, actor) for item, actor in character.actors.items()}
    try:
        for block in (*rigs.values(), *copies.values()):
            character.stage.collection.objects.link(block)
        worst = 0.0
        for time in moments:
            performance.go_to(character.stage, time)
            worst = max(worst, shown_off(copies, character.actors, character.stage, origin))
        return worst
    finally:
        performance.rest()
        bpy.data.batch_remove([*rigs.values(), *copies.values()])
