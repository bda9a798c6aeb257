"""The streets of occlusion.py: houses of all kinds, people between them, and cameras.

36 houses of 30 m along streets of 10 m. One is of glass, one of leaves with holes, one shows its
front faces alone, one has an open window, one has walls that meet three at an edge, one is mirrored
and scaled by an instance. A gate shuts a street until it opens.
"""

from collections.abc import Callable
from math import pi

import bpy
import numpy as np
from crowd_lod_extension.sample_scenes.characters import make_characters
from crowd_lod_extension.sample_scenes.scenery import (
    add,
    animate,
    box,
    camera,
    child,
    film,
    material,
    tile,
)

HOUSE = 30.0  # meters
BLOCK = 40.0
MESHES = "House", "Ground", "Gate", "Wall"  # begin the names of the scenery's objects
SEE_THROUGH = {"Glass", "Leaves", "Fronts"}  # materials that must hide nobody
FRAMES = range(1, 121)


def make_street(agents: int, houses: int = 3) -> bpy.types.Scene:
    """A new file's scene: a square of 2 x `houses` houses a side, one pixel's LODs not made yet."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    scene = bpy.context.scene
    film(scene)
    scene.world = None
    characters = child(scene, "Characters", hidden=True)
    make_characters(characters, speed=1.25, finer=-2)
    _build(child(scene, "Scenery"), houses)
    walker = camera(scene, "Walk", near=0.1, far=500.0, lens=28.0)
    places = [(-30.0, 0.8, 1.7), (-14.0, 0.5, 1.7), (-2.0, 0.5, 1.75), (0.5, 3.0, 1.75)]
    places.append((0.8, 16.0, 1.7))
    turns = [yaw - pi / 2 for yaw in (0, 0.05, 0.6, 1.3, 1.57)]
    curves = {("location", k): [place[k] for place in places] for k in range(3)}
    curves |= {("rotation_euler", k): [at] * 5 for k, at in enumerate((pi / 2, 0.0))}
    animate(walker, (1, 40, 70, 92, 120), curves | {("rotation_euler", 2): turns})
    scene.camera = walker
    settings = scene.crowd_lod
    settings.characters = characters
    settings.forward = "X"
    settings.count = agents
    settings.seed = 7
    settings.size = (2 * houses * BLOCK, 2 * houses * BLOCK)
    settings.first_frame = 1
    settings.frames = f"{FRAMES[0]}:{FRAMES[-1]}"
    settings.choice = "BY_DISTANCE"
    settings.method = "DECIMATE"
    settings.level_count = 1
    settings.occlusion = True
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = 480
    scene.render.resolution_y = 270
    bpy.ops.crowd_lod.populate()
    return scene


def _build(home: bpy.types.Collection, houses: int) -> None:
    stucco = material("Stucco", (0.8, 0.7, 0.5))
    special = {
        (0, 0): (box, _see_through("Glass")),
        (-1, 0): (box, _leaves()),
        (0, -1): (box, _fronts()),
        (-2, 0): (_open_house, stucco),
        (1, 0): (_divided_house, stucco),
    }
    random = np.random.default_rng(3)
    for i in range(-houses, houses):
        for j in range(-houses, houses):
            shape, surface = special.get((i, j), (box, stucco))
            x = i * BLOCK + 5
            y = j * BLOCK + 5
            height = float(random.integers(9, 20))
            add(
                home,
                f"House {i} {j}",
                [(shape(x, y, x + HOUSE, y + HOUSE, 0, height), surface)],
            )
    _mirror(home, bpy.data.objects["House -1 -1"])
    edge = houses * BLOCK + 50
    add(home, "Ground", [(tile(-edge, -edge, edge, edge, -0.02), material("Ground", (0.5,) * 3))])
    gate = add(home, "Gate", [(box(-5, 20, 5, 20.5, 0, 6), stucco)])
    animate(gate, (1, 60), {("location", 0): [0.0, 10.0]})


def _mirror(home: bpy.types.Collection, house: bpy.types.Object) -> None:
    """Show the house as a mirrored instance of a collection, half as high again."""
    inside = bpy.data.collections.new("Mirrored")
    home.objects.unlink(house)
    inside.objects.link(house)
    middle = -BLOCK / 2
    inside.instance_offset = (middle, middle, 0)
    stand = bpy.data.objects.new("Mirrored", None)
    stand.instance_type = "COLLECTION"
    stand.instance_collection = inside
    stand.location = (middle, middle, 0)
    stand.scale = (-1, 1, 1.5)
    home.objects.link(stand)


def _see_through(name: str) -> bpy.types.Material:
    """A material that lets rays through straight on."""
    surface = material(name, (0.9, 0.9, 1.0))
    nodes = surface.node_tree.nodes
    end = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")
    surface.node_tree.links.new(nodes.new("ShaderNodeBsdfTransparent").outputs[0], end.inputs[0])
    return surface


def _leaves() -> bpy.types.Material:
    """A material of meters of nothing and meters of green."""
    surface = material("Leaves", (0.1, 0.5, 0.1))
    tree = surface.node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    checker = tree.nodes.new("ShaderNodeTexChecker")
    place = tree.nodes.new("ShaderNodeNewGeometry")
    checker.inputs["Scale"].default_value = 1.37
    checker.inputs["Color1"].default_value = (1, 1, 1, 1)
    checker.inputs["Color2"].default_value = (0, 0, 0, 1)
    tree.links.new(place.outputs["Position"], checker.inputs["Vector"])
    tree.links.new(checker.outputs["Color"], shader.inputs["Alpha"])
    return surface


def _fronts() -> bpy.types.Material:
    surface = material("Fronts", (0.6, 0.6, 0.7))
    surface.use_backface_culling = True
    return surface


def _open_house(x0, y0, x1, y1, z0, z1):
    """A house with a window of 6 m by 3 m in the wall at y0, and one behind it at y1."""
    points, faces = box(x0, y0, x1, y1, z0, z1)
    around = [points[:], faces[:2]]
    middle = (x0 + x1) / 2
    for face in faces[2:]:
        corners = [points[corner] for corner in face]
        if len({y for _, y, _ in corners}) > 1:
            around[1].append(face)
            continue
        y = corners[0][1]
        first = len(around[0])
        sides = (
            (middle - 3, middle + 3) if corners[0][0] < corners[1][0] else (middle + 3, middle - 3)
        )
        left, right = sides
        around[0] += [(left, y, 0.5), (right, y, 0.5), (right, y, 3.5), (left, y, 3.5)]
        around[1] += [
            (face[k], face[(k + 1) % 4], first + (k + 1) % 4, first + k) for k in range(4)
        ]
    return around[0], around[1]


def _divided_house(x0, y0, x1, y1, z0, z1):
    """A house with a wall inside, from corner to corner: its edges have three faces."""
    points, faces = box(x0, y0, x1, y1, z0, z1)
    return points, [*faces, (0, 2, 6, 4)]


def _blur(scene: bpy.types.Scene) -> None:
    scene.render.use_motion_blur = True
    scene.render.motion_blur_shutter = 1.0


def _stereo(scene: bpy.types.Scene) -> None:
    scene.render.use_multiview = True
    scene.render.image_settings.views_format = "INDIVIDUAL"
    scene.camera.data.stereo.interocular_distance = 0.5


def _place(scene: bpy.types.Scene, location, yaw: float, pitch: float = 0.0) -> None:
    """Stand the camera still, and have it look to `yaw` radians from +x, `pitch` up."""
    scene.camera.animation_data_clear()
    scene.camera.location = location
    scene.camera.rotation_euler = (pi / 2 + pitch, 0, yaw - pi / 2)


def _inside(scene: bpy.types.Scene) -> None:
    """In the house with the windows, near one."""
    _place(scene, (-60, 8, 1.7), -pi / 2)


def _cut(scene: bpy.types.Scene) -> None:
    """Half a meter before a corner; the near clip cuts the house open."""
    _place(scene, (44.6, 4.4, 1.7), pi / 4 - 0.2)
    scene.camera.data.clip_start = 3.0


def _sheet(scene: bpy.types.Scene) -> None:
    """A wall of one face, five kilometers wide."""
    wall = bpy.data.meshes.new("Wall")
    wall.from_pydata([(-2500, 2, 0), (2500, 2, 0), (2500, 2, 4), (-2500, 2, 4)], [], [(0, 1, 2, 3)])
    scene.collection.objects.link(bpy.data.objects.new("Wall", wall))


def _ortho(scene: bpy.types.Scene) -> None:
    _place(scene, (-60, -60, 30), pi / 4, -0.5)
    scene.camera.data.type = "ORTHO"
    scene.camera.data.ortho_scale = 90


def _pano(scene: bpy.types.Scene) -> None:
    scene.camera.data.type = "PANO"


def _shift(scene: bpy.types.Scene) -> None:
    scene.camera.data.shift_x = 0.3
    scene.camera.data.shift_y = -0.2


def _lens(scene: bpy.types.Scene) -> None:
    scene.camera.data.dof.use_dof = True


def _cuts(scene: bpy.types.Scene) -> None:
    """Another camera from frame 40 on, while the scene's own has depth of field."""
    first = scene.camera
    other = first.copy()
    other.data = first.data.copy()
    scene.collection.objects.link(other)
    scene.timeline_markers.new("first", frame=1).camera = first
    scene.timeline_markers.new("other", frame=40).camera = other
    first.data.dof.use_dof = True


# name -> (what changes in the street, frames)
CASES: dict[str, tuple[Callable[[bpy.types.Scene], None], tuple[int, ...]]] = {
    "street, gate shut, ajar, open": (lambda scene: None, (1, 70, 92, 110)),
    "motion blur, shutter 1": (_blur, (8, 70, 92)),
    "stereo, eyes 0.5 m apart": (_stereo, (1, 92)),
    "inside a house, by its window": (_inside, (1,)),
    "near clip cuts a house": (_cut, (1,)),
    "a wall of one face, 5 km": (_sheet, (1, 92)),
    "orthographic": (_ortho, (1,)),
    "lens shift": (_shift, (70, 110)),
    "cameras by markers": (_cuts, (1, 70)),
    "depth of field": (_lens, (70,)),
    "panorama": (_pano, (70,)),
}
