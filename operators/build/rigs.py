"""Rigs: clean copies of a character's armatures, one for each phase class, that play its baked action in a shared mesh.

A rig has a bone for each bone that deforms the character, and one for each of its objects that moves as a whole. What the action,
constraints, IK and drivers make of these in the world is baked into one action that all rigs share; each plays it by a strip of
its own, whose time runs round the action for ever (docs/notes/shared_rigs.md).
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np
from mathutils import Matrix

from ..blender import mesh_data
from ..blender.rig_dependencies import action_range, armatures_of

FARTHEST = 1_048_574  # frames: Blender's last
FINEST, MOST_KEYS = 16, 4096  # keys a frame of the action, and in all, at most
NEAR = 1e-4  # of the character's diagonal: how far what rigs show should be from what the character is
ACCEPTED = 0.01  # of it: how far it may be, where more keys do not help; posed meshes of a long action are farther off
STILL = 1e-6  # metres, and radians: an object that moves by less stands
ROUNDING = 1e-5  # of a bone's place, turn and size: what changes by less does not change
TRACKS = "Crowd LOD tracks"  # a rig whose bones carry objects
LINEAR = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value
SIMULATED = {"CLOTH", "SOFT_BODY", "FLUID", "DYNAMIC_PAINT", "OCEAN", "PARTICLE_SYSTEM", "COLLISION", "EXPLODE"}


@dataclass
class Bones:
    """What bones do over time, in the world. rest: of each bone its matrix (4, 4) without scale; back: the inverses (bones, 4, 4) of
    their matrices in the armature, at rest; moves: at each time the matrices (bones, 4, 4) that take a point which they deform from its
    place at rest to where it is then."""

    rest: dict[str, np.ndarray] = field(default_factory=dict)
    lengths: list[float] = field(default_factory=list)
    moves: list[np.ndarray] = field(default_factory=list)
    back: np.ndarray | None = None


@dataclass(frozen=True)
class Model:
    """What the rigs of one character are made from. rigs: of each of its armatures, and of TRACKS, the data and the action
    that all its rigs share; carried: of objects that move as a whole, the bones that carry them; stands: of each object its
    matrix (4, 4) in the character's space at the first frame; length: frames of the action."""

    rigs: dict[str, tuple[bpy.types.Armature, bpy.types.Action]]
    carried: dict[bpy.types.Object, str]
    stands: dict[bpy.types.Object, np.ndarray]
    length: float


def refusal(objects: Sequence[bpy.types.Object]) -> str:
    """Why no rigs can show `objects`, by what they are made of; "" if nothing says so."""
    for item in objects:
        keys = getattr(item.data, "shape_keys", None)
        if keys is not None and keys.animation_data is not None:
            return f"the shape keys of {item.name} are animated"
        for modifier in item.modifiers:
            if modifier.type in SIMULATED:
                return f"{item.name} is simulated by {modifier.name}"
    if any(bone.bbone_segments > 1 for rig in armatures_of(objects) for bone in rig.data.bones if bone.use_deform):
        return "its armature has bendy bones"
    return ""


def record(actors: dict, times: np.ndarray) -> Generator[float, None, tuple[dict[str, Bones], dict[bpy.types.Object, np.ndarray]]]:
    """Evaluate at `times`, frames of the action, what moves objects, whose `actors` stand for them; yields the progress and returns
    (of each armature, by its name, its Bones; of each object its matrices (len(times), 4, 4))."""
    armatures, stage = armatures_of(list(actors)), bpy.data.scenes.new("Crowd LOD record")
    bare = {item: _bare(actor) for item, actor in actors.items()}  # nothing is deformed here, which would take the time
    try:
        for block in (*armatures, *bare.values()):
            stage.collection.objects.link(block)
        bones, places = {rig.name: Bones() for rig in armatures}, {item: [] for item in actors}
        wanted = {rig: _deforming(rig, list(actors)) for rig in armatures}
        for number, time in enumerate(times):
            stage.frame_set(int(time // 1), subframe=float(time % 1))
            depsgraph = stage.view_layers[0].depsgraph
            for item, own in bare.items():
                places[item].append(np.array(own.evaluated_get(depsgraph).matrix_world, np.float64))
            for rig in armatures:
                _note(bones[rig.name], rig.evaluated_get(depsgraph), wanted[rig])
            yield (number + 1) / len(times)
        return bones, {item: np.array(found) for item, found in places.items()}
    finally:
        bpy.data.batch_remove([stage, *bare.values()])


def _bare(actor: bpy.types.Object) -> bpy.types.Object:
    """A copy of the object, without modifiers, that moves as it does."""
    copy = _alone(actor)
    copy.modifiers.clear()
    return copy


def _alone(item: bpy.types.Object) -> bpy.types.Object:
    """A copy of the object, in no collection."""
    copy = item.copy()
    if copy.override_library:
        copy.make_local()
    for collection in copy.users_collection:  # Blender puts a copy of a rigid body into the simulation
        collection.objects.unlink(copy)
    return copy


def _note(own: Bones, rig: bpy.types.Object, wanted: list[str]) -> None:
    """Add to `own` what the bones `wanted` of the evaluated armature `rig` do now."""
    if not wanted:
        return
    world, bones = np.array(rig.matrix_world, np.float64), rig.pose.bones
    if own.back is None:
        rests = [np.array(bones[name].bone.matrix_local, np.float64) for name in wanted]
        own.back = np.linalg.inv(rests)
        for name, rest in zip(wanted, rests, strict=True):
            own.rest[name], scale = _plain(world @ rest)
            own.lengths.append(max(bones[name].bone.length * scale, 1e-4))
    matrices = np.empty((len(bones), 4, 4), np.float32)
    bones.foreach_get("matrix", matrices.ravel())  # column by column
    now = matrices[[bones.find(name) for name in wanted]].transpose(0, 2, 1).astype(np.float64)
    own.moves.append(world @ now @ own.back @ np.linalg.pinv(world))


def _deforming(rig: bpy.types.Object, objects: Sequence[bpy.types.Object]) -> list[str]:
    """The bones of the armature `rig` that may deform one of `objects`; all that deform where envelopes do."""
    groups = {group.name for item in objects if item.type == "MESH" for group in item.vertex_groups}
    envelopes = any(m.type == "ARMATURE" and m.object == rig and m.use_bone_envelopes for item in objects for m in item.modifiers)
    return [bone.name for bone in rig.data.bones if bone.use_deform and (envelopes or bone.name in groups)]


def _plain(matrix: np.ndarray) -> tuple[np.ndarray, float]:
    """(the rotation and place that are nearest to `matrix` (4, 4), its mean scale)."""
    left, scales, right = np.linalg.svd(matrix[:3, :3])
    turned = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    plain = np.eye(4)
    plain[:3, :3], plain[:3, 3] = turned, matrix[:3, 3]
    return plain, float(scales.mean())


def model_of(name: str, bones: dict[str, Bones], places: dict, origin: np.ndarray, span: tuple[float, float], made: dict) -> Model:
    """The model of the character `name` from what was recorded at even times over `span`, frames of its action, about its
    `origin` (3,), metres; `made` gets the data-blocks, with what they are to be called."""
    shift = np.eye(4)
    shift[:3, 3] = -np.asarray(origin)
    back, carried, tracks = np.linalg.inv(shift), {}, Bones()
    for number, (item, matrices) in enumerate(places.items()):
        moves = matrices @ np.linalg.pinv(matrices[0])
        if np.abs(moves - np.eye(4)).max() > STILL:
            carried[item] = f"object {number:03d}"
            tracks.rest[carried[item]], _ = _plain(matrices[0])
            tracks.lengths.append(0.1)
            tracks.moves.append(moves)
    tracks.moves = np.moveaxis(tracks.moves, 0, 1) if carried else []
    rigs = {}
    for armature, own in {**bones, **({TRACKS: tracks} if carried else {})}.items():
        if not own.rest:
            continue
        rest = {bone: shift @ matrix for bone, matrix in own.rest.items()}
        data = _armature(f"{name} {armature}", rest, dict(zip(rest, own.lengths, strict=True)))
        action = bpy.data.actions.new(f"{name} {armature}")
        made |= {data: f"{name} {armature}", action: f"{name} {armature}"}
        for bone, moves in zip(rest, np.moveaxis(own.moves, 1, 0), strict=True):
            _bake(action, bone, np.linalg.inv(rest[bone]) @ (shift @ moves @ back) @ rest[bone], span)
        rigs[armature] = data, action
    return Model(rigs, carried, {item: shift @ matrices[0] for item, matrices in places.items()}, span[1] - span[0])


def _armature(name: str, rest: dict[str, np.ndarray], lengths: dict[str, float]) -> bpy.types.Armature:
    """Armature data with bones at `rest`, matrices (4, 4), none the parent of another."""
    data = bpy.data.armatures.new(name)
    holder, stage = bpy.data.objects.new(name, data), bpy.data.scenes.new("Crowd LOD rig")
    try:
        stage.collection.objects.link(holder)
        layer = stage.view_layers[0]
        layer.objects.active = holder
        with bpy.context.temp_override(scene=stage, view_layer=layer, object=holder, active_object=holder):
            bpy.ops.object.mode_set(mode="EDIT")
            for bone, matrix in rest.items():
                made = data.edit_bones.new(bone)
                made.tail = 0.0, lengths[bone], 0.0
                made.matrix = Matrix(matrix.tolist())
            bpy.ops.object.mode_set(mode="OBJECT")
    finally:
        bpy.data.batch_remove([stage, holder])
    return data


def _bake(action: bpy.types.Action, bone: str, basis: np.ndarray, span: tuple[float, float]) -> None:
    """Keys of the `basis` (k, 4, 4), the bone's matrices against its rest, at even times over `span`, frames."""
    if not action.slots:
        slot = action.slots.new("OBJECT", "Rig")
        action.layers.new("Rig").strips.new(type="KEYFRAME").channelbag(slot, ensure=True)
    curves = action.layers[0].strips[0].channelbags[0].fcurves
    parts = [Matrix(matrix.tolist()).decompose() for matrix in basis]
    turns = np.array([turn for _, turn, _ in parts])
    signs = np.cumprod(np.sign(np.append(1.0, (turns[1:] * turns[:-1]).sum(axis=1))) + 0.0)
    turns *= np.where(signs == 0, 1.0, signs)[:, None]  # the short way round
    times = np.linspace(*span, len(basis))
    columns = {"location": [place for place, _, _ in parts], "rotation_quaternion": turns, "scale": [size for _, _, size in parts]}
    for path, values in columns.items():
        for index, column in enumerate(np.array(values, np.float64).T):
            still = np.ptp(column) < ROUNDING
            at_rest = 1.0 if path == "scale" or (path == "rotation_quaternion" and index == 0) else 0.0
            if still and path != "rotation_quaternion" and abs(column[0] - at_rest) < ROUNDING:
                continue  # each curve costs time in each rig at each frame
            keys = np.stack([times[:1], column[:1]] if still else [times, column], axis=1)
            curve = curves.new(f'pose.bones["{bpy.utils.escape_identifier(bone)}"].{path}', index=index)
            _fill(curve, keys)


def _fill(curve: bpy.types.FCurve, keys: np.ndarray) -> None:
    """Straight lines through `keys` (k, 2)."""
    points = curve.keyframe_points
    points.add(len(keys))
    points.foreach_set("co", np.float32(keys).ravel())
    points.foreach_set("interpolation", np.full(len(keys), LINEAR, np.int32))
    curve.update()


def perform(model: Model, title: str, rate: float, phase: float, span: tuple[float, float]) -> dict[str, bpy.types.Object]:
    """Of each armature of `model` a rig that stands about the origin and plays its action from `span`, frames, so that it is at
    `phase` in frame 0 and goes on by `rate` cycles a frame."""
    made = {}
    first, last = span
    for armature, (data, action) in model.rigs.items():
        rig = made[armature] = bpy.data.objects.new(f"{title} {armature}", data)
        track = rig.animation_data_create().nla_tracks.new()
        strip = track.strips.new("Phase", 0, action)  # which plays its one slot; to set that crashes Blender
        strip.use_animated_time, strip.extrapolation = True, "HOLD"
        strip.frame_start_ui, strip.frame_end_ui = -FARTHEST, FARTHEST
        time = strip.fcurves.find("strip_time")
        if rate:
            begin = -phase / rate
            _fill(time, np.array([(begin, first), (begin + 1 / rate, last)]))
            round_and_round = time.modifiers.new("CYCLES")
            round_and_round.mode_before = round_and_round.mode_after = "REPEAT"
        else:
            _fill(time, np.array([(0.0, first + phase * (last - first))]))
    return made


def dress(item: bpy.types.Object, model: Model, rigs: dict[str, bpy.types.Object], actor=None) -> bpy.types.Object:
    """A copy of the LOD object `item`, with its mesh, that the `rigs` of a class move and deform; of its `actor`, if given."""
    copy = _alone(actor or item)
    copy.animation_data_clear()
    copy.constraints.clear()
    bent_by = item.parent if item.parent_type == "ARMATURE" else None
    copy.parent, copy.parent_type = None, "OBJECT"
    if item in model.carried:
        rig, bone = rigs[TRACKS], model.carried[item]
        copy.parent, copy.parent_type, copy.parent_bone = rig, "BONE", bone
        rest = rig.data.bones[bone]
        copy.matrix_parent_inverse = (rest.matrix_local @ Matrix.Translation((0.0, rest.length, 0.0))).inverted()
    copy.matrix_basis = Matrix(model.stands[item].tolist())
    if bent_by is not None:  # as such a parent does, before all modifiers
        copy.modifiers.new(bent_by.name, "ARMATURE").object = bent_by
        copy.modifiers.move(len(copy.modifiers) - 1, 0)
    for modifier in copy.modifiers:
        if modifier.type == "ARMATURE" and modifier.object is not None:
            modifier.object = rigs.get(modifier.object.name)
    return copy


def shown_off(copies: dict, actors: dict, stage: bpy.types.Scene, origin: np.ndarray, frame: float) -> float:
    """Metres, the most by which a vertex of `copies`, of each object its copy about the world's origin, is off the object as its
    actor shows it in `stage`, in whose frame `frame` both are at the same phase; infinity where they have not the same vertices."""
    stage.frame_set(int(frame // 1), subframe=float(frame % 1))
    depsgraph, worst = stage.view_layers[0].depsgraph, 0.0
    for item, copy in copies.items():
        mine, own = (mesh_data.world_points(each.evaluated_get(depsgraph)) for each in (copy, actors[item]))
        if mine.shape != own.shape:
            return np.inf
        worst = max(worst, float(np.linalg.norm(mine + origin - own, axis=1).max(initial=0.0)))
    return worst


def modelled(
    name: str, homes: Sequence[bpy.types.Collection], actors: dict, stage: bpy.types.Scene, diagonal: float, made: dict
) -> Generator[float, None, tuple[Model | None, str]]:
    """Make the model of the character `name`, whose LODs are in `homes`, with as many keys as bring what its rigs show within NEAR
    of its `diagonal`, metres, if they do. Yields the progress; returns (the Model, a sentence on how far off that is, if it is
    farther) or (None, why no rigs can show it)."""
    objects = list(actors)
    span, origin = action_range(objects), np.array(homes[0].instance_offset, np.float64)
    reason = refusal(objects)
    if reason:
        return None, reason
    frames, keys, best, nearest = max(span[1] - span[0], 1.0), 1, None, np.inf
    most = int(np.clip(MOST_KEYS / frames, 1, FINEST))
    while True:
        times = np.linspace(*span, int(np.ceil(frames * keys)) + 1)
        bones, places = yield from record(actors, times)
        model = model_of(name, bones, places, origin, span, made)
        off = _off(model, actors, stage, origin, span, times) / diagonal
        gained = off < nearest / 2
        if off < nearest:
            best, model, nearest = model, best, off
        _drop(model, made)  # the one that is farther off
        if nearest <= NEAR or keys == most or not gained:
            break
        keys = min(most, keys * max(2, int(np.ceil(1.1 * np.sqrt(off / NEAR)))))  # the chords' error falls by squares
    if nearest <= NEAR:
        return best, ""
    if nearest <= ACCEPTED:
        return best, f"Between two keys the rigs of {name} show it up to {nearest * diagonal:.2g} m off."
    _drop(best, made)
    return None, f"bones show it {nearest * diagonal:.2g} m off" if best else "its vertices become more or fewer"


def _drop(model: Model | None, made: dict[bpy.types.ID, str]) -> None:
    """Remove what `model` was made of, which is in `made`."""
    blocks = [block for pair in model.rigs.values() for block in pair] if model else []
    for block in blocks:
        del made[block]
    bpy.data.batch_remove(blocks)


def _off(model: Model, actors: dict, stage: bpy.types.Scene, origin: np.ndarray, span: tuple[float, float], times) -> float:
    """Metres that what a rig of `model` shows is off, at most, where it was recorded and halfway between."""
    rigs = perform(model, "Crowd LOD trial", 1 / (span[1] - span[0]), -span[0] / (span[1] - span[0]), span)
    copies = {item: dress(item, model, rigs, actor) for item, actor in actors.items()}
    try:
        for block in (*rigs.values(), *copies.values()):
            stage.collection.objects.link(block)
        middle = (times[:-1] + times[1:]) / 2
        chosen = np.unique(np.linspace(0, len(middle) - 1, 5).round().astype(int))
        return max(shown_off(copies, actors, stage, origin, frame) for frame in (*middle[chosen], times[len(times) // 2]))
    finally:
        bpy.data.batch_remove([*rigs.values(), *copies.values()])
