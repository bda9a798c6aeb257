"""Objects whose points or instances move: made of geometry nodes."""

import bpy
import numpy as np
from mathutils import Matrix

from .nodes import geometry_nodes
from .objects import mesh_of, placed


def scatter(count=60, instances=False, attributes=(), where=(0.0, 0.0, 0.0)) -> bpy.types.Object:
    """Return an object with `count` points in a row along x, which move by (0, 1, 0) meters a
    second.

    instances: cones on the points, turned by their index in radians, instead of the points.
    attributes: (name, data type, values) that the points get.
    where: the location of the object, which is turned by a right angle and twice as large.
    """
    mesh = mesh_of("Scatter", [(0.5 * k - count / 4, 0, 0) for k in range(count)])
    for name, kind, values in attributes:
        own = mesh.attributes.new(name, kind, "POINT").data
        if kind == "STRING":
            for each, value in zip(own, values, strict=True):
                each.value = value.encode()
        else:
            own.foreach_set("vector" if kind == "FLOAT_VECTOR" else "value", np.ravel(values))
    item = placed("Scatter", mesh)
    item.matrix_world = (
        Matrix.Translation(where) @ Matrix.Rotation(np.pi / 2, 4, "Z") @ Matrix.Scale(2, 4)
    )
    kinds = "MeshToPoints", "SetPosition", "InputSceneTime"
    tree, inside, points, move, clock, along, outside = geometry_nodes(
        item, *(f"GeometryNode{kind}" for kind in kinds), "ShaderNodeCombineXYZ"
    )
    link = tree.links.new
    link(inside.outputs[0], points.inputs[0])
    link(points.outputs[0], move.inputs[0])
    link(clock.outputs["Seconds"], along.inputs["Y"])
    link(along.outputs[0], move.inputs["Offset"])
    made = move.outputs[0]
    if instances:
        place, cone, turn, index = (
            tree.nodes.new(kind)
            for kind in (
                "GeometryNodeInstanceOnPoints",
                "GeometryNodeMeshCone",
                "ShaderNodeCombineXYZ",
                "GeometryNodeInputIndex",
            )
        )
        link(made, place.inputs["Points"])
        link(cone.outputs[0], place.inputs["Instance"])
        link(index.outputs[0], turn.inputs["Z"])
        link(turn.outputs[0], place.inputs["Rotation"])
        made = place.outputs[0]
    link(made, outside.inputs[0])
    return item
