"""Scaled images for the far LODs of a build, in copies of their materials.

Images are scaled to what the LODs can show. The copies share the scaled images.
"""

import hashlib
from collections.abc import Generator, Iterable

import bpy
import numpy as np

from ...crowd_lod.levels.assignment import deviations, grain, limits
from ...crowd_lod.levels.texture_scale import halvings, scaled, texel
from ..blender import cameras, color_space, mesh_data, scene_data
from ..blender.image_nodes import image_nodes
from ..machine.scene_world import bias_of
from ..scene.scene_crowd import characters_of, home_of, policy_of, trajectory_of

# custom property of a scaled image: a hash of what it was made from, and how often that was halved
SCALED = "crowd_lod_scaled"
LOOKED_AT = 9  # frames, evenly, whose cameras are asked how large they show LODs
UNSTILL = {
    "TILED": "UDIM tiles",
    "SEQUENCE": "a sequence",
    "MOVIE": "a movie",
    "VIEWER": "a render",
}

Levels = frozenset[tuple[bpy.types.Image, int]]  # images, and how often each is to be halved


def image_bytes(materials: Iterable[bpy.types.Material]) -> int:
    """Return the memory of the images of `materials` in Cycles, each counted once.

    See bytes_of.
    """
    return bytes_of((image, 0) for image in _images(materials))


def bytes_of(levels: Iterable[tuple[bpy.types.Image, int]]) -> int:
    """Return the memory in Cycles of images halved so often, each counted once.

    Bytes: width x height x 4, or x 16 for float images (Cycles may keep 8 for those that files hold
    in 16 bits).
    """
    total = 0
    for image, times in set(levels):
        sizes = [tile.size for tile in image.tiles] if image.source == "TILED" else [image.size]
        total += sum(-(-w // 2**times) * -(-h // 2**times) for w, h in sizes) * (
            16 if image.is_float else 4
        )
    return total


def shown_images(scene: bpy.types.Scene, settings) -> dict[bpy.types.Object, Levels]:
    """Return for each LOD's object the images that it shows in a build of `scene`.

    They are halved if Scale Textures is on.
    """
    pixels = _pixels(scene, settings) if settings.scale_textures else {}
    images = {}
    for item in settings.levels.all_objects:
        far = item.type == "MESH" and pixels.get(item, 0) > 0
        scaled = set()
        for number, slot in enumerate(item.material_slots):
            halved = dict(_levels(item, number, pixels[item], {})) if far else {}
            scaled |= {(image, halved.get(image, 0)) for image in _images([slot.material])}
        images[item] = frozenset(scaled)
    return images


def _images(materials: Iterable[bpy.types.Material | None]) -> set[bpy.types.Image]:
    """Return the images in the nodes of `materials`."""
    return {
        node.image
        for material in materials
        if material
        for node, _ in image_nodes(material.node_tree)
    }


def scale_textures(
    scene: bpy.types.Scene,
    settings,
    stands_for: dict[bpy.types.Object, bpy.types.Object],
    names: dict,
) -> Generator[float, None, tuple[float, float, list[str]]]:
    """Give the build's objects materials with images no larger than LODs can show.

    stands_for: the build's object -> the LOD's object that it stands for. The LODs' own meshes and
        materials stay as they are.
    names: gets the new blocks with their final names.

    Yields 1.0; returns (bytes before, bytes after, sentences).
    """
    before = image_bytes({slot.material for copy in stands_for for slot in copy.material_slots})
    pixels = _pixels(scene, settings)
    levels = {}
    left = {}
    scaled_images = {}
    yield 1.0
    for copy, item in stands_for.items():
        if copy.type == "MESH" and pixels[item] > 0 and item not in levels:
            levels[item] = [
                _levels(copy, slot, pixels[item], left) for slot in range(len(copy.material_slots))
            ]
    every = {each for slots in levels.values() for own in slots for each in own}
    for image, times in sorted(every, key=lambda pair: (pair[0].name_full, pair[1])):
        scaled_images[image, times] = _scaled(image, times, names)
        yield 1.0
    materials = {}
    for copy, item in stands_for.items():
        if any(levels.get(item, ())):
            _dress(copy, item, levels[item], scaled_images, materials, names)
    after = image_bytes({slot.material for copy in stands_for for slot in copy.material_slots})
    sentence = (
        [f"Images in full: {', '.join(f'{image.name} ({why})' for image, why in left.items())}."]
        if left
        else []
    )
    return (
        before,
        after,
        [
            f"Images of the characters take {after / 1e6:,.1f} MB, unscaled {before / 1e6:,.1f} "
            f"MB.",
            *sentence,
        ],
    )


def _pixels(scene: bpy.types.Scene, settings) -> dict[bpy.types.Object, float]:
    """Return for each LOD's object the meters per pixel where it is nearest.

    0 for the finest LOD.
    """
    policy = policy_of(settings)
    trajectory = trajectory_of(scene)
    pixels = {}
    bias = bias_of(settings)
    farther = 1.0 if bias is None else 4.0 ** (1 - 2 * float(bias.values.min()))
    radius = trajectory.spheres.radius
    frames = {
        *np.linspace(scene.frame_start, scene.frame_end, LOOKED_AT).round().tolist(),
        scene.frame_current,
    }
    grains = []
    for eyes in cameras.cameras_at(
        scene, [scene_data.remap(scene.render, frame) for frame in sorted(frames)]
    ):
        for camera in eyes:
            begin = limits(policy, camera, radius, deviations(trajectory.groups, policy))
            grains.append(grain(begin / farther, camera, radius))
    nearest = np.concatenate([np.zeros((len(radius), 1)), np.min(grains, axis=0)], axis=1)
    for k, level in enumerate(settings.levels.children[: policy.count]):
        for g, (name, _, _) in enumerate(characters_of(scene)):
            for item in home_of(level, g, name).objects:
                # a group with fewer LODs repeats its last
                pixels.setdefault(item, float(nearest[g, k]))
    return pixels


def _coordinates(socket: bpy.types.NodeSocket, path: tuple) -> tuple[str, float] | None:
    """Return (UV map, least factor on it) to which the socket leads back.

    The name "" stands for the active UV map. None if the coordinates are not those of a UV map.
    """
    if not socket.links:
        return ("", 1.0) if socket.node.type == "TEX_IMAGE" else None
    link = socket.links[0]
    node = link.from_node
    if node.type == "UVMAP" and not node.from_instancer:
        return node.uv_map, 1.0
    if node.type == "TEX_COORD" and link.from_socket.identifier == "UV" and not node.from_instancer:
        return "", 1.0
    if node.type == "REROUTE":
        return _coordinates(node.inputs[0], path)
    if node.type == "GROUP_INPUT" and path:
        outer = next(
            group_input
            for group_input in path[-1].inputs
            if group_input.identifier == link.from_socket.identifier
        )
        return _coordinates(outer, path[:-1])
    if (
        node.type == "MAPPING"
        and node.vector_type in ("POINT", "VECTOR")
        and not node.inputs["Scale"].links
    ):
        coordinates = _coordinates(node.inputs["Vector"], path)
        return coordinates and (
            coordinates[0],
            coordinates[1] * min(abs(number) for number in node.inputs["Scale"].default_value[:2]),
        )
    return None


def _levels(
    copy: bpy.types.Object, slot: int, pixel: float, left: dict[bpy.types.Image, str]
) -> Levels:
    """Return how often the images of the object's material in `slot` may be halved.

    left: gets the images that cannot be halved, and why.
    """
    material = copy.material_slots[slot].material
    levels = {}
    for node, path in image_nodes(material.node_tree) if material else ():
        image = node.image
        at = _coordinates(node.inputs["Vector"], path)
        times = 0
        if image.source in UNSTILL:
            left[image] = UNSTILL[image.source]
        elif not image.size[0] * image.size[1] or not len(image.pixels):
            left[image] = "no pixels"
        elif node.projection != "FLAT" or at is None:
            left[image] = "not placed by a UV map alone"
        else:
            corners, uvs = _surface(copy, slot, at[0])
            times = halvings(
                texel(corners, uvs * at[1], tuple(image.size)), pixel, tuple(image.size)
            )
        levels[image] = min(times, levels.get(image, times))
    return frozenset((image, times) for image, times in levels.items() if times)


def _surface(copy: bpy.types.Object, slot: int, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles of the object that have the material in `slot`.

    (corners (m, 3, 3) meters, UVs (m, 3, 2)).
    """
    mesh = copy.data
    points, triangles, corners, faces = mesh_data.read_triangles(mesh)
    slots = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("material_index", slots)
    uvs = np.zeros((len(mesh.loops), 2), np.float32)
    layer = (
        mesh.uv_layers.get(name)
        if name
        else next((layer for layer in mesh.uv_layers if layer.active_render), None)
    )
    if layer is not None:
        layer.uv.foreach_get("vector", uvs.ravel())
    own = slots.clip(0, len(copy.material_slots) - 1)[faces] == slot
    matrix = np.array(copy.matrix_basis, np.float64)
    return (points @ matrix[:3, :3].T)[triangles[own]], uvs[corners[own]].astype(np.float64)


def _scaled(image: bpy.types.Image, times: int, names: dict) -> bpy.types.Image:
    """Return the image, halved so many `times` and packed.

    An equal one of another build is reused; a new one is added to `names`.
    """
    space = image.colorspace_settings
    width, height = image.size
    values = np.empty((height, width, image.channels), np.float32)
    image.pixels.foreach_get(values.ravel())
    looks = repr((values.shape, times, image.is_float, space.name, image.alpha_mode))
    mark = hashlib.sha256(looks.encode() + hashlib.sha256(values).digest()).hexdigest()
    for other in bpy.data.images:
        if other.get(SCALED) == mark and other.library is None and other.packed_file:
            return other
    if values.shape[2] < 4:
        colors = values[..., :3] if values.shape[2] == 3 else values[..., :1].repeat(3, axis=2)
        values = np.concatenate([colors, np.ones((height, width, 1), np.float32)], axis=2)
    encoded = not image.is_float and space.name == "sRGB"
    bytes_ = np.arange(256) / 255
    light = color_space.to_linear(bytes_[:, None].repeat(3, axis=1))[:, 0] if encoded else None
    straight = not image.is_float and image.alpha_mode == "STRAIGHT"
    pixels = scaled(values, times, light, straight)
    if encoded:
        pixels = color_space.to_srgb(pixels)
    title = f"{image.name} / {2**times}"
    copy = bpy.data.images.new(
        title, *pixels.shape[1::-1], alpha=True, float_buffer=image.is_float, is_data=space.is_data
    )
    names[copy] = title
    copy[SCALED] = mark
    if not image.is_float:
        # floats are linear as they are held, and colors multiplied by alpha
        copy.colorspace_settings.name = space.name
    copy.alpha_mode = (
        "PREMUL" if image.is_float and image.alpha_mode == "STRAIGHT" else image.alpha_mode
    )
    copy.pixels.foreach_set(pixels.ravel())
    copy.update()
    copy.pack()
    return copy


def _dress(
    copy, item, levels: list[Levels], scaled_images: dict, copies: dict, names: dict
) -> None:
    """Give `copy` of the LOD's object `item` materials with images at these `levels`.

    levels: one entry per slot.
    copies: the copies that exist already.
    """
    materials = [
        _material(slot.material, own, scaled_images, copies, names)
        for slot, own in zip(copy.material_slots, levels, strict=True)
    ]
    # which stays: images of the materials of a mesh are loaded, whatever its object has in their
    # place
    if copy.data == item.data:
        if item not in copies:
            copies[item] = item.data.copy()
            names[copies[item]] = item.data.name
        copy.data = copies[item]
    for k, material in enumerate(materials):
        copy.data.materials[k] = material
        if copy.material_slots[k].link == "OBJECT":
            copy.material_slots[k].material = material


def _material(
    material: bpy.types.Material | None,
    levels: Levels,
    scaled_images: dict,
    copies: dict,
    names: dict,
) -> bpy.types.Material | None:
    """Return a copy of the material with its images at these `levels`."""
    if not levels:
        return material
    if (material, levels) not in copies:
        copy = copies[material, levels] = material.copy()
        names[copy] = material.name
        copy.use_fake_user = False
        _exchange(copy.node_tree, dict(levels), scaled_images, copies, names)
    return copies[material, levels]


def _exchange(
    tree: bpy.types.NodeTree,
    levels: dict[bpy.types.Image, int],
    scaled_images: dict,
    copies: dict,
    names: dict,
) -> None:
    """Put the images at these `levels` into the nodes of `tree`, and copy its groups."""
    for node in tree.nodes:
        if node.type == "TEX_IMAGE" and node.image in levels:
            node.image = scaled_images[node.image, levels[node.image]]
        elif node.type == "GROUP" and any(
            inner.image in levels for inner, _ in image_nodes(node.node_tree)
        ):
            key = frozenset(
                (inner.image, levels[inner.image])
                for inner, _ in image_nodes(node.node_tree)
                if inner.image in levels
            )
            group = node.node_tree
            if (group, key) not in copies:
                copies[group, key] = group.copy()
                names[copies[group, key]] = group.name
                copies[group, key].use_fake_user = False
                _exchange(copies[group, key], levels, scaled_images, copies, names)
            node.node_tree = copies[group, key]
