"""What moves objects by the scene's time without an action: caches, nodes, drivers, simulations."""

import re
from collections.abc import Iterator, Sequence

import bpy

from .animation import armatures_of

CACHES = {"MESH_CACHE", "MESH_SEQUENCE_CACHE"}
BY_TIME = {*CACHES, "CLOTH", "SOFT_BODY", "WAVE"}  # modifiers
FRAME = re.compile(r"\bframe\b")  # in the expression of a driver
OF_SCENE = "frame_"  # begins the properties of a scene that are its time


def time_movers(objects: Sequence[bpy.types.Object]) -> list[str]:
    """Return what moves a character's `objects`, their rigs and parents by the scene's time.

    Each in words, such as "the node Scene Time in Sway, on Flag"; none without any.
    """
    items = dict.fromkeys([*objects, *armatures_of(list(objects))])
    for item in items.copy():
        while (item := item.parent) is not None:
            items[item] = None
    return list(dict.fromkeys(mover for item in items for mover in _movers_of(item)))


def _movers_of(item: bpy.types.Object) -> Iterator[str]:
    for constraint in item.constraints:
        if constraint.type == "TRANSFORM_CACHE" and not constraint.mute:
            yield _cache(constraint, item)
    for modifier in item.modifiers:
        if not modifier.show_render:
            continue
        if modifier.type in CACHES:
            yield _cache(modifier, item)
        elif modifier.type in BY_TIME:
            yield f"the modifier {modifier.name} on {item.name}"
        elif modifier.type == "NODES" and modifier.node_group is not None:
            for tree in _trees_in(modifier.node_group):
                if any(node.bl_idname == "GeometryNodeInputSceneTime" for node in tree.nodes):
                    yield f"the node Scene Time in {tree.name}, on {item.name}"
                yield from _drivers_of(tree)
    for block in (item, item.data, getattr(item.data, "shape_keys", None)):
        if block is not None:
            yield from _drivers_of(block)


def _cache(owner: bpy.types.Modifier | bpy.types.Constraint, item: bpy.types.Object) -> str:
    file = getattr(owner, "cache_file", None)
    return f"the cache {file.name if file else owner.name} on {item.name}"


def _trees_in(tree: bpy.types.NodeTree) -> list[bpy.types.NodeTree]:
    """Return the tree and all that are groups in it."""
    trees = [tree]
    for each in trees:  # which grows
        inner = (getattr(node, "node_tree", None) for node in each.nodes)
        trees += [group for group in inner if group is not None and group not in trees]
    return trees


def _drivers_of(block: bpy.types.ID) -> Iterator[str]:
    data = getattr(block, "animation_data", None)
    drivers = [curve.driver for curve in data.drivers] if data is not None else []
    if any(map(_reads_frame, drivers)):
        yield f"a driver on the frame, of {block.name}"


def _reads_frame(driver: bpy.types.Driver) -> bool:
    if driver.type == "SCRIPTED" and FRAME.search(driver.expression):
        return True
    targets = (target for variable in driver.variables for target in variable.targets)
    return any(target.data_path.startswith(OF_SCENE) for target in targets)
