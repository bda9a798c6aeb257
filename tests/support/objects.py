"""Objects of the open scene, each made in a line."""

import bpy
from crowd_lod_extension.sample_scenes.scenery import add, material, tile


def mesh_of(name: str, points, faces=(), edges=()) -> bpy.types.Mesh:
    """A mesh of points (n, 3), and the vertices of each face or edge."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, edges, faces)
    return mesh


def box_mesh(name: str, low, high) -> bpy.types.Mesh:
    """A closed box from its least corner to its greatest one."""
    x, y, z = zip(low, high, strict=True)
    corners = [(x[i], y[j], z[k]) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return mesh_of(name, corners, faces)


def placed(
    name: str,
    data: bpy.types.ID | None = None,
    home: bpy.types.Collection | None = None,
    **values,
) -> bpy.types.Object:
    """A new object in the scene or in the collection `home`, with these values of its properties."""
    item = bpy.data.objects.new(name, data)
    (home or bpy.context.scene.collection).objects.link(item)
    for key, value in values.items():
        setattr(item, key, value)
    return item


def box(name: str, low, high) -> bpy.types.Object:
    """A box in the scene."""
    return placed(name, box_mesh(name, low, high))


def filmed_from(location, turn=(0.0, 0.0, 0.0), **lens) -> bpy.types.Object:
    """The scene's new camera, turned by Euler angles, with these values of its lens."""
    data = bpy.data.cameras.new("Camera")
    for key, value in lens.items():
        setattr(data, key, value)
    bpy.context.scene.camera = placed("Camera", data, location=location, rotation_euler=turn)
    return bpy.context.scene.camera


def lamp(kind: str, location=(0.0, 0.0, 5.0), turn=(0.0, 0.0, 0.0), **values) -> bpy.types.Object:
    """A new lamp of the scene, turned by Euler angles, with these values of its light."""
    data = bpy.data.lights.new(kind, kind)
    for key, value in values.items():
        setattr(data, key, value)
    return placed(kind, data, location=location, rotation_euler=turn)


def ground(low_x, low_y, high_x, high_y) -> bpy.types.Object:
    """A level gray rectangle in the scene."""
    gray = material("Ground", (0.5, 0.5, 0.5))
    home = bpy.context.scene.collection
    return add(home, "Ground", [(tile(low_x, low_y, high_x, high_y), gray)])


def collection(name: str, *items: bpy.types.Object, within=None) -> bpy.types.Collection:
    """A new collection in the scene, or within another one, which holds these objects."""
    home = bpy.data.collections.new(name)
    (within or bpy.context.scene.collection).children.link(home)
    for item in items:
        home.objects.link(item)
    return home
