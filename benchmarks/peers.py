"""Other ways to cull, give LODs and sort, each on the same crowd: what the core is measured beside."""

from functools import cache

import bpy
import numpy as np
from crowd_lod_extension.crowd_lod.agents import Crowd, Group
from crowd_lod_extension.crowd_lod.camera import Camera, planes


def naive(crowd: Crowd, group: Group, camera: Camera, limits: np.ndarray) -> list[np.ndarray]:
    """The chapter's listings line by line in NumPy: camera coordinates of all, the radar test with the derived widening,
    a sum of unit steps, and one pass a LOD."""
    v = np.stack([crowd.x, crowd.y, crowd.z + group.centre], axis=1) - camera.origin
    along = v @ camera.Z
    visible = (along >= camera.near - group.radius) & (along <= camera.far + group.radius)
    for axis, low, high in ((camera.X, camera.window.left, camera.window.right), (camera.Y, camera.window.bottom, camera.window.top)):
        across = v @ axis
        visible &= across <= high * along + group.radius * np.hypot(1, high)
        visible &= across >= low * along - group.radius * np.hypot(1, low)
    level = sum((along >= limit).astype(np.int64) for limit in limits) if len(limits) else np.zeros(len(v), np.int64)
    return [np.flatnonzero(visible & (level == k)) for k in range(len(limits) + 1)]


def six_planes(crowd: Crowd, group: Group, camera: Camera, limits: np.ndarray) -> list[np.ndarray]:
    """Six planes as one matrix product over all agents, then a stable sort."""
    frustum = planes(camera)
    rows = np.vstack([frustum.normals, camera.Z])
    spheres = np.array([crowd.x, crowd.y, crowd.z + group.centre])
    signed = rows @ spheres - (rows @ camera.origin)[:, None]
    seen = np.flatnonzero((signed[:6] <= (frustum.offsets + group.radius)[:, None]).all(axis=0))
    level = np.searchsorted(limits, signed[6, seen], side="right").astype(np.uint8)
    seen = seen[np.argsort(level, kind="stable")]
    return np.split(seen, np.cumsum(np.bincount(level, minlength=len(limits) + 1))[:-1])


@cache
def has_gpu() -> bool:
    """Whether compute shaders run here: before Blender 5.1 they need its window."""
    import gpu

    try:
        gpu.init()
    except (AttributeError, SystemError):
        return False
    return gpu.capabilities.compute_shader_support_get()


class Nodes:
    """A geometry-node tree that deletes the points outside six planes and stores the others' LOD, in a scene of its own.
    No buckets: a tree of its own a LOD would still have to part them."""

    def __init__(self, crowd: Crowd, group: Group, limits: np.ndarray):
        self.group = group
        self.scene = bpy.data.scenes.new("cull")
        mesh = bpy.data.meshes.new("agents")
        mesh.vertices.add(len(crowd))
        places = np.stack([crowd.x, crowd.y, crowd.z + group.centre], axis=1).astype(np.float32)
        mesh.vertices.foreach_set("co", places.ravel())
        self.object = bpy.data.objects.new("agents", mesh)
        self.scene.collection.objects.link(self.object)
        self.planes, self.tree = [], bpy.data.node_groups.new("cull", "GeometryNodeTree")
        self._wire(self.tree, limits)
        self.object.modifiers.new("cull", "NODES").node_group = self.tree
        self.layer = self.scene.view_layers[0]

    def _wire(self, tree, limits: np.ndarray) -> None:
        for in_out in ("INPUT", "OUTPUT"):
            tree.interface.new_socket("Geometry", in_out=in_out, socket_type="NodeSocketGeometry")

        def node(kind: str, *values, **settings):
            made = tree.nodes.new(kind)
            for name, value in settings.items():
                setattr(made, name, value)
            for socket, value in zip(made.inputs, values, strict=False):
                if isinstance(value, bpy.types.NodeSocket):
                    tree.links.new(value, socket)
                else:
                    socket.default_value = value
            return made

        place = node("GeometryNodeInputPosition").outputs[0]
        outside = depth = None
        for _ in range(7):  # six planes and the depth
            dot = node("ShaderNodeVectorMath", place, operation="DOT_PRODUCT")
            self.planes.append([dot.inputs[1], None])
            depth = dot.outputs["Value"]
            if len(self.planes) < 7:
                beyond = node("ShaderNodeMath", depth, operation="GREATER_THAN")
                self.planes[-1][1] = beyond.inputs[1]
                outside = beyond.outputs[0] if outside is None else node("ShaderNodeMath", outside, beyond.outputs[0], operation="MAXIMUM").outputs[0]
        depth_from = node("ShaderNodeMath", depth, operation="SUBTRACT")
        self.planes[6][1] = depth_from.inputs[1]
        level = None
        for limit in limits:
            step = node("ShaderNodeMath", depth_from.outputs[0], float(limit) * (1 - 1e-7), operation="GREATER_THAN").outputs[0]
            level = step if level is None else node("ShaderNodeMath", level, step, operation="ADD").outputs[0]
        delete = tree.nodes.new("GeometryNodeDeleteGeometry")
        store = tree.nodes.new("GeometryNodeStoreNamedAttribute")
        store.data_type, store.domain = "INT", "POINT"
        store.inputs["Name"].default_value = "lod"
        tree.links.new(tree.nodes.new("NodeGroupInput").outputs[0], delete.inputs["Geometry"])
        tree.links.new(outside, delete.inputs["Selection"])
        tree.links.new(delete.outputs[0], store.inputs["Geometry"])
        if level is not None:
            tree.links.new(level, store.inputs["Value"])
        tree.links.new(store.outputs[0], tree.nodes.new("NodeGroupOutput").inputs[0])

    def aim(self, camera: Camera) -> None:
        """Set the planes; what follows, `update`, is the time that counts."""
        frustum = planes(camera)
        offsets = np.append(frustum.offsets + frustum.normals @ camera.origin + self.group.radius, camera.Z @ camera.origin)
        for (normal, offset), n, o in zip(self.planes, [*frustum.normals, camera.Z], offsets, strict=True):
            normal.default_value, offset.default_value = n, o

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
        bpy.data.batch_remove([self.object, mesh, self.tree])
