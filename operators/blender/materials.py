"""Materials, lamps and worlds by their shader nodes: what their outputs reach decides.

A node that leads to no output does not count. So ask all: whether a surface lets light through,
whether it gives light to others, which images it shows, which shader gives its color.

Up to Blender 4.5 (for lamps up to 5.1) nodes are switched on by `use_nodes`. Since then they are
always on, and `use_nodes` warns of its end.
"""

from collections.abc import Callable, Iterable, Iterator

import bpy

Shaded = bpy.types.Material | bpy.types.Light | bpy.types.World
Sockets = Iterable[bpy.types.NodeSocket]

# shaders that let no ray through; the inputs of others decide, or they do let some through
OPAQUE = {
    "BACKGROUND",
    "BSDF_DIFFUSE",
    "BSDF_GLOSSY",
    "BSDF_METALLIC",
    "BSDF_SHEEN",
    "BSDF_TOON",
    "BSDF_TRANSLUCENT",
    "EEVEE_SPECULAR",
    "EMISSION",
    "SUBSURFACE_SCATTERING",
}
MIXES = {"MIX_SHADER", "ADD_SHADER", "REROUTE"}


def used_nodes(shaded: Shaded) -> bpy.types.NodeTree | None:
    """Return the nodes that `shaded` is rendered with."""
    return shaded.node_tree if _is_always_on(shaded) or shaded.use_nodes else None


def switch_nodes_on(shaded: Shaded) -> bpy.types.NodeTree:
    """Have `shaded` rendered with its nodes, and return them."""
    if not _is_always_on(shaded):
        shaded.use_nodes = True
    return shaded.node_tree


def _is_always_on(shaded: Shaded) -> bool:
    switch = shaded.bl_rna.properties.get("use_nodes")
    return switch is None or getattr(switch, "is_deprecated", False)


def sockets_of(tree: bpy.types.NodeTree | None, *kinds: str) -> list[bpy.types.NodeSocket]:
    """Return the inputs of the tree's nodes of these kinds, such as outputs."""
    return [
        socket
        for node in (tree.nodes if tree is not None else ())
        if node.type in kinds
        for socket in node.inputs
    ]


def inputs_before(link: bpy.types.NodeLink) -> list[bpy.types.NodeSocket]:
    """Return the inputs of the node that `link` comes from, and of a group's outputs."""
    node = link.from_node
    inside = node.node_tree if node.type == "GROUP" and not node.mute else None
    return [*node.inputs, *sockets_of(inside, "OUTPUT_MATERIAL", "GROUP_OUTPUT")]


def reached(
    sockets: Sockets, onward: Callable[[bpy.types.NodeLink], Sockets] = inputs_before
) -> Iterator[bpy.types.NodeSocket]:
    """Yield `sockets`, and the inputs of the nodes that lead to them, for each output once.

    onward: returns the inputs that count of the node that a link comes from.
    """
    waiting = list(sockets)
    visited: set[bpy.types.NodeSocket] = set()
    while waiting:
        socket = waiting.pop(0)
        yield socket
        for link in socket.links:
            if link.from_socket not in visited:
                visited.add(link.from_socket)
                waiting += onward(link)


def reached_nodes(sockets: Sockets) -> Iterator[bpy.types.Node]:
    """Yield the nodes that lead to `sockets`, the nearest first."""
    return (link.from_node for socket in reached(sockets) for link in socket.links)


def source_of(
    socket: bpy.types.NodeSocket,
) -> tuple[bpy.types.Node | None, bpy.types.NodeSocket | None]:
    """Return the (node, output) that feed the socket, or (None, None)."""
    while socket.is_linked:
        link = socket.links[0]
        if link.from_node.type != "REROUTE":
            return link.from_node, link.from_socket
        socket = link.from_node.inputs[0]
    return None, None


def shader_of(material: bpy.types.Material) -> bpy.types.Node | None:
    """Return the node that gives the material's surface, or None."""
    output = material.node_tree and material.node_tree.get_output_node("ALL")
    return source_of(output.inputs["Surface"])[0] if output else None


def images_in(material: bpy.types.Material) -> set[bpy.types.Image]:
    """Return the images that the material shows."""
    ends = sockets_of(material.node_tree, "OUTPUT_MATERIAL", "OUTPUT_AOV")
    nodes = (node for node in reached_nodes(ends) if node.type == "TEX_IMAGE")
    return {node.image for node in nodes} - {None}


def images_of(items: Iterable[bpy.types.Object]) -> set[bpy.types.Image]:
    """Return the images in the materials of the objects `items`."""
    materials = {slot.material for item in items for slot in item.material_slots} - {None}
    return set().union(*map(images_in, materials))


def is_opaque(material: bpy.types.Material | None) -> bool:
    """Return whether no ray of a camera gets through the material, where its surface is seen."""
    if material is None:
        return True
    tree = used_nodes(material)
    if tree is None:
        return material.diffuse_color[3] == 1
    surfaces = [node.inputs["Surface"] for node in _outputs(tree)]
    return bool(surfaces) and all(map(_blocks, reached(surfaces, _mixed)))


def hides_in_all_engines(material: bpy.types.Material | None) -> bool:
    """Return whether a surface of the material hides what is behind it, in any engine and frame.

    Materials that are animated, that move their surface or that show one side alone do not.
    """
    if material is None:
        return True
    tree = used_nodes(material)
    if (
        material.use_backface_culling
        or material.diffuse_color[3] < 1
        or material.animation_data
        or (tree is not None and tree.animation_data)
    ):
        return False
    inputs = ["Volume"] if material.displacement_method == "BUMP" else ["Volume", "Displacement"]
    outputs = _outputs(tree) if tree is not None else []
    is_linked = any(node.inputs[name].is_linked for node in outputs for name in inputs)
    return not is_linked and is_opaque(material)


def _outputs(tree: bpy.types.NodeTree) -> list[bpy.types.Node]:
    return [node for node in tree.nodes if node.type == "OUTPUT_MATERIAL" and not node.mute]


def _mixed(link: bpy.types.NodeLink) -> list[bpy.types.NodeSocket]:
    """Return the inputs for the shaders that make up what `link` brings, if it is several."""
    node = link.from_node
    sockets = []
    if link.from_socket.type == "SHADER" and not node.mute:
        if node.type in MIXES:
            sockets = node.inputs
        elif node.type == "GROUP" and node.node_tree and not node.node_tree.animation_data:
            sockets = sockets_of(node.node_tree, "GROUP_OUTPUT")
    return [socket for socket in sockets if socket.type == "SHADER"]


def _blocks(socket: bpy.types.NodeSocket) -> bool:
    """Return whether the shader that `socket` gets, or the color that shines, lets no ray through.

    Of a mix, the shaders decide that it mixes.
    """
    links = [link for link in socket.links if not link.is_muted]
    if len(links) != 1:
        return False
    node = links[0].from_node
    if links[0].from_socket.type != "SHADER" or _mixed(links[0]):
        return True
    if node.type == "BSDF_PRINCIPLED" and not node.mute:
        alpha = node.inputs["Alpha"]
        transmission = node.inputs["Transmission Weight"]
        return not (
            alpha.is_linked
            or alpha.default_value < 1
            or transmission.is_linked
            or transmission.default_value > 0
        )
    return node.type in OPAQUE and not node.mute


def casts(lamp: bpy.types.Light) -> bool:
    """Return whether the lamp is on and casts shadows."""
    return lamp.use_shadow and lamp.energy != 0 and any(lamp.color) and not _dark(used_nodes(lamp))


def _dark(tree: bpy.types.NodeTree | None) -> bool:
    """Return whether all emission that a lamp's output gets has strength 0."""
    nodes = reached_nodes(sockets_of(tree, "OUTPUT_LIGHT"))
    strengths = [node.inputs["Strength"] for node in nodes if node.type == "EMISSION"]
    return bool(strengths) and not any(map(_set, strengths))


def lights_scene(world: bpy.types.World | None) -> bool:
    """Return whether surfaces receive light of the world, in Cycles.

    A world that is animated counts as if it gave light in all frames.
    """
    if world is None or not world.cycles_visibility.diffuse:
        return False
    tree = used_nodes(world)
    if world.animation_data or (tree is not None and tree.animation_data):
        return True
    if tree is None:
        return any(world.color)
    ends = [socket for socket in sockets_of(tree, "OUTPUT_WORLD") if socket.name == "Surface"]
    return any(map(_shines, reached(ends, _seen_by_all)))


def emits(tree: bpy.types.NodeTree | None) -> bool:
    """Return whether a material's nodes emit light that other surfaces receive.

    Emission for camera rays alone does not count: "unlit" materials have it, glTF's among them.
    """
    ends = sockets_of(tree, "OUTPUT_MATERIAL", "GROUP_OUTPUT")
    return any(map(_shines, reached(ends, _seen_by_all)))


def _shines(socket: bpy.types.NodeSocket) -> bool:
    """Return whether a node that emits leads to `socket`.

    A color where a shader is meant shows as emission.
    """
    return any(
        (socket.type == "SHADER" and link.from_socket.type != "SHADER")
        or _emits_itself(link.from_node)
        for link in socket.links
    )


def _emits_itself(node: bpy.types.Node) -> bool:
    if node.mute:
        return False
    if node.type in ("EMISSION", "BACKGROUND"):
        return (
            _set(node.inputs["Color"])
            and _set(node.inputs["Strength"])
            and not _of_camera(node.inputs["Strength"])
        )
    if node.type in ("BSDF_PRINCIPLED", "PRINCIPLED_VOLUME"):
        strength = node.inputs["Emission Strength"]
        return _set(strength) and _set(node.inputs["Emission Color"]) and not _of_camera(strength)
    return False


def _seen_by_all(link: bpy.types.NodeLink) -> list[bpy.types.NodeSocket]:
    """Return the inputs before `link` that other rays than the camera's may meet."""
    node = link.from_node
    if node.type == "MIX_SHADER" and not node.mute and _of_camera(node.inputs[0]):
        return node.inputs[:2]
    return inputs_before(link)


def _of_camera(socket: bpy.types.NodeSocket) -> bool:
    """Return whether `socket` is 1 for camera rays and 0 for all others."""
    return any(
        link.from_node.type == "LIGHT_PATH" and link.from_socket.name == "Is Camera Ray"
        for link in socket.links
    )


def _set(socket: bpy.types.NodeSocket) -> bool:
    """Return whether a strength or color may differ from 0."""
    value = socket.default_value
    return socket.is_linked or (any(value[:3]) if hasattr(value, "__len__") else value != 0)
