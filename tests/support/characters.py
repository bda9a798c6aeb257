"""Small characters as users have them, for the tests of LOD meshes."""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import numpy as np
from crowd_lod_extension.operators.blender.materials import switch_nodes_on

from .objects import placed


def tube(
    name: str,
    around: int = 24,
    along: int = 24,
    radius: float = 0.2,
    height: float = 2.0,
    split: bool = False,
) -> bpy.types.Mesh:
    """An open upright tube of quads with one UV seam, u around and v along.

    `split` along the seam, as importers do it.
    """
    columns = around + split
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    angle = np.append(angle, angle[:1]) if split else angle
    rows = [
        np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(columns, z)])
        for z in np.linspace(0, height, along + 1)
    ]
    quads = [
        ((j, i), (j, (i + 1) % columns), (j + 1, (i + 1) % columns), (j + 1, i))
        for j in range(along)
        for i in range(around)
    ]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(
        np.concatenate(rows).tolist(), [], [[j * columns + i for j, i in quad] for quad in quads]
    )
    uvs = [
        ((i + di) / around, (j + dj) / along)
        for j in range(along)
        for i in range(around)
        for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1))
    ]
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", np.array(uvs, np.float32).ravel())
    mesh.shade_smooth()
    return mesh


# name: head, tail, and the bone that it hangs on
TWO_BONES = {"lower": ((0, 0, 0), (0, 0, 1), None), "upper": ((0, 0, 1), (0, 0, 2), "lower")}


def armature_of(name: str, bones: dict) -> bpy.types.Object:
    """An armature in the scene, of bones as TWO_BONES has them."""
    armature = placed(name, bpy.data.armatures.new(name))
    with edited(armature) as edit:
        for bone, (head, tail, parent) in bones.items():
            own = edit.new(bone)
            own.head, own.tail = head, tail
            own.parent = edit[parent] if parent else None
    return armature


def rigged(name: str, *sizes, rig_name="rig", **more) -> tuple[bpy.types.Object, bpy.types.Object]:
    """A tube of these sizes, and the rig that bends it."""
    armature = rig(rig_name)
    item = new(name, tube(name, *sizes, **more))
    skin(item, armature)
    return item, armature


def rig(name: str = "rig") -> bpy.types.Object:
    """An armature with a lower and an upper bone; the upper one bends forward from frame 1 to
    10.
    """
    armature = armature_of(name, TWO_BONES)
    bone = armature.pose.bones["upper"]
    bone.rotation_mode = "XYZ"
    for frame, angle in ((1, 0.0), (10, 1.0)):
        bone.rotation_euler = (angle, 0, 0)
        bone.keyframe_insert("rotation_euler", frame=frame)
    bpy.context.scene.collection.objects.unlink(armature)
    return armature


def skin(item: bpy.types.Object, armature: bpy.types.Object) -> None:
    """Bind `item` to the two bones, blended about the height 1."""
    for bone in ("lower", "upper"):
        item.vertex_groups.new(name=bone)
    for vertex in item.data.vertices:
        upper = float(np.clip((vertex.co.z - 0.5) / 1.0, 0, 1))
        item.vertex_groups["lower"].add([vertex.index], 1 - upper, "REPLACE")
        item.vertex_groups["upper"].add([vertex.index], upper, "REPLACE")
    item.parent = armature
    item.modifiers.new("Armature", "ARMATURE").object = armature


def character(*objects: bpy.types.Object, name: str = "someone") -> bpy.types.Collection:
    """The crowd's characters: one group of these objects."""
    scene = bpy.context.scene
    top = bpy.data.collections.get("People") or bpy.data.collections.new("People")
    if top.name not in scene.collection.children:
        scene.collection.children.link(top)
    group = bpy.data.collections.new(name)
    top.children.link(group)
    for item in objects:
        group.objects.link(item)
    scene.crowd_lod.characters = top
    return group


@contextmanager
def edited(armature: bpy.types.Object) -> Iterator[bpy.types.ArmatureEditBones]:
    """The rig's bones in Edit Mode."""
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    yield armature.data.edit_bones
    bpy.ops.object.mode_set(mode="OBJECT")


def new(name: str, data) -> bpy.types.Object:
    return bpy.data.objects.new(name, data)


def painted(name, image, coordinates=None):
    """A material whose color is the image, placed by these coordinates."""
    material = bpy.data.materials.new(name)
    tree = switch_nodes_on(material)
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    tree.links.new(node.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"])
    if coordinates:
        tree.links.new(
            tree.nodes.new("ShaderNodeTexCoord").outputs[coordinates], node.inputs["Vector"]
        )
    return material
