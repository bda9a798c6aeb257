"""Three rigged characters that walk, wait, sit and cheer, made by script: the same every time."""

from collections.abc import Sequence
from functools import partial

import bpy
import numpy as np
from mathutils import Matrix

from ..operators.blender.materials import switch_nodes_on
from .body import Body, Build, make_body
from .walk import Cycle, cheer_cycle, idle_cycle, sit_cycle, walk_cycle

FPS = 24

BUILDS = (
    Build(
        "adult", height=1.75, hip=0.91, neck=1.465, shoulder=0.165, pelvis=0.155, waist=0.110,
        depth=0.100, limb=0.95, head=1.06, sleeve=0.24, trousers=0.0, hem=0.62, hair=0.20,
        skin=(0.55, 0.29, 0.18), clothes=(0.42, 0.03, 0.05), period=26,
    ),
    Build(
        "heavy", height=1.82, hip=0.90, neck=1.50, shoulder=0.215, pelvis=0.195, waist=0.215,
        depth=0.165, limb=1.25, head=1.16, sleeve=0.68, trousers=1.0, hem=0.76, brim=0.06,
        skin=(0.80, 0.52, 0.38), clothes=(0.03, 0.09, 0.25), period=28,
    ),
    Build(
        "child", height=1.20, hip=0.56, neck=0.905, shoulder=0.118, pelvis=0.108, waist=0.100,
        depth=0.085, limb=1.10, head=1.12, sleeve=0.53, trousers=0.55, pack=0.11,
        skin=(0.30, 0.14, 0.08), clothes=(0.65, 0.36, 0.02), period=18,
    ),
)  # fmt: skip


def make_characters(
    collection: bpy.types.Collection,
    speed: float = 1.25,
    builds: Sequence[Build] = BUILDS,
    finer: int = 0,
    plays: Sequence[str] = ("walk",),
) -> list[bpy.types.Collection]:
    """Add rigged characters to `collection`: a child collection for each.

    A child collection holds an armature and its mesh. Its property "stride" is the meters covered
    in one cycle.
    The characters stand at the origin on z = 0, face +x, and walk on the spot. Their actions repeat
    for ever, with one key per frame from frame 1, for 24 frames per second. In a character's own
    space the standing foot of a walk moves along -x at `speed`, meters per second.
    Selection, modes and the current frame stay as they are.
    finer: additional steps of subdivision, each with four times the faces; -2 leaves those of the
    cage, some 350.
    plays: the actions of each, "walk", "idle", "sit" or "cheer"; the last is its own. Their names
        end in that of the character.
    """
    groups = []
    for build in builds:
        body = make_body(build, finer)
        group = bpy.data.collections.new(build.name)
        collection.children.link(group)
        armature = make_armature(build.name, body)
        mesh = make_mesh(build, body)
        mesh.parent = armature
        mesh.modifiers.new("Armature", "ARMATURE").object = armature
        for item in (armature, mesh):
            group.objects.link(item)
        cycles = {
            "walk": partial(walk_cycle, period=build.period, stride=speed * build.period / FPS),
            "idle": partial(idle_cycle, period=4 * build.period),
            "sit": partial(sit_cycle, period=4 * build.period),
            "cheer": partial(cheer_cycle, period=build.period),
        }
        for name in plays:
            cycle = cycles[name](body.joints)
            action = make_action(f"{name} {group.name}", armature, cycle)
            action.use_fake_user = name != plays[-1]
        group["stride"] = cycle.stride
        groups.append(group)
    return groups


def make_armature(name: str, body: Body) -> bpy.types.Object:
    """Return the armature of the rest skeleton.

    Bones can only be made in edit mode. It is entered in a temporary scene, so that the user's
    scene, selection and mode do not change.
    """
    armature = bpy.data.objects.new(f"{name} rig", bpy.data.armatures.new(f"{name} rig"))
    workshop = bpy.data.scenes.new("Workshop")
    try:
        workshop.collection.objects.link(armature)
        layer = workshop.view_layers[0]
        layer.objects.active = armature
        context = {
            "scene": workshop,
            "view_layer": layer,
            "active_object": armature,
            "object": armature,
        }
        with bpy.context.temp_override(**context):
            bpy.ops.object.mode_set(mode="EDIT")
            for bone, (parent, head, tail) in body.joints.items():
                edit = armature.data.edit_bones.new(bone)
                edit.head = head
                edit.tail = tail
                edit.align_roll((1, 0, 0))
                if parent:
                    edit.parent = armature.data.edit_bones[parent]
            bpy.ops.object.mode_set(mode="OBJECT")
    finally:
        bpy.data.scenes.remove(workshop)
    return armature


def make_mesh(build: Build, body: Body) -> bpy.types.Object:
    """Return the mesh object with its UV map, materials and vertex groups."""
    mesh = bpy.data.meshes.new(build.name)
    mesh.vertices.add(len(body.vertices))
    mesh.vertices.foreach_set("co", body.vertices.astype(np.float32).ravel())
    mesh.loops.add(len(body.corners))
    mesh.loops.foreach_set("vertex_index", body.corners.astype(np.int32))
    mesh.polygons.add(len(body.sizes))
    starts = np.cumsum(body.sizes) - body.sizes
    mesh.polygons.foreach_set("loop_start", starts.astype(np.int32))
    mesh.update(calc_edges=True)
    mesh.polygons.foreach_set("material_index", body.materials.astype(np.int32))
    mesh.shade_smooth()
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", body.uvs.astype(np.float32).ravel())
    mesh.materials.append(make_material(f"{build.name} skin", build.skin, 0.55))
    mesh.materials.append(make_material(f"{build.name} clothes", build.clothes, 0.85))

    item = bpy.data.objects.new(build.name, mesh)
    for bone, column in zip(body.joints, body.weights.T, strict=True):
        group = item.vertex_groups.new(name=bone)
        for vertex in np.flatnonzero(column).tolist():
            group.add((vertex,), float(column[vertex]), "REPLACE")
    return item


def make_material(name: str, color: tuple, roughness: float) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    nodes = switch_nodes_on(material).nodes
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = (*color, 1)
    shader.inputs["Roughness"].default_value = material.roughness = roughness
    material.diffuse_color = (*color, 1)
    return material


def make_action(name: str, armature: bpy.types.Object, cycle: Cycle) -> bpy.types.Action:
    """Give the armature an action `name`, which repeats, with a key per frame of the cycle's poses.

    It begins at frame 1.
    """
    action = bpy.data.actions.new(name)
    armature.animation_data_create().action = action
    bones = armature.data.bones
    rest = {bone.name: np.array(bone.matrix_local.to_3x3()) for bone in bones}
    for bone in bones:
        turns = cycle.turns[bone.name]
        above = cycle.turns[bone.parent.name] if bone.parent else np.eye(3)
        local = rest[bone.name].T @ np.swapaxes(above, -1, -2) @ turns @ rest[bone.name]
        path = f'pose.bones["{bone.name}"]'
        key(action, armature, f"{path}.rotation_quaternion", quaternions(local))
        if not bone.parent:
            key(action, armature, f"{path}.location", cycle.shift @ rest[bone.name])
    return action


def quaternions(matrices: np.ndarray) -> np.ndarray:
    """Return (n, 4) quaternions of matrices (n, 3, 3), without jumps of sign.

    A jump would spin a bone between two keys.
    """
    values = np.array([Matrix(matrix).to_quaternion() for matrix in matrices])
    flips = np.where((values[1:] * values[:-1]).sum(1) < 0, -1, 1)
    values[1:] *= np.cumprod(flips)[:, None]
    return values


def key(
    action: bpy.types.Action, armature: bpy.types.Object, path: str, values: np.ndarray
) -> None:
    """Add one F-curve for each column of `values`, linear between frames.

    values: (frames, columns).
    """
    for index, column in enumerate(values.T):
        curve = action.fcurve_ensure_for_datablock(armature, path, index=index)
        points = curve.keyframe_points
        points.add(len(column))
        frames = np.arange(1, len(column) + 1)
        points.foreach_set("co", np.stack([frames, column], 1).astype(np.float32).ravel())
        points.foreach_set("interpolation", np.ones(len(column), np.int32))
        curve.modifiers.new("CYCLES")
        curve.update()
