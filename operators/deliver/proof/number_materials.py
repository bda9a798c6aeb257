"""Materials that show who is seen: flat colors of agents' ids, cut out where a material is."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import bpy
import numpy as np

from ....crowd_lod.validation.id_pictures import NOBODY
from ...blender import removal
from ...blender.materials import source_of, switch_nodes_on, used_nodes
from ...blender.provenance import unedited

# instances of a crowd have it, and hardly any others
OF_AGENTS = "looks"
MARK = 1234.0  # the green of agents; lamps that are in sight hardly have it
OPAQUE = 0.5  # of 1: what a material hides of what is behind it, from where on it is no hole
SURFACES = {"MESH", "CURVE", "SURFACE", "FONT", "META", "CURVES", "POINTCLOUD"}

Value = bpy.types.NodeSocket | float


@contextmanager
def numbered(scene: bpy.types.Scene) -> Iterator[None]:
    """Let all materials emit numbers in Cycles, and restore them afterwards.

    See read_numbers. Where a material lets more than half of what is behind it through, it lets
    through all of it. Displacement stays.
    """
    with ExitStack() as opened:
        opened.enter_context(unedited())
        opened.callback(scene.view_layers[0].update)  # which names what was edited
        opened.enter_context(_everything_has_a_material())
        for material in bpy.data.materials:
            if not material.is_grease_pencil:
                opened.enter_context(_numbered(material))
        yield


def read_numbers(pixels: np.ndarray) -> np.ndarray:
    """Return the agents that a picture (rows, columns, 4) float32 of numbers shows.

    (rows, columns) int32, NOBODY where there is none. Cycles rounds attributes: above 4 million,
    ids may be those of agents beside.
    """
    red, green = pixels[..., 0], pixels[..., 1]
    return np.where(np.abs(green - MARK) < 0.5, np.rint(red), NOBODY).astype(np.int32)


@contextmanager
def _everything_has_a_material() -> Iterator[None]:
    """Put a material where objects have none."""
    plain = bpy.data.materials.new("Crowd LOD number")
    switch_nodes_on(plain)
    bare = {item.data for item in bpy.data.objects if item.type in SURFACES}
    grown = [data for data in bare if not len(data.materials)]
    for data in grown:
        data.materials.append(plain)
    slots = [slot for item in bpy.data.objects for slot in item.material_slots]
    empty = [slot for slot in slots if slot.material is None]
    for slot in empty:
        slot.material = plain
    try:
        yield
    finally:
        for slot in empty:
            slot.material = None
        for data in filter(removal.is_there, grown):
            data.materials.clear()
        removal.remove([plain])


@contextmanager
def _numbered(material: bpy.types.Material) -> Iterator[None]:
    """Let one material emit numbers, and restore it."""
    was_on = used_nodes(material) is not None
    sampled = material.cycles.emission_sampling
    # else each triangle of each agent is a lamp: 20 s and 4 GB for 10,000 agents
    material.cycles.emission_sampling = "NONE"
    edit = _Edit(switch_nodes_on(material))
    output = edit.tree.get_output_node("CYCLES") or edit.add("ShaderNodeOutputMaterial")
    inputs = [output.inputs[name] for name in ("Surface", "Volume")]
    before = [(socket, socket.links[0].from_socket) for socket in inputs if socket.is_linked]
    numbers = edit.numbers()
    opacity = edit.opacity(output.inputs["Surface"])
    for socket, _ in before:
        edit.tree.links.remove(socket.links[0])
    edit.link(edit.cut_out(numbers, opacity), output.inputs["Surface"])
    try:
        yield
    finally:
        if removal.is_there(material):
            material.cycles.emission_sampling = sampled
            edit.undo()
            for socket, source in before:
                edit.tree.links.new(source, socket)
            if not was_on:
                material.use_nodes = False


class _Edit:
    """Nodes that are added to a tree for a while.

    groups: nodes whose group is another one meanwhile, and their own.
    """

    def __init__(self, tree: bpy.types.NodeTree):
        self.tree = tree
        self.nodes: list[bpy.types.Node] = []
        self.groups: list[tuple[bpy.types.Node, bpy.types.NodeTree]] = []

    def undo(self) -> None:
        """Take out what was added, and give groups back."""
        for node in self.nodes:
            self.tree.nodes.remove(node)
        for node, group in self.groups:
            copy = node.node_tree
            node.node_tree = group
            removal.remove([copy])

    def add(self, kind: str) -> bpy.types.Node:
        """Add a node."""
        node = self.tree.nodes.new(kind)
        self.nodes.append(node)
        return node

    def link(self, value: Value, socket: bpy.types.NodeSocket) -> None:
        """Have the socket take a value, or what another one gives."""
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        else:
            socket.default_value = value

    def math(self, operation: str, *values: Value) -> bpy.types.NodeSocket:
        """Return what a sum gives."""
        node = self.add("ShaderNodeMath")
        node.operation = operation
        for value, socket in zip(values, node.inputs, strict=False):
            self.link(value, socket)
        return node.outputs[0]

    def numbers(self) -> bpy.types.NodeSocket:
        """Return a shader that emits the numbers."""
        ids, looks = (self.add("ShaderNodeAttribute") for _ in range(2))
        for node, name in ((ids, "id"), (looks, OF_AGENTS)):
            node.attribute_type = "INSTANCER"
            node.attribute_name = name
        # 1 where there is such a value
        mark = self.math("MULTIPLY", looks.outputs["Alpha"], MARK)
        color = self.add("ShaderNodeCombineColor")
        self.link(ids.outputs["Fac"], color.inputs["Red"])
        self.link(mark, color.inputs["Green"])
        emission = self.add("ShaderNodeEmission")
        self.link(color.outputs[0], emission.inputs["Color"])
        return emission.outputs[0]

    def cut_out(self, shader: bpy.types.NodeSocket, opacity: Value) -> bpy.types.NodeSocket:
        """Return the shader with holes where the opacity is less than OPAQUE."""
        mix = self.add("ShaderNodeMixShader")
        hole = self.add("ShaderNodeBsdfTransparent")
        self.link(self.math("GREATER_THAN", opacity, OPAQUE), mix.inputs[0])
        self.link(hole.outputs[0], mix.inputs[1])
        self.link(shader, mix.inputs[2])
        return mix.outputs[0]

    def opacity(self, socket: bpy.types.NodeSocket) -> Value:
        """Return what the shader that the socket takes hides of what is behind it."""
        node, output = source_of(socket)
        if node is None:
            return 1.0
        if node.mute:
            through = [link for link in node.internal_links if link.to_socket == output]
            return self.opacity(through[0].from_socket) if through else 1.0
        inputs = node.inputs
        if node.type == "MIX_SHADER":
            return self._mixed(_given(inputs[0]), *map(self.opacity, inputs[1:3]))
        if node.type == "ADD_SHADER":
            return self.math("MAXIMUM", *map(self.opacity, inputs[:2]))
        if node.type == "BSDF_PRINCIPLED":
            return _given(inputs["Alpha"])
        if node.type == "BSDF_TRANSPARENT":
            return self.math("SUBTRACT", 1.0, self._gray(inputs["Color"]))
        if node.type == "GROUP" and node.node_tree is not None:
            return self._of_group(node, output)
        return 1.0

    def _mixed(self, part: Value, first: Value, second: Value) -> Value:
        """Return `first`, or that part of the way to `second`."""
        if isinstance(first, float) and first == second:
            return first
        mix = self.add("ShaderNodeMix")
        for value, socket in zip((part, first, second), (0, 2, 3), strict=True):
            self.link(value, mix.inputs[socket])
        return mix.outputs[0]

    def _gray(self, color: bpy.types.NodeSocket) -> Value:
        """Return how bright a color is."""
        if not color.is_linked:
            return sum(color.default_value[:3]) / 3
        gray = self.add("ShaderNodeRGBToBW")
        self.link(color.links[0].from_socket, gray.inputs[0])
        return gray.outputs[0]

    def _of_group(self, node: bpy.types.Node, output: bpy.types.NodeSocket) -> Value:
        """Return what a group's shader hides, from a copy of the group that tells it, too."""
        copy = node.node_tree.copy()
        inside = _Edit(copy)
        ends = [
            each for each in copy.nodes if each.type == "GROUP_OUTPUT" and each.is_active_output
        ]
        place = list(node.outputs).index(output)
        opacity = inside.opacity(ends[0].inputs[place]) if ends else 1.0
        if isinstance(opacity, float):
            removal.remove([copy, *(group.node_tree for group, _ in inside.groups)])
            return opacity
        copy.interface.new_socket("Opacity", in_out="OUTPUT", socket_type="NodeSocketFloat")
        inside.link(opacity, ends[0].inputs[len(node.outputs)])
        self.groups += [*inside.groups, (node, node.node_tree)]
        node.node_tree = copy
        return node.outputs[len(node.outputs) - 1]


def _given(socket: bpy.types.NodeSocket) -> Value:
    """Return the number that a socket takes, or the one that gives it."""
    return socket.links[0].from_socket if socket.is_linked else float(socket.default_value)
