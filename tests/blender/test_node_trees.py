"""Our node groups as text: a change of a tree shows as a change of its file.

pytest --write-trees tests/blender/test_node_trees.py writes the files of node_trees anew. What the
trees do is tested on evaluated instances, in test_build.py and test_bake.py.
"""

from pathlib import Path

import bpy
import pytest
from crowd_lod_extension.operators.build.nodes import trees
from crowd_lod_extension.operators.build.nodes.baked import baked
from crowd_lod_extension.operators.build.nodes.instances import instances

TEXTS = Path(__file__).parent / "node_trees"


def tree_text(tree) -> str:
    """The interface, and of each node its settings and inputs that differ from a new node's."""
    scratch = bpy.data.node_groups.new("scratch", "GeometryNodeTree")
    lines = [f"{tree[trees.KIND]}, version {tree[trees.TREE_VERSION]}", ""]
    for socket in tree.interface.items_tree:
        lines.append(f"{socket.in_out.lower()} {socket.name}: {socket.socket_type}")
    for node in tree.nodes:
        lines += ["", f"{node.name}: {node.bl_idname}"]
        lines += node_lines(node, scratch.nodes.new(node.bl_idname))
    return "\n".join(lines) + "\n"


def node_lines(node, plain):
    """Lines of what is set at the node, unlike at a `plain` one, and of what its inputs take."""
    common = set(bpy.types.Node.bl_rna.properties.keys())
    for setting in sorted(set(node.bl_rna.properties.keys()) - common):
        value = getattr(node, setting)
        if isinstance(value, str | bool) and value != getattr(plain, setting):
            yield f"  {setting} = {value}"
    if node.bl_idname == "GeometryNodeGroup":
        yield f"  node_tree = {node.node_tree[trees.KIND]}"
    for number, socket in enumerate(node.inputs):
        for link in socket.links:
            yield f"  {socket.name} [{number}] <- {link.from_node.name}: {link.from_socket.name}"
        value = getattr(socket, "default_value", None)
        if isinstance(value, str | bool | int | float) and not socket.links:
            if node.bl_idname == "GeometryNodeGroup" or value != plain.inputs[number].default_value:
                yield f"  {socket.name} [{number}] = {value}"


@pytest.mark.parametrize("make", [instances, baked], ids=lambda make: make.__name__)
def test_a_tree_is_as_its_file_says(make, request):
    path = TEXTS / f"{make.__name__}.txt"
    text = tree_text(make())
    if request.config.getoption("--write-trees"):
        path.write_text(text, encoding="utf-8")
    assert text == path.read_text(encoding="utf-8")
