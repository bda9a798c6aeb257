"""Models of rigs: recorded motion as armatures and actions, shared by a character's rigs."""

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from ..blender import removal
from ..characters.bone_channels import ROUNDING, channels, turned_shortly
from ..characters.bone_motion import Bones, split_scale
from .close_recording import MotionRecording

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
