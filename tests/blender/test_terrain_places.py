"""Populate reads terrain and places to start.

The file keeps them, and says when what they were made of has changed.
"""

from math import radians

import bpy
import numpy as np
import pytest
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.scene import scene_crowd
from crowd_lod_extension.operators.scene.machine import kept_meshes
from crowd_lod_extension.operators.scene.machine.scene_world import machine_of
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ..support.freshness import changed_since_populate
from ..support.messages import told
from ..support.objects import box, collection, mesh_of, placed

pytestmark = pytest.mark.usefixtures("at_once")

SIT = (
    '{"version": 1, "labels": {"ground": {"color": "#808080"}}, "states": {"sit": {"color": '
    '"#ff0000", "on": {"*": {}}}}}'
)


def add(name, points, faces=(), edges=()):
    return placed(name, mesh_of(name, points, faces, edges))


def station(scene):
    """Two floors and stairs, as a collection of boxes.

    One is scaled, turned, mirrored, and one is an instance.
    """
    home = collection("Station")
    step = bpy.data.collections.new("Step")
    floor = box("Floor", (-1, -1, -1), (1, 1, 0))
    upper = box("Upper", (0, -20, 3.75), (25, 20, 4))
    floor.scale = (-25, 25, 0.5)
    floor.rotation_euler = (0, 0, radians(90))
    items = [floor, upper]
    tread = box("Tread", (0, -5, 0), (1, 5, 0.25))
    step.objects.link(tread)
    for k in range(16):
        items.append(placed(f"Step {k}", location=(k - 16, 0, 0.25 * k)))
        items[-1].instance_type = "COLLECTION"
        items[-1].instance_collection = step
    for item in items:
        scene.collection.objects.unlink(item)
        home.objects.link(item)
    scene.collection.objects.unlink(tread)
    return home


def waves(scene, size=40, count=41):
    side = np.linspace(-size / 2, size / 2, count)
    points = [(x, y, np.sin(x / 4) * np.cos(y / 5)) for y in side for x in side]
    faces = [
        (r * count + c, r * count + c + 1, (r + 1) * count + c + 1, (r + 1) * count + c)
        for r in range(count - 1)
        for c in range(count - 1)
    ]
    return add("Waves", points, faces)


def sitting(scene):
    text = bpy.data.texts.new("sit")
    text.write(SIT)
    scene.crowd_lod.machine = text


def populated(scene):
    """What Populate says, and the crowd."""
    assert bpy.ops.crowd_lod.populate() == {"FINISHED"}
    return scene_crowd.trajectory_of(scene)


def ours():
    return [mesh for mesh in bpy.data.meshes if mesh.name.startswith("Crowd LOD")]


def test_agents_stand_where_blenders_rays_meet_the_terrain(scene):
    scene.crowd_lod.terrain_object = item = waves(scene)
    item.modifiers.new("Subdivide", "SUBSURF").levels = 1
    crowd = populated(scene)
    tree = BVHTree.FromObject(item, bpy.context.evaluated_depsgraph_get())
    for time in (1, 60.5):
        now = crowd.at(time)
        checked = [
            (z, tree.ray_cast(Vector((x, y, 50)), Vector((0, 0, -1)))[0])
            for x, y, z in zip(now.x, now.y, now.z, strict=True)
        ]
        met = [(z, point.z) for z, point in checked if point is not None]
        assert len(met) > 290 and max(abs(z - other) for z, other in met) < 1e-5
    assert not crowd.heights.layered and crowd.heights.span[1] > 0.9


def test_walkers_climb_stairs_of_instances_and_others_stay_below(scene):
    scene.crowd_lod.terrain = station(scene)
    scene.crowd_lod.count = 400
    scene.crowd_lod.size = (40, 38)
    crowd = populated(scene)
    assert crowd.heights.layered
    start = crowd.at(1)
    later = crowd.at(500)
    assert start.z.max() <= 1.75 and (later.z > 3.9).sum() > 5
    heights = np.append(np.arange(0, 17) * 0.25, crowd.heights.z)
    assert np.abs(later.z[:, None] - heights).min(axis=1).max() < 1e-5
    up = later.z > 3.9
    assert (later.x[up] >= -1).all() and (np.abs(start.y[up]) < 5.01).all() and not up.all()


def test_undo_of_populate_brings_the_ground_before_back(scene):
    scene.crowd_lod.terrain_object = waves(scene)
    before = populated(scene).at(40)
    bpy.ops.ed.undo_push(message="before")
    scene.crowd_lod.terrain_object.location.z = 3
    scene.view_layers[0].update()
    assert populated(scene).at(40).z.min() > before.z.min() + 1
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    again = scene_crowd.trajectory_of(bpy.context.scene).at(40)
    assert again.z.tobytes() == before.z.tobytes() and len(ours()) == 1
    bpy.ops.ed.redo()
    assert scene_crowd.trajectory_of(bpy.context.scene).at(40).z.min() > before.z.min() + 1


def test_the_kept_ground_outlives_saving_and_copies(scene, tmp_path):
    scene.crowd_lod.terrain = station(scene)
    scene.crowd_lod.spawn_on, scene.crowd_lod.spawn_object = "SURFACE", waves(scene)
    before = populated(scene).at(40)
    first = [scene.crowd_lod.terrain_mesh, scene.crowd_lod.spawn_places]
    copy = scene.copy()
    copy.use_fake_user = True
    names = scene.name, copy.name
    scene.crowd_lod.seed = 5
    other = populated(scene).at(40)
    assert not np.array_equal(other.x, before.x)
    assert [copy.crowd_lod.terrain_mesh, copy.crowd_lod.spawn_places] == first and len(ours()) == 4
    path = str(tmp_path / "kept.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    for name, known in zip(names, (other, before), strict=True):
        loaded = scene_crowd.trajectory_of(bpy.data.scenes[name]).at(40)
        for column in "xyz":
            assert getattr(loaded, column).tobytes() == getattr(known, column).tobytes()


def test_what_is_no_longer_used_is_removed(scene):
    scene.crowd_lod.terrain_object = waves(scene)
    populated(scene), populated(scene)
    assert len(ours()) == 1
    scene.crowd_lod.terrain_object = None
    populated(scene)
    assert ours() == []


def test_a_change_of_the_terrain_or_of_the_places_is_told(scene):
    settings = scene.crowd_lod
    settings.terrain_object, settings.spawn_on, settings.spawn_object = ground, _, _ = (
        waves(scene),
        "SURFACE",
        waves(scene),
    )
    populated(scene)
    assert changed_since_populate(scene) == []
    ground.modifiers.new("Subdivide", "SUBSURF").levels = 1
    assert changed_since_populate(scene) == ["the terrain"]
    populated(scene)
    ground.location.z = 1
    scene.view_layers[0].update()
    assert changed_since_populate(scene) == ["the terrain"]
    populated(scene)
    for block in (ground, ground.data, ground.modifiers[0], settings.spawn_object):
        block.name = "Hill"  # is no change
    assert changed_since_populate(scene) == []
    settings.count += 1
    assert changed_since_populate(scene) == ["the spawn places"]
    settings.terrain_object = None
    assert changed_since_populate(scene) == ["the spawn places", "the terrain"]
    populated(scene)
    assert changed_since_populate(scene) == []


def test_holes_and_moving_terrain_are_told(scene, capfd):
    item = waves(scene, size=20)
    item.keyframe_insert("location")
    scene.crowd_lod.terrain_object = item
    crowd = populated(scene)
    over = int(((np.abs(crowd.start.x) > 10) | (np.abs(crowd.start.y) > 10)).sum())
    said = capfd.readouterr().out
    assert (
        f"{over} of 300 agents have no ground of the terrain Waves under them, and stand at the "
        f"crowd's height, 0 m: " in said
    )
    assert "The terrain moves (Waves): agents stand on it as it is now, in all frames." in said
    assert over > 100 and (crowd.at(1).z[np.abs(crowd.start.x) > 10] == 0).all()


def test_terrain_among_the_characters_is_none_of_them(scene, capfd):
    item = waves(scene)
    scene.crowd_lod.characters.objects.link(item)
    scene.crowd_lod.terrain_object = item
    assert [group.name for group in populated(scene).groups] == ["adult", "child"]
    assert not item.hide_render and item.name in scene.collection.objects
    assert (
        "The terrain lies in the collection People of the characters (Waves), which renders leave "
        "out" in capfd.readouterr().out
    )


def test_places_are_on_the_surface_where_it_is_dense(scene):
    settings = scene.crowd_lod
    item = waves(scene)
    sitting(scene)
    item.location = (3, 4, 5)
    item.rotation_euler = (0.3, 0.2, 1)
    item.scale = (1, 0.5, 2)
    group = item.vertex_groups.new(name="Dense")
    group.add([v.index for v in item.data.vertices if v.co.x > 0], 1.0, "REPLACE")
    settings.spawn_on = "SURFACE"
    settings.spawn_object = item
    settings.density_group = "Dense"
    volume = bpy.data.collections.new("Volumes")
    region = bpy.data.objects.new("Region", None)
    region.empty_display_size = 8
    region.location = (3, 4, 5)
    scene.collection.children.link(volume)
    volume.objects.link(region)
    settings.density_volumes = volume
    crowd = populated(scene)
    assert crowd.seated and len(crowd.start) == 300
    tree = BVHTree.FromObject(item, bpy.context.evaluated_depsgraph_get())
    inverse = item.matrix_world.inverted()
    for x, y, z in zip(crowd.start.x, crowd.start.y, crowd.start.z, strict=True):
        own = inverse @ Vector((x, y, z))
        assert tree.find_nearest(own)[3] < 2e-6 and own.x > -1.001
        assert max(abs(x - 3), abs(y - 4), abs(z - 5)) < 8 + 1e-5


def test_an_images_gray_is_the_density(scene):
    settings = scene.crowd_lod
    item = add("Tile", [(-20, -20, 0), (20, -20, 0), (20, 20, 0), (-20, 20, 0)], [(0, 1, 2, 3)])
    item.data.uv_layers.new().uv.foreach_set("vector", [0, 0, 1, 0, 1, 1, 0, 1])
    image = bpy.data.images.new("Gray", 8, 4)
    pixels = np.ones((4, 8, 4), np.float32)
    pixels[:, :4, :3] = 0.0
    pixels[2:] = (0, 0, 0, 1)
    image.pixels.foreach_set(pixels.ravel())
    sitting(scene)
    settings.spawn_on = "SURFACE"
    settings.spawn_object = item
    settings.density_image = image
    start = populated(scene).start
    assert len(start) == 300 and (start.x >= 0).all() and (start.y <= 0).all()


def test_rows_along_a_curve_do_not_depend_on_its_thickness(scene):
    sitting(scene)
    curve = bpy.data.curves.new("Ring", "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new("POLY")
    spline.points.add(3)
    for point, place in zip(spline.points, ((-10, -5), (10, -5), (10, 5), (-10, 5)), strict=True):
        point.co = (*place, 0, 1)
    spline.use_cyclic_u = True
    item = placed("Ring", curve)
    item.location.z = 2
    settings = scene.crowd_lod
    settings.spawn_on = "CURVES"
    settings.spawn_object = item
    settings.spacing = 1.0
    settings.rows = 2
    settings.row_depth = 1.0
    settings.row_rise = 0.5
    thin = populated(scene).start
    assert len(thin) == 60 + 68 and set(thin.z.round(6)) == {2.0, 2.5}
    curve.bevel_depth = 0.3
    thick = populated(scene).start
    assert thick.x.tobytes() == thin.x.tobytes() and len(bpy.data.curves) == 1


def test_who_spawns_on_an_object_faces_another(scene):
    sitting(scene)
    settings = scene.crowd_lod
    settings.spawn_on = "POINTS"
    settings.spawn_object = add("Seats", [(4, 0, 1), (0, 4, 1), (-4, 0, 1)])
    settings.face = stage = bpy.data.objects.new("Stage", None)
    scene.collection.objects.link(stage)
    for x in (0.0, 40.0):
        stage.location = (x, 0, 3)
        start = populated(scene).start
        ways = np.stack([np.cos(start.heading), np.sin(start.heading)], axis=1)
        to = np.stack([x - start.x, -start.y], axis=1)
        cosine = (ways * to).sum(axis=1) / np.hypot(*to.T)
        assert np.allclose(cosine, 1, atol=1e-6)
        assert not changed_since_populate(scene)
    stage.location.y = 5
    bpy.context.view_layer.update()
    assert changed_since_populate(scene)


def test_instances_give_places_and_headings(scene):
    sitting(scene)
    parent = add("Seats", [(0, 0, 1), (60, 0, 2), (0, 70, 3)])
    chair = box("Chair", (0, 0, 0), (0.1, 0.1, 0.1))
    chair.parent = parent
    parent.instance_type = "VERTS"
    chair.rotation_euler = (0, 0, radians(30))
    settings = scene.crowd_lod
    settings.spawn_on = "POINTS"
    settings.spawn_object = parent
    start = populated(scene).start
    assert sorted(zip(start.x, start.y, start.z, strict=True)) == [
        (0, 0, 1),
        (0, 70, 3),
        (60, 0, 2),
    ]
    assert np.allclose(start.heading, radians(30), atol=1e-6)
    parent.instance_type = "NONE"
    assert len(populated(scene).start) == 3


def map_of_ground(scene):
    """A map of the first label alone."""
    color = machine_of(scene.crowd_lod).label_colors[0]
    pixels = np.full((8, 8, 4), 255, np.uint8)
    pixels[..., :3] = color
    return image_data.write_image("ground", pixels)


def rows_around(scene):
    """Walkers who start in twelve rows along a ring that is larger than Size."""
    angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    places = np.column_stack([40 * np.cos(angle), 25 * np.sin(angle), np.zeros(32)])
    edges = [(k, (k + 1) % 32) for k in range(32)]
    settings = scene.crowd_lod
    settings.machine = None
    settings.spawn_on = "CURVES"
    settings.spawn_object = add("Ring", places.tolist(), (), edges)
    settings.count = 240
    settings.rows = 12
    settings.size = (60, 60)
    return settings


def test_without_a_map_the_ground_is_as_large_as_the_start(scene):
    settings = rows_around(scene)
    assert len(populated(scene).start) == 240 and told(scene) == ""
    settings.size = (120, 120)
    settings.center.y = 2.0
    inside = populated(scene)
    (part,) = inside.parts
    assert part.world.area.size == (120, 120)


def test_with_a_map_the_size_that_fits_is_told(scene):
    settings = rows_around(scene)
    settings.map_image = map_of_ground(scene)
    few = len(populated(scene).start)
    assert 0 < few < 240
    lines = told(scene).splitlines()
    outside = (
        f"{240 - few} of 240 start points lie outside the crowd's area (60 x 60): set Size to "
    )
    (line,) = [line for line in lines if line.startswith(outside)]
    settings.size = [float(side) for side in line.removeprefix(outside).rstrip(".").split(" x ")]
    assert len(populated(scene).start) == 240


def away(scene):
    sitting(scene)
    settings = scene.crowd_lod
    settings.machine = None
    settings.spawn_on = "SURFACE"
    settings.spawn_object = waves(scene)
    settings.center = (500, 0, 0)
    settings.map_image = map_of_ground(scene)


def nan(scene):
    item = waves(scene)
    item.data.vertices[7].co.z = float("nan")
    return item


WRONG = {
    "no terrain faces": (lambda s: setattr(s.crowd_lod, "terrain_object", add("Bare", [(0, 0, 0)])), "The terrain Bare has no face"),
    "an empty collection": (lambda s: setattr(s.crowd_lod, "terrain", bpy.data.collections.new("None")), "The terrain None has no face"),
    "a wall": (
        lambda s: setattr(s.crowd_lod, "terrain_object", add("Wall", [(0, 0, 0), (1, 0, 0), (1, 0, 1)], [(0, 1, 2)])),
        "no face that one can stand on",
    ),
    "terrain at nan": (lambda s: setattr(s.crowd_lod, "terrain_object", nan(s)), "Waves.001 has 1 "
                                                                                 "vertex at NaN "
                                                                                 "or infinity"),
    "no object": (lambda s: setattr(s.crowd_lod, "spawn_on", "SURFACE"), "spawns on an object, "
                                                                         "and has none"),
    "off the map": (away, "All 300 places of .* lie outside the crowd's area: set Size to 1,040 x 40"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_read_is_told_and_nothing_is_lost(scene, name):
    good = waves(scene)
    scene.crowd_lod.terrain_object = good
    populated(scene)
    kept = scene.crowd_lod.terrain_mesh
    groups = len(scene.crowd_lod.groups)
    scene.crowd_lod.terrain_object = None
    change, told = WRONG[name]
    change(scene)
    with pytest.raises(RuntimeError, match=told):
        bpy.ops.crowd_lod.populate()
    assert (
        scene.crowd_lod.terrain_mesh == kept
        and len(scene.crowd_lod.groups) == groups
        and ours() == [kept]
    )


def test_before_populate_the_crowd_says_so(scene):
    populated(scene)
    scene.crowd_lod.terrain_object = waves(scene)
    with pytest.raises(
        kept_meshes.CrowdError, match="The terrain Waves is not read yet: press Populate"
    ):
        scene_crowd.trajectory_of(scene)
