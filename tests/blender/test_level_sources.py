"""Characters as users have them: what LOD meshes are made from, and that it stays as it was."""

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators.blender import mesh_data
from crowd_lod_extension.operators.lods import candidates
from crowd_lod_extension.operators.lods.make_lods import make_levels

from ..support.characters import character, new, rig, rigged, tube
from ..support.objects import collection, mesh_of

pytestmark = pytest.mark.usefixtures("rough_lods")


def make_lods(k=1):
    """The objects of LOD 1 by name, of as many triangles as LOD `k` has by default."""
    settings = bpy.context.scene.crowd_lod
    settings.level_count = 2
    settings.ratios[1] = settings.ratios[k]
    list(make_levels(bpy.context.scene))
    return {item.name: item for item in settings.levels.children[1].all_objects}


def world(item):
    """Its vertices where they are drawn, as an instance draws them."""
    scene = bpy.context.scene
    if item.name not in scene.collection.objects:
        scene.collection.objects.link(item)
    return mesh_data.world_points(item.evaluated_get(bpy.context.evaluated_depsgraph_get()))


def test_curves_and_text_become_meshes_where_they_stand_with_their_own_materials():
    curve = bpy.data.curves.new("wire", "CURVE")
    curve.dimensions = "3D"
    curve.bevel_depth = 0.1
    spline = curve.splines.new("POLY")
    spline.points.add(20)
    for i, point in enumerate(spline.points):
        point.co = (np.sin(i), 0, i / 10, 1)
    curve.materials.append(bpy.data.materials.new("shared"))
    wire = new("wire", curve)
    wire.scale = (-1, 1, 1)
    wire.location = (3, 0, 0)
    wire.material_slots[0].link = "OBJECT"
    wire.material_slots[0].material = bpy.data.materials.new("own")
    text = bpy.data.curves.new("sign", "FONT")
    text.body = "Hello"
    text.extrude = 0.1
    character(wire, new("sign", text))
    lods = make_lods()
    assert [material.name for material in lods["wire LOD 1"].data.materials] == ["own"]
    low = world(lods["wire LOD 1"]).min(axis=0)
    high = world(lods["wire LOD 1"]).max(axis=0)
    bpy.context.scene.collection.objects.link(wire)
    full = world(wire)
    assert np.allclose(low, full.min(axis=0), atol=0.06) and np.allclose(
        high, full.max(axis=0), atol=0.06
    )
    assert (
        0
        < mesh_data.count_triangles(lods["sign LOD 1"].data)
        < 0.45 * bpy.context.scene.crowd_lod.groups[0].triangles[0]
    )


@pytest.mark.parametrize(
    "kind, says",
    [
        ("metaball", "mine, of the character group someone, is a metaball: turn it into a mesh"),
        (
            "instance",
            "mine, of the character group someone, instances the collection inner: put that "
            "collection",
        ),
        ("no faces", "someone in People holds no mesh with faces"),
        ("hair", "has no faces"),
        ("nan", "at NaN or infinity"),
    ],
)
def test_what_cannot_be_one_sentence_names_it_and_nothing_is_left(kind, says):
    if kind == "metaball":
        item = new("mine", bpy.data.metaballs.new("mine"))
    elif kind == "instance":
        item = new("mine", None)
        item.instance_type = "COLLECTION"
        item.instance_collection = bpy.data.collections.new("inner")
    elif kind == "hair":
        item = new("mine", bpy.data.hair_curves.new("mine"))
        item.data.add_curves([4])
    else:
        item = new("mine", tube("mine") if kind == "nan" else bpy.data.meshes.new("mine"))
    if kind == "nan":
        item.data.vertices[3].co.x = float("nan")
    character(item, *([new("body", tube("body"))] if kind in ("metaball", "instance") else []))
    before = {block: (block.name, block.users) for block in bpy.data.user_map()}
    with pytest.raises(CrowdError, match=says):
        make_lods()
    assert {block: (block.name, block.users) for block in bpy.data.user_map()} == before
    assert bpy.context.scene.crowd_lod.levels is None


def test_an_object_without_faces_among_others_and_hair_are_kept_whole():
    hair = new("hair", bpy.data.hair_curves.new("hair"))
    hair.data.add_curves([4, 4])
    character(new("guide", bpy.data.meshes.new("guide")), hair, new("body", tube("body")))
    lods = make_lods(2)
    assert lods["hair LOD 1"].data is hair.data and set(lods) == {
        "guide LOD 1",
        "hair LOD 1",
        "body LOD 1",
    }


def test_what_is_hidden_in_renders_and_the_shapes_of_bones_are_left_out():
    armature = rig()
    widget, cage, body = (new(name, tube(name, 12, 12)) for name in ("widget", "cage", "body"))
    armature.pose.bones["upper"].custom_shape = widget
    cage.hide_render = True
    body.hide_viewport = True  # is working comfort; its modifier counts all the same
    body.modifiers.new("Subdivision", "SUBSURF").levels = 1
    group = character(armature, body, cage, widget)
    extras = collection("extras", new("extra", tube("extra")), within=group)
    extras.hide_render = True
    lods = make_lods()
    assert set(lods) == {"body LOD 1"}
    assert mesh_data.count_triangles(lods["body LOD 1"].data) == pytest.approx(
        0.4 * 4 * 2 * 12 * 12, rel=0.03
    )


def test_nested_collections_shared_meshes_and_props_on_bones_follow_the_bone():
    body, armature = rigged("body", 12, 12)
    left, right = (
        new(name, bpy.data.meshes.get("club") or tube("club", 12, 8, 0.05, 0.5))
        for name in ("left", "right")
    )
    group = character(armature, body)
    props = collection("props", within=group)
    for side, prop in ((-1, left), (1, right)):
        props.objects.link(prop)
        prop.parent = armature
        prop.parent_type = "BONE"
        prop.parent_bone = "upper"
        prop.location = (0.4 * side, 0, 0)
        prop.scale = (side, 1, 1)
    lods = make_lods(2)
    assert set(lods) == {"body LOD 1", "left LOD 1", "right LOD 1"}
    assert left.data.users == 4  # the two, and the two of LOD 0
    scene = bpy.context.scene
    for frame in (1, 10):
        scene.frame_set(frame)
        for prop in (left, right):
            fine = world(prop)
            coarse = world(lods[f"{prop.name} LOD 1"])
            assert np.allclose(coarse.min(axis=0), fine.min(axis=0), atol=0.02)
            assert np.allclose(coarse.max(axis=0), fine.max(axis=0), atol=0.02)
    assert (
        world(left).max(axis=0)[1] < -0.3 or world(left).min(axis=0)[1] < -0.3
    )  # it did move with the bone


@pytest.mark.parametrize("mode", ["EDIT", "POSE"])
def test_modes_selection_and_names_stay(mode):
    scene = bpy.context.scene
    body, armature = rigged("body", 8, 8)
    character(armature, body)
    active = armature if mode == "POSE" else body
    bpy.context.view_layer.objects.active = active
    active.select_set(True)
    if mode == "EDIT":
        body.data.vertices[0].co.x = 0.25
    bpy.ops.object.mode_set(mode=mode)
    # names that LODs would like to have
    mine = bpy.data.objects.new("body LOD 1", None)
    names = {block: block.name for block in bpy.data.user_map()}
    make_lods(), make_lods()
    assert {block: block.name for block in names} == names and mine.name == "body LOD 1"
    assert bpy.context.view_layer.objects.active is active and active.mode == mode
    assert [item.name for item in bpy.context.view_layer.objects if item.select_get()] == [
        active.name
    ]
    assert len(scene.crowd_lod.levels.children[1].all_objects) == 1
    bpy.ops.object.mode_set(mode="OBJECT")


@pytest.mark.once
@pytest.mark.parametrize("override", [False, True])
def test_characters_linked_from_another_file(tmp_path, override):
    body, armature = rigged("body", 12, 12)
    body.modifiers.new("Subdivision", "SUBSURF").render_levels = 1
    character(armature, body, name="linked")
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {bpy.data.collections["linked"]}, fake_user=True)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.collections = ["linked"]
    scene = bpy.context.scene
    group = wanted.collections[0]
    top = collection("People")
    top.children.link(group)
    if override:
        group = group.override_hierarchy_create(scene, bpy.context.view_layer)
        top.children.unlink(bpy.data.collections["linked", path])
        if group.name not in top.children:
            top.children.link(group)
    scene.crowd_lod.characters = top
    scene.crowd_lod.choice = "BY_DISTANCE"
    states = {block: (block.name, block.library) for block in bpy.data.user_map()}
    lod = make_lods(2)["body LOD 1"]
    assert (
        lod.library is None
        and lod.override_library is None
        and mesh_data.count_triangles(lod.data) < 0.13 * scene.crowd_lod.groups[0].triangles[0]
    )
    assert {block: (block.name, block.library) for block in states} == states
    scene.frame_set(10)
    source = next(item for item in group.objects if item.type == "MESH")
    fine, coarse = (world(item) for item in (source, lod))
    assert np.allclose(coarse.min(axis=0), fine.min(axis=0), atol=0.05) and fine[:, 1].min() < -0.3


def test_a_missing_library_is_named(tmp_path):
    character(new("body", tube("body")), name="linked")
    path = tmp_path / "library.blend"
    bpy.data.libraries.write(str(path), {bpy.data.collections["linked"]}, fake_user=True)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(path), link=True) as (_, wanted):
        wanted.collections = ["linked"]
    top = collection("People")
    top.children.link(wanted.collections[0])
    bpy.context.scene.crowd_lod.characters = top
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    path.unlink()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    with pytest.raises(
        CrowdError,
        match=r"linked, of the character group linked, is missing: restore .*library\.blend",
    ):
        make_lods()


def test_one_triangle_and_two_hundred_loose_parts():
    one = mesh_of("one", [(0, 0, 0), (1, 0, 0), (0, 0, 1)], [(0, 1, 2)])
    points = []
    faces = []
    for i in range(200):
        corner = np.array((0.1 * (i % 20), 0, 0.1 * (i // 20)))
        points += [
            tuple(corner + offset)
            for offset in ((0, 0, 0), (0.05, 0, 0), (0, 0.05, 0), (0, 0, 0.05))
        ]
        faces += [
            tuple(4 * i + j for j in face) for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
        ]
    parts = mesh_of("parts", points, faces)
    character(new("one", one), new("parts", parts))
    lods = make_lods()
    assert mesh_data.count_triangles(lods["one LOD 1"].data) == 1
    found = mesh_data.read_mesh(lods["parts LOD 1"].data).triangles
    assert len(np.unique(np.sort(found, axis=1), axis=0)) == len(found) >= 200  # none twice


def test_of_less_than_a_face_one_is_left(monkeypatch):
    """Hair cards, of which a LOD by ratio would keep a third of a triangle."""
    monkeypatch.setattr(candidates, "UNMEASURED_LEAST", 0)
    points = []
    faces = []
    for i in range(60):
        x = 0.1 * np.cos(i)
        y = 0.1 * np.sin(2 * i)
        points += [(x, y, 1.8), (x + 0.03, y, 1.8), (x + 0.03, y, 1.6), (x, y, 1.6)]
        faces.append(tuple(range(4 * i, 4 * i + 4)))
    cards = mesh_of("cards", points, faces)
    character(new("cards", cards), new("body", tube("body")))
    settings = bpy.context.scene.crowd_lod
    settings.ratios[1] = 0.005
    settings.ratios[2] = 0.002
    assert mesh_data.count_triangles(make_lods()["cards LOD 1"].data) >= 1


def test_a_stray_face_without_area_costs_no_lod_its_likeness():
    body = tube("body", 12, 12)
    points = [tuple(v.co) for v in body.vertices]
    faces = [tuple(p.vertices) for p in body.polygons]
    at = len(points)
    points += [(5, 0, 2), (6, 0, 2), (7, 0, 2), (8, 8, 8), (8, 8, 8), (8, 8, 8)]
    stray = mesh_of("stray", points, [*faces, (at, at + 1, at + 2), (at + 3, at + 4, at + 5)])
    character(new("stray", stray))
    lod = make_lods()["stray LOD 1"]
    assert np.abs(mesh_data.read_mesh(lod.data).points[:, :2]).max() < 0.25
    assert bpy.context.scene.crowd_lod.groups[0].deviations[1] < 0.05
