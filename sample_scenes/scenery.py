"""Parts of the sample scenes: shapes, materials, light, animated camera.

World meters, z up.
"""

from math import cos, pi, radians, sin

import bpy
from mathutils import Vector

from ..operators.blender.materials import switch_nodes_on

# A shape is (points, faces): corners in world meters, and for each face the indices of its corners,
# normals outward.
Polygons = tuple[list[tuple[float, float, float]], list[tuple[int, ...]]]

SUN = Vector((-0.45, -0.55, 0.70)).normalized()  # towards it
SKY = (0.42, 0.60, 0.85)


def box(x0, y0, x1, y1, z0, z1, inset=0.0) -> Polygons:
    """Return a box; its top is `inset` meters smaller on each side, as a hipped roof."""
    low = [(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0)]
    high = [(x0 + inset, y0 + inset, z1), (x1 - inset, y0 + inset, z1)]
    high += [(x1 - inset, y1 - inset, z1), (x0 + inset, y1 - inset, z1)]
    around = [(i, (i + 1) % 4, (i + 1) % 4 + 4, i + 4) for i in range(4)]
    return low + high, [(3, 2, 1, 0), (4, 5, 6, 7), *around]


def tile(x0, y0, x1, y1, z=0.0) -> Polygons:
    """Return a level rectangle at the height z, facing up."""
    return [(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)], [(0, 1, 2, 3)]


def lathe(x, y, profile: list[tuple[float, float]], sides=12) -> Polygons:
    """Return the solid of revolution of a profile about the vertical through (x, y).

    profile: (radius, z) points, from the bottom up.
    """
    points = []
    faces = []
    turns = [(cos(2 * pi * i / sides), sin(2 * pi * i / sides)) for i in range(sides)]
    for radius, z in profile:
        points += [(x + radius * c, y + radius * s, z) for c, s in turns]
    for ring in range(len(profile) - 1):
        a = ring * sides
        b = (ring + 1) * sides
        faces += [(a + i, a + (i + 1) % sides, b + (i + 1) % sides, b + i) for i in range(sides)]
    top = (len(profile) - 1) * sides
    return points, [tuple(reversed(range(sides))), *faces, tuple(range(top, top + sides))]


SPACING = 3.0  # meters between windows
OUT = 0.04  # meters of panes before a wall


def windows(x0, y0, x1, y1, z0, z1, storey=3.4) -> Polygons:
    """Return panes on the four sides of the box, a little in front of the walls.

    One every SPACING meters along a wall and every `storey` meters up.
    """
    points = []
    faces = []
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True):
        length = abs(bx - ax) + abs(by - ay)
        dx = (bx - ax) / length
        dy = (by - ay) / length
        for column in range(int(length // SPACING)):
            middle = (column + 0.5) * length / (length // SPACING)
            for row in range(int((z1 - z0) // storey)):
                bottom = z0 + row * storey + (0.9 if row else 0.0)
                top = z0 + row * storey + 2.6
                for along, z in ((-0.55, bottom), (0.55, bottom), (0.55, top), (-0.55, top)):
                    s = middle + along
                    points.append((ax + dx * s + dy * OUT, ay + dy * s - dx * OUT, z))
                faces.append(tuple(range(len(points) - 4, len(points))))
    return points, faces


def material(name: str, color: tuple[float, float, float], roughness=0.8) -> bpy.types.Material:
    """Return a new material of one linear RGB color.

    It looks the same in the viewport and in a render.
    """
    new_material = bpy.data.materials.new(name)
    new_material.diffuse_color = (*color, 1.0)
    new_material.roughness = roughness
    nodes = switch_nodes_on(new_material).nodes
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = (*color, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    return new_material


def add(
    collection: bpy.types.Collection, name: str, parts: list[tuple[Polygons, bpy.types.Material]]
) -> bpy.types.Object:
    """Return a new object in `collection` with one mesh of all `parts`.

    Each part has its own material.
    """
    points = []
    faces = []
    slots = []
    materials = list(dict.fromkeys(look for _, look in parts))
    for (corners, polygons), look in parts:
        first = len(points)
        points += corners
        faces += [tuple(first + corner for corner in polygon) for polygon in polygons]
        slots += [materials.index(look)] * len(polygons)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], faces)
    for look in materials:
        mesh.materials.append(look)
    mesh.polygons.foreach_set("material_index", slots)
    mesh.update()
    made = bpy.data.objects.new(name, mesh)
    collection.objects.link(made)
    return made


def child(scene: bpy.types.Scene, name: str, hidden=False) -> bpy.types.Collection:
    """Return a new collection of the scene.

    hidden: exclude it from the scene's view layers.
    """
    collection = bpy.data.collections.new(name)
    scene.collection.children.link(collection)
    for layer in scene.view_layers:
        layer.update()  # a new scene's has no layer collections yet
        layer.layer_collection.children[collection.name].exclude = hidden
    return collection


def film(scene: bpy.types.Scene) -> None:
    """Set the scene's frames, pixels and light for a clear day.

    Five seconds at 24 frames per second, 960 x 540 pixels. The light is a sun with shadows and a
    blue sky. Workbench is set to draw no shadows: those of thousands of characters take many times
    as long as the rest of the picture.
    """
    scene.frame_start = 1
    scene.frame_end = 120
    render = scene.render
    render.fps = 24
    render.fps_base = 1.0
    render.resolution_x = 960
    render.resolution_y = 540
    render.resolution_percentage = 100
    scene.view_settings.view_transform = "Standard"
    shading = scene.display.shading
    shading.background_type = "WORLD"
    shading.color_type = "MATERIAL"
    scene.display.light_direction = (SUN.x, SUN.z, -SUN.y)  # this setting has y up
    sun = bpy.data.lights.new("Sun", "SUN")
    sun.energy = 3.0
    sun.angle = radians(0.5)
    sun.color = (1.0, 0.94, 0.85)
    lamp = bpy.data.objects.new("Sun", sun)
    lamp.location = 100 * SUN
    lamp.rotation_euler = SUN.to_track_quat("Z", "Y").to_euler()
    scene.collection.objects.link(lamp)
    world = bpy.data.worlds.new("Sky")
    world.color = SKY
    nodes = switch_nodes_on(world).nodes
    sky = next(node for node in nodes if node.type == "BACKGROUND")
    sky.inputs["Color"].default_value = (*SKY, 1.0)
    scene.world = world


def camera(
    scene: bpy.types.Scene, name: str, near: float, far: float, lens=35.0
) -> bpy.types.Object:
    """Return a new camera that sees from `near` to `far` meters.

    lens: focal length in millimeters.
    """
    data = bpy.data.cameras.new(name)
    data.clip_start = near
    data.clip_end = far
    data.lens = lens
    made = bpy.data.objects.new(name, data)
    scene.collection.objects.link(made)
    return made


def aim(item: bpy.types.Object, location, target) -> None:
    """Place the camera `item` at `location` so that it looks at `target`, upright."""
    item.location = location
    item.rotation_euler = (Vector(target) - Vector(location)).to_track_quat("-Z", "Y").to_euler()


def animate(
    block: bpy.types.ID, frames: list[float], curves: dict[tuple[str, int], list[float]]
) -> None:
    """Add keyframes to `block`, smooth between.

    curves: for each (data path, index) its values at `frames`.
    """
    action = bpy.data.actions.new(block.name)
    slot = action.slots.new(block.id_type, block.name)
    bag = action.layers.new("Layer").strips.new(type="KEYFRAME").channelbag(slot, ensure=True)
    for (path, index), values in curves.items():
        curve = bag.fcurves.new(path, index=index)
        curve.keyframe_points.add(len(frames))
        for key, frame, value in zip(curve.keyframe_points, frames, values, strict=True):
            key.co = frame, value
            key.interpolation = "BEZIER"
            key.handle_left_type = key.handle_right_type = "AUTO_CLAMPED"
        curve.update()
    block.animation_data_create().action = action
    block.animation_data.action_slot = slot
