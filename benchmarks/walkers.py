"""The whole frame, by Crowd LOD and by geometry nodes that do the same.

Agents walk, are culled, given LODs, and become points that Blender can instance.
"""

import bpy
import numpy as np
from crowd_lod_extension.crowd_lod.animation.phase_classes import Cast
from crowd_lod_extension.crowd_lod.crowd import random_streams
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.culling.camera import Camera
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.sources.trajectory import Trajectory
from crowd_lod_extension.operators.blender import mesh_data
from crowd_lod_extension.operators.build import frame_update
from peers import Nodes, Tree

POSES = 8  # of each LOD's action, as the build makes them


class Points:
    """Crowd LOD as the build does it: a point object a LOD, written every frame."""

    def __init__(self, trajectory: Trajectory, policy: LevelPolicy):
        self.trajectory = trajectory
        self.policy = policy
        self.scene = bpy.data.scenes.new("points")
        self.objects = [
            bpy.data.objects.new(f"LOD {k}", bpy.data.meshes.new(f"LOD {k}"))
            for k in range(policy.count)
        ]
        for each in self.objects:
            self.scene.collection.objects.link(each)

    def __call__(self, camera: Camera, frame: int) -> None:
        """The frame, from behavior to points that the dependency graph holds."""
        frame_plan = plan(self.trajectory, camera, self.policy, frame)
        agents = frame_update.OpenShutter(frame_plan.crowd, frame)
        buckets = [frame_plan.buckets[level] for level in range(len(self.objects))]
        cast = Cast(np.full(len(self.trajectory.groups), POSES))
        bucket_columns = frame_update.columns_by_bucket(
            self.trajectory, frame_plan.crowd, agents, buckets, cast
        )
        for each, columns in zip(self.objects, bucket_columns, strict=True):
            mesh_data.write_points(each.data, columns)
        self.scene.view_layers[0].update()

    def counts(self) -> np.ndarray:
        return np.array([len(each.data.vertices) for each in self.objects])

    def close(self) -> None:
        """Leave the file as it was."""
        meshes = [each.data for each in self.objects]
        bpy.data.scenes.remove(self.scene)
        bpy.data.batch_remove([*self.objects, *meshes])


class Walkers(Nodes):
    """Geometry nodes that do the same, for the chapter's table and map.

    A simulation zone reads the label under each point from an image, changes its state, moves and
    turns it, and plays its action; then it is culled and given a LOD. One object: parting the LODs
    is left to what instances them. They step when the scene's frame goes on by one.
    """

    def __init__(self, trajectory: Trajectory, group: Group, thresholds: np.ndarray):
        self.trajectory = trajectory
        self.person = group
        labels = trajectory.world.labels
        self.image = bpy.data.images.new(
            "labels", labels.shape[1], labels.shape[0], float_buffer=True, is_data=True
        )
        self.image.pixels.foreach_set(np.repeat(labels.astype(np.float32).ravel(), 4))
        super().__init__(trajectory.start, group, thresholds)
        crowd = trajectory.start
        mesh = self.object.data
        columns = {
            "state": crowd.state.astype(np.int32),
            "phase": trajectory.phase(crowd, trajectory.first_frame),
            "group": crowd.group.astype(np.int32),
        }
        columns |= {
            "id": np.arange(len(crowd), dtype=np.int32),
            "looks": random_streams.uniform(crowd.key, random_streams.LOOKS).astype(np.float32),
        }
        for name, values in columns.items():
            kind = "INT" if values.dtype == np.int32 else "FLOAT"
            mesh.attributes.new(name, kind, "POINT").data.foreach_set("value", values)
        # simulations run in the window's scene alone
        self.before = bpy.context.window.scene
        bpy.context.window.scene = self.scene
        bpy.context.evaluated_depsgraph_get()
        self.frame(1)

    def prepare(self, tree: Tree) -> None:
        entry, leave = (
            tree.group.nodes.new(f"GeometryNodeSimulation{end}") for end in ("Input", "Output")
        )
        entry.pair_with_output(leave)
        tree.group.links.new(tree.geometry, entry.inputs["Geometry"])
        tree.geometry = entry.outputs["Geometry"]
        fields = self._next_fields(tree, entry.outputs["Delta Time"])
        # all are read from the points as they were: what is written changes no field before the
        # zone's end
        captured = tree.node("GeometryNodeCaptureAttribute", tree.geometry, domain="POINT")
        tree.geometry = captured.outputs[0]
        for name, (kind, value) in fields.items():
            captured.capture_items.new(kind, name)
            tree.group.links.new(value, captured.inputs[name])
        moves = captured.outputs["moves"]
        way = tree.node("ShaderNodeCombineXYZ", moves).outputs[0]
        moved = tree.node("GeometryNodeSetPosition", tree.geometry, None, None, way)
        tree.geometry = moved.outputs[0]
        for name, (kind, _) in fields.items():
            if name != "moves":
                tree.store(name, kind, captured.outputs[name])
        tree.group.links.new(tree.geometry, leave.inputs["Geometry"])
        tree.geometry = leave.outputs["Geometry"]

    def _next_fields(
        self, tree: Tree, seconds: bpy.types.NodeSocket
    ) -> dict[str, tuple[str, bpy.types.NodeSocket]]:
        """Each attribute after `seconds`, and how far a point "moves" in x, as (type, socket)."""
        machine = self.trajectory.machine
        speed = float(machine.velocity[0, 0, 0])
        label = self._label_below(tree)
        on_left, on_right = (
            tree.math("COMPARE", label, machine.labels.index(name), 0.5)
            for name in ("left edge", "right edge")
        )
        state = _attribute(tree, "state", "INT")  # 0 walks right, 1 left
        stays = tree.math("MULTIPLY", state, tree.math("SUBTRACT", 1.0, on_left))
        state = tree.math("MAXIMUM", stays, on_right)
        walked = tree.math("MULTIPLY", seconds, speed)
        moves = tree.math("MULTIPLY", walked, tree.math("MULTIPLY_ADD", state, -2.0, 1.0))
        cycles = tree.math("MULTIPLY", walked, 1 / self.person.stride)
        phase = tree.math("FRACT", tree.math("ADD", _attribute(tree, "phase", "FLOAT"), cycles))
        return {
            "state": ("INT", state),
            "phase": ("FLOAT", phase),
            "heading": ("FLOAT", tree.math("MULTIPLY", state, np.pi)),
            "pose": ("INT", tree.math("FLOOR", tree.math("MULTIPLY", phase, POSES))),
            "moves": ("FLOAT", moves),
        }

    def _label_below(self, tree: Tree) -> bpy.types.NodeSocket:
        """The map's label under each point."""
        area = self.trajectory.area
        width, depth = area.size
        position = tree.node("GeometryNodeInputPosition").outputs[0]
        place = tree.node("ShaderNodeSeparateXYZ", position).outputs
        u = tree.math("MULTIPLY", tree.math("SUBTRACT", place[0], area.x_min), 1 / width)
        v = tree.math("MULTIPLY", tree.math("SUBTRACT", place[1], area.y_min), 1 / depth)
        at = tree.node("ShaderNodeCombineXYZ", u, v).outputs[0]
        texture = tree.node(
            "GeometryNodeImageTexture", self.image, at, interpolation="Closest", extension="EXTEND"
        )
        return texture.outputs["Color"]

    def frame(self, number: int) -> None:
        self.scene.frame_set(number)

    def close(self) -> None:
        bpy.context.window.scene = self.before
        super().close()
        bpy.data.images.remove(self.image)


def _attribute(tree: Tree, name: str, kind: str) -> bpy.types.NodeSocket:
    node = tree.node("GeometryNodeInputNamedAttribute", name, data_type=kind)
    return next(socket for socket in node.outputs if socket.enabled and socket.name == "Attribute")
