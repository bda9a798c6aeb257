"""Other ways to cull, give LODs and sort, each on the same crowd.

The core is measured beside them.
"""

from functools import cache

import bpy
import numpy as np
from crowd_lod_extension.crowd_lod.crowd.agents import Crowd, Group
from crowd_lod_extension.crowd_lod.culling.camera import Camera
from crowd_lod_extension.crowd_lod.culling.frustum import frustum_of


def naive(crowd: Crowd, group: Group, camera: Camera, thresholds: np.ndarray) -> list[np.ndarray]:
    """The chapter's listings line by line in NumPy.

    Camera coordinates of all, the radar test with the derived widening, a sum of unit steps, and
    one pass a LOD.
    """
    v = np.stack([crowd.x, crowd.y, crowd.z + group.center], axis=1) - camera.origin
    along = v @ camera.Z
    visible = (along >= camera.near - group.radius) & (along <= camera.far + group.radius)
    for axis, low, high in (
        (camera.X, camera.window.left, camera.window.right),
        (camera.Y, camera.window.bottom, camera.window.top),
    ):
        across = v @ axis
        visible &= across <= high * along + group.radius * np.hypot(1, high)
        visible &= across >= low * along - group.radius * np.hypot(1, low)
    level = (
        sum((along >= threshold).astype(np.int64) for threshold in thresholds)
        if len(thresholds)
        else np.zeros(len(v), np.int64)
    )
    return [np.flatnonzero(visible & (level == k)) for k in range(len(thresholds) + 1)]


def six_planes(
    crowd: Crowd, group: Group, camera: Camera, thresholds: np.ndarray
) -> list[np.ndarray]:
    """Six planes as one matrix product over all agents, then a stable sort."""
    frustum = frustum_of(camera)
    rows = np.vstack([frustum.normals, camera.Z])
    spheres = np.array([crowd.x, crowd.y, crowd.z + group.center])
    signed = rows @ spheres - (rows @ camera.origin)[:, None]
    visible = np.flatnonzero((signed[:6] <= (frustum.offsets + group.radius)[:, None]).all(axis=0))
    level = np.searchsorted(thresholds, signed[6, visible], side="right").astype(np.uint8)
    visible = visible[np.argsort(level, kind="stable")]
    return np.split(visible, np.cumsum(np.bincount(level, minlength=len(thresholds) + 1))[:-1])


@cache
def has_gpu() -> bool:
    """Whether shaders run here: before Blender 5.1 they need its window."""
    import gpu

    try:
        gpu.init()
    except (AttributeError, SystemError):
        return False
    return True


def points_of(name: str, crowd: Crowd, height: float) -> bpy.types.Object:
    """An object with one vertex for each agent, `height` meters above its feet."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(crowd))
    places = np.stack([crowd.x, crowd.y, crowd.z + height], axis=1).astype(np.float32)
    mesh.vertices.foreach_set("co", places.ravel())
    return bpy.data.objects.new(name, mesh)


class Tree:
    """A tree of geometry nodes in the making, with a geometry in and out."""

    def __init__(self, name: str):
        self.group = bpy.data.node_groups.new(name, "GeometryNodeTree")
        for in_out in ("INPUT", "OUTPUT"):
            self.group.interface.new_socket(
                "Geometry", in_out=in_out, socket_type="NodeSocketGeometry"
            )
        self.geometry = self.group.nodes.new("NodeGroupInput").outputs[0]

    def node(self, kind: str, *values, **settings) -> bpy.types.Node:
        """A node with `settings`.

        values: of its inputs, sockets to link or numbers; None leaves one as it is.
        """
        new_node = self.group.nodes.new(kind)
        for name, value in settings.items():
            setattr(new_node, name, value)
        for socket, value in zip(new_node.inputs, values, strict=False):
            if isinstance(value, bpy.types.NodeSocket):
                self.group.links.new(value, socket)
            elif value is not None:
                socket.default_value = value
        return new_node

    def math(self, operation: str, *values) -> bpy.types.NodeSocket:
        return self.node("ShaderNodeMath", *values, operation=operation).outputs[0]

    def store(self, name: str, kind: str, value: bpy.types.NodeSocket) -> None:
        """Give the geometry a point attribute."""
        store = self.node(
            "GeometryNodeStoreNamedAttribute", self.geometry, data_type=kind, domain="POINT"
        )
        store.inputs["Name"].default_value = name
        self.group.links.new(value, store.inputs["Value"])
        self.geometry = store.outputs[0]

    def finish(self) -> None:
        self.group.links.new(self.geometry, self.group.nodes.new("NodeGroupOutput").inputs[0])


class Cull:
    """The part of a tree that deletes the points outside six planes.

    It stores the others' LOD.
    """

    def __init__(self, tree: Tree, thresholds: np.ndarray):
        place = tree.node("GeometryNodeInputPosition").outputs[0]
        self.planes = []
        outside = None
        depth = None
        for _ in range(7):  # six planes and the depth
            dot = tree.node("ShaderNodeVectorMath", place, operation="DOT_PRODUCT")
            self.planes.append([dot.inputs[1], None])
            depth = dot.outputs["Value"]
            if len(self.planes) < 7:
                beyond = tree.node("ShaderNodeMath", depth, operation="GREATER_THAN")
                self.planes[-1][1] = beyond.inputs[1]
                outside = (
                    beyond.outputs[0]
                    if outside is None
                    else tree.math("MAXIMUM", outside, beyond.outputs[0])
                )
        depth_from = tree.node("ShaderNodeMath", depth, operation="SUBTRACT")
        self.planes[6][1] = depth_from.inputs[1]
        level = tree.math("ADD", 0.0, 0.0)
        for threshold in thresholds:
            level = tree.math(
                "ADD",
                level,
                tree.math("GREATER_THAN", depth_from.outputs[0], float(threshold) * (1 - 1e-7)),
            )
        tree.geometry = tree.node("GeometryNodeDeleteGeometry", tree.geometry, outside).outputs[0]
        tree.store("lod", "INT", level)

    def aim(self, camera: Camera, radius: float) -> None:
        frustum = frustum_of(camera)
        offsets = np.append(
            frustum.offsets + frustum.normals @ camera.origin + radius, camera.Z @ camera.origin
        )
        for (normal, offset), n, o in zip(
            self.planes, [*frustum.normals, camera.Z], offsets, strict=True
        ):
            normal.default_value = n
            offset.default_value = o


class Nodes:
    """Geometry nodes that cull and give LODs, in a scene of their own.

    They make no buckets: one more tree for each LOD would have to part the points.
    """

    def __init__(self, crowd: Crowd, group: Group, thresholds: np.ndarray):
        self.radius = group.radius
        self.scene = bpy.data.scenes.new("cull")
        self.object = points_of("agents", crowd, group.center)
        self.scene.collection.objects.link(self.object)
        self.tree = Tree("cull")
        self.prepare(self.tree)
        self.cull = Cull(self.tree, thresholds)
        self.tree.finish()
        self.object.modifiers.new("cull", "NODES").node_group = self.tree.group
        self.layer = self.scene.view_layers[0]

    def prepare(self, tree: Tree) -> None:
        """What the tree does before it culls."""

    def aim(self, camera: Camera) -> None:
        """Set the planes; what follows, `update`, is the time that counts."""
        self.cull.aim(camera, self.radius)

    def update(self) -> None:
        self.layer.update()

    def counts(self, levels: int) -> np.ndarray:
        mesh = self.object.evaluated_get(self.layer.depsgraph).data
        if not len(mesh.vertices):
            return np.zeros(levels, np.intp)
        lod = np.empty(len(mesh.vertices), np.int32)
        mesh.attributes["lod"].data.foreach_get("value", lod)
        return np.bincount(lod, minlength=levels)

    def close(self) -> None:
        """Leave the file as it was."""
        mesh = self.object.data
        bpy.data.scenes.remove(self.scene)
        bpy.data.batch_remove([self.object, mesh, self.tree.group])
