import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.blender.materials import switch_nodes_on
from crowd_lod_extension.operators.build import render_setup, shelves
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd, trajectory_of
from mathutils import Vector

from ..support.built import instances
from ..support.scene_frames import frame_now


def points(scene):
    """Of each LOD its points' attributes and positions, as bytes."""
    places = {}
    for item in (item for item in scene.crowd_lod.build.objects if item.visible_camera):
        mesh = item.data
        columns = {}
        for name, kind, width in (
            ("position", np.float32, 3),
            ("heading", np.float32, 1),
            ("id", np.int32, 1),
        ):
            values = np.empty((len(mesh.vertices), width), kind)
            if name in mesh.attributes:
                mesh.attributes[name].data.foreach_get(
                    "vector" if width == 3 else "value", values.ravel()
                )
            columns[name] = values.tobytes()
        places[item[shelves.LEVEL]] = columns
    return places


def test_instances_stand_where_the_plan_says_as_the_mesh_it_says(built):
    for time in (1, 17, 33):
        built.frame_set(time)
        frame = frame_now(built, bpy.context.evaluated_depsgraph_get())
        assert 0 < frame.visible.sum() < len(frame.crowd) and (frame.buckets.counts > 0).sum() >= 2
        groups = {g.name: i for i, g in enumerate(trajectory_of(built).groups)}
        shown = {level: [] for level in range(3)}
        for level, item, matrix in instances(built):
            group = next(i for name, i in groups.items() if item.name.startswith(name))
            assert f"LOD {level} " in item.name
            shown[level].append((*matrix[:3, 3], matrix[0, 0], matrix[1, 0], group))
        c = frame.crowd
        for level in range(3):
            b = frame.buckets[level]
            planned = np.stack(
                [c.x[b], c.y[b], c.z[b], np.cos(c.heading[b]), np.sin(c.heading[b]), c.group[b]],
                axis=1,
            )
            found = np.array(shown[level]).reshape(-1, 6)
            found, planned = (each[np.lexsort(each[:, :3].round(3).T)] for each in (found, planned))
            np.testing.assert_allclose(found[:, :5], planned[:, :5], atol=1e-5)
            np.testing.assert_array_equal(found[:, 5], planned[:, 5])


def test_points_are_a_pure_function_of_frame_and_sub_frame(built):
    for blur in (False, True):
        built.render.use_motion_blur = blur
        first = {}
        for time in (30.0, 2.0, 11.25, 11.0, 10.75, 39.5, 11.25, 2.0, 10.75, 30.0, 11.0):
            built.frame_set(int(time), subframe=time % 1)
            now = points(built)
            assert first.setdefault(time, now) == now, time


def test_buckets_stand_still_while_the_shutter_is_open_and_agents_move(built):
    built.render.use_motion_blur = True
    shown = {}
    for time in (10.75, 11.0, 11.25):
        built.frame_set(int(time), subframe=time % 1)
        shown[time] = points(built)
    for level in range(3):
        assert len({shown[time][level]["id"] for time in shown}) == 1
    assert shown[10.75][0]["position"] != shown[11.25][0]["position"]
    built.render.use_motion_blur = False
    ids = set()
    for time in range(1, 40):
        built.frame_set(time)
        ids.add(points(built)[0]["id"])
    assert len(ids) > 10  # while from frame to frame they do change


def test_an_agents_looks_are_its_own_at_every_time_in_every_lod(built):
    looks = {}
    levels = {}
    for time in (1, 30, 12):
        built.frame_set(time)
        for item in built.crowd_lod.build.objects:
            ids = np.empty(len(item.data.vertices), np.int32)
            values = np.empty(len(item.data.vertices), np.float32)
            item.data.attributes["id"].data.foreach_get("value", ids)
            item.data.attributes["looks"].data.foreach_get("value", values)
            for agent, value in zip(ids.tolist(), values.tolist(), strict=True):
                assert looks.setdefault(agent, value) == value and 0 <= value < 1
                levels.setdefault(agent, set()).add(item[shelves.LEVEL])
    assert max(map(len, levels.values())) > 1  # some changed their LOD
    assert (
        len(set(looks.values())) > 0.99 * len(looks) and 0.4 < np.mean(list(looks.values())) < 0.6
    )


def colored_by_looks(material, colors):
    """Let `material` glow in one of `colors` (n, 3), by an image of n pixels that the agent's looks
    choose from.
    """
    image = bpy.data.images.new("choices", len(colors), 1, float_buffer=True)
    image.pixels.foreach_set(np.float32([(*color, 1) for color in colors]).ravel())
    tree = switch_nodes_on(material)
    tree.nodes.clear()
    looks, place, texture, glow, end = (
        tree.nodes.new(f"ShaderNode{kind}")
        for kind in ("Attribute", "CombineXYZ", "TexImage", "Emission", "OutputMaterial")
    )
    looks.attribute_type = "INSTANCER"
    looks.attribute_name = "looks"
    texture.image = image
    texture.interpolation = "Closest"
    texture.extension = "EXTEND"
    ends = (
        (looks.outputs["Fac"], place.inputs["X"]),
        (place.outputs[0], texture.inputs[0]),
        (texture.outputs[0], glow.inputs[0]),
    )
    for pair in (*ends, (glow.outputs[0], end.inputs[0])):
        tree.links.new(*pair)


def test_a_material_picks_from_an_image_by_the_agents_looks(built, tmp_path):
    colors = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0)])
    for material in bpy.data.materials:
        colored_by_looks(material, colors)
    built.render.engine = "CYCLES"
    built.cycles.samples = 1
    built.view_settings.view_transform = "Raw"
    built.cycles.use_denoising = False
    built.render.dither_intensity = 0
    built.render.filepath = str(tmp_path / "looks.png")
    built.frame_set(12)
    plan = frame_now(built, bpy.context.evaluated_depsgraph_get())
    bpy.ops.render.render(write_still=True)
    pixels = (
        np.array(bpy.data.images.load(built.render.filepath).pixels)
        .reshape(90, 160, 4)[..., :3]
        .round(2)
    )
    shown = pixels[pixels.any(axis=2)]
    assert (shown[:, None] == colors).all(axis=2).any(axis=1).all() and len(
        np.unique(shown, axis=0)
    ) == 4
    agents = plan.buckets.order
    x, y, z = plan.crowd.places(plan.trajectory.spheres.center, agents)
    seen = [
        world_to_camera_view(built, built.camera, Vector(place))
        for place in zip(x, y, z, strict=True)
    ]
    k = min(
        (each.z, k) for k, each in enumerate(seen) if 0.1 < each.x < 0.9 and 0.1 < each.y < 0.9
    )[1]
    looks = float(plan.trajectory.looks[agents[k]])
    assert (
        pixels[int(90 * seen[k].y), int(160 * seen[k].x)] == colors[int(4 * looks)]
    ).all()  # the nearest, whom none hides


@pytest.mark.parametrize("blur", [False, True])
def test_headless_animation_renders_show_each_frame_at_its_place(built, tmp_path, blur):
    """One agent, rendered by Cycles from the moving camera: its pixels lie where Blender projects
    it.
    """
    built.crowd_lod.count = 1
    built.crowd_lod.size = (4, 4)
    built.render.engine = "CYCLES"
    built.cycles.samples = 4
    built.cycles.use_denoising = False
    built.render.film_transparent = True
    built.render.use_motion_blur = blur
    built.render.image_settings.color_mode = "RGBA"
    built.frame_start = 5
    built.frame_end = 25
    built.frame_step = 10
    built.render.filepath = str(tmp_path / "f_")
    bpy.ops.render.render(animation=True)
    found = 0
    for number in (5, 15, 25):
        alpha = image_data.load_pixels(tmp_path / f"f_{number:04d}.png")[..., 3]
        built.frame_set(number)
        frame = frame_now(built, bpy.context.evaluated_depsgraph_get())
        c = frame.crowd
        middle = Vector((c.x[0], c.y[0], trajectory_of(built).groups[c.group[0]].center))
        u, v, _ = world_to_camera_view(built, built.camera, middle)
        if not (0.1 < u < 0.9 and 0.1 < v < 0.9):
            continue
        found += 1
        rows, columns = np.nonzero(alpha > 100)
        assert len(rows) > 10
        assert abs((columns.min() + columns.max()) / 2 - u * 160) < 4
        assert abs((rows.min() + rows.max()) / 2 - v * 90) < 4
    assert found >= 2


def test_a_build_without_its_camera_shows_nobody_and_says_why(built, capfd):
    assert sum(1 for _ in instances(built))
    built.camera = None
    built.frame_set(3)
    assert sum(1 for _ in instances(built)) == 0
    assert "no active camera" in capfd.readouterr().err


def test_build_before_levels_is_refused(scene):
    bpy.ops.crowd_lod.populate()
    with pytest.raises(CrowdError, match="Make LOD Meshes"):
        list(render_setup.build(read_crowd(scene)))
    assert scene.crowd_lod.build is None


@pytest.mark.once
@pytest.mark.usefixtures("rough_lods")
def test_a_build_that_lacks_a_lod_shows_nobody_and_says_what_to_press(built, capfd):
    built.crowd_lod.level_count = 4
    built.frame_set(2)
    assert sum(1 for _ in instances(built)) == 0
    assert "press Make LOD Meshes and Build again" in capfd.readouterr().err
    list(make_levels(built))
    built.frame_set(3)
    assert "press Build again" in capfd.readouterr().err
    list(render_setup.build(read_crowd(built)))
    built.frame_set(4)
    assert sum(1 for _ in instances(built)) > 0


@pytest.mark.once
@pytest.mark.usefixtures("rough_lods")
def test_levels_made_anew_ask_for_a_new_build(built, capfd):
    built.crowd_lod.ratios[1] = 0.2
    list(make_levels(built))
    built.frame_set(2)
    assert sum(1 for _ in instances(built)) == 0
    assert "have changed since its build was made: press Build again" in capfd.readouterr().err
    list(render_setup.build(read_crowd(built)))
    built.frame_set(3)
    middle = {
        item.data.name: len(item.data.polygons) for level, item, _ in instances(built) if level == 1
    }
    whole = {
        item.name: len(item.data.polygons)
        for home in built.crowd_lod.levels.children[0].children
        for item in home.objects
    }
    for name, count in middle.items():
        assert count == pytest.approx(0.2 * 2 * whole[name.split(" LOD")[0] + " LOD 0"], rel=0.05)
