"""Cameras as Blender itself projects and renders them, against the culling."""

import os

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from crowd_lod_extension.crowd_lod.culling.camera import frustum_corners
from crowd_lod_extension.crowd_lod.culling.radar import radar
from crowd_lod_extension.crowd_lod.validation.exact_frustum import standing_crowd
from crowd_lod_extension.operators.blender import cameras, image_data
from crowd_lod_extension.operators.blender.materials import switch_nodes_on
from mathutils import Euler, Matrix, Vector

from ..support.objects import filmed_from, mesh_of, placed

FULL = bool(os.environ.get("CROWD_LOD_FULL"))
CAMERAS, AGENTS = (250, 2000) if FULL else (12, 500)
KINDS = ("PERSP", "ORTHO", "sheared", "stereo")


class Asked(bpy.types.RenderEngine):
    """A render engine that renders nothing, and asks Blender for each eye's matrix and shift."""

    bl_idname = "CROWD_LOD_ASKED"
    bl_label = "Asked"
    answers = {}

    def render(self, depsgraph):
        for view in depsgraph.scene.render.views:
            self.active_view_set(view.name)
            camera = self.camera_override
            self.answers[view.name] = (
                np.array(self.camera_model_matrix(camera)),
                self.camera_shift_x(camera),
            )


@pytest.fixture
def scene():
    """An empty scene with a camera."""
    bpy.utils.register_class(Asked)
    scene = bpy.context.scene
    filmed_from((0, 0, 0))
    yield scene
    bpy.utils.unregister_class(Asked)


def depsgraph_of(scene):
    scene.view_layers[0].update()
    return scene.view_layers[0].depsgraph


def shuffle(scene, random, kind):
    """Any lens, film and place of the scene's camera."""
    camera = scene.camera
    render = scene.render
    data = camera.data
    data.type = "ORTHO" if kind == "ORTHO" else "PERSP"
    data.lens = 10.0 ** random.uniform(0.3, 2.5)
    data.ortho_scale = 10.0 ** random.uniform(0, 2)
    data.sensor_width, data.sensor_height = random.uniform(10, 50, 2)
    data.sensor_fit = str(random.choice(["AUTO", "HORIZONTAL", "VERTICAL"]))
    data.shift_x, data.shift_y = random.uniform(-1, 1, 2)
    data.clip_start = 10.0 ** random.uniform(-2, 0)
    data.clip_end = data.clip_start + 10.0 ** random.uniform(1, 3)
    render.resolution_x, render.resolution_y = (int(n) for n in random.integers(16, 4000, 2))
    render.resolution_percentage = int(random.integers(1, 200))
    render.pixel_aspect_x, render.pixel_aspect_y = random.uniform(1, 2, 2)
    parent = placed("Parent")
    turn = Euler(random.uniform(-3, 3, 3)).to_matrix().to_4x4()
    scale = (
        Matrix.Diagonal((*random.uniform(0.3, 3, 3), 1))
        if kind == "sheared"
        else Matrix.Scale(random.uniform(0.3, 3), 4)
    )
    mirror = Matrix.Diagonal((random.choice([-1, 1]), 1, 1, 1))
    parent.matrix_world = Matrix.Translation(random.normal(size=3) * 100) @ scale @ mirror @ turn
    camera.parent = parent
    camera.location = random.normal(size=3)
    camera.rotation_euler = random.uniform(-3, 3, 3)
    return depsgraph_of(scene)


def matrices(scene, depsgraph, side=None):
    """Blender's own (world to camera, camera to clip space), float64 (4, 4)."""
    camera = scene.camera
    render = scene.render
    model = np.array(camera.matrix_world.normalized())
    shift = camera.data.shift_x
    if side:
        model, shift = Asked.answers[side]
    own = camera.data.shift_x
    camera.data.shift_x = shift
    try:
        width, height = cameras.image_size(render)
        aspect = {"scale_x": render.pixel_aspect_x, "scale_y": render.pixel_aspect_y}
        clip = camera.calc_matrix_camera(depsgraph_of(scene), x=width, y=height, **aspect)
    finally:
        camera.data.shift_x = own
        depsgraph_of(scene)
    return np.linalg.inv(np.array(model, np.float64)), np.array(clip, np.float64)


def shows(points, view, clip):
    """(n,) bool: whether the world points (n, 3) lie within the image and clip range, by a
    float32's margin.
    """
    at = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ (clip @ view).T
    inside = np.abs(at[:, :2]).max(axis=1) < at[:, 3] * (1 - 1e-4)
    depth = at[:, 2] / np.where(at[:, 3] == 0, 1, at[:, 3])
    return inside & (np.abs(depth) < 1 - 1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_no_agent_that_blender_shows_is_missed(scene, kind):
    """A million pairs over all kinds: CROWD_LOD_FULL=1."""
    random = np.random.default_rng(len(kind))
    total = shown = kept = 0
    for _ in range(CAMERAS):
        depsgraph = shuffle(scene, random, kind)
        sides = [None]
        if kind == "stereo":
            scene.render.use_multiview = True
            scene.render.engine = Asked.bl_idname
            stereo = scene.camera.data.stereo
            stereo.convergence_mode = str(random.choice(["OFFAXIS", "PARALLEL", "TOE"]))
            stereo.pivot = str(random.choice(["LEFT", "RIGHT", "CENTER"]))
            stereo.interocular_distance, stereo.convergence_distance = random.uniform(0.1, 5, 2)
            size = (
                scene.render.resolution_x,
                scene.render.resolution_y,
                scene.render.resolution_percentage,
            )
            scene.render.resolution_x = scene.render.resolution_y = 16
            scene.render.resolution_percentage = 100
            bpy.ops.render.render(scene=scene.name)
            (
                scene.render.resolution_x,
                scene.render.resolution_y,
                scene.render.resolution_percentage,
            ) = size
            depsgraph = depsgraph_of(scene)
            sides = ["left", "right"]
        eyes = cameras.read_cameras(scene, depsgraph)
        assert len(eyes) == len(sides)
        eye = eyes[0]
        # agents about the frustum, with points on their spheres
        t = random.uniform(-0.2, 1.2, (AGENTS, 1))
        w = random.uniform(-0.5, 1.5, (AGENTS, 2))
        near = frustum_corners(eye, eye.near)
        far = frustum_corners(eye, eye.far)
        low, across, up = (near[k] + t * (far[k] - near[k]) for k in (0, 1, 3))
        points = low + w[:, :1] * (across - low) + w[:, 1:] * (up - low)
        radius = 10.0 ** random.uniform(-2, 1)
        way = random.normal(size=(AGENTS, 6, 3))
        surface = (
            points[:, None] + radius * way / np.linalg.norm(way, axis=2, keepdims=True)
        ).reshape(-1, 3)
        visible, _ = radar(standing_crowd(points), eyes, np.zeros(1), np.array([radius]))
        seen = np.zeros(AGENTS, bool)
        for side in sides:
            view, clip = matrices(scene, depsgraph, side)
            seen |= shows(points, view, clip) | shows(surface, view, clip).reshape(-1, 6).any(
                axis=1
            )
        assert not (seen & ~visible).any()
        total = total + AGENTS
        shown = shown + int(seen.sum())
        kept = kept + int(visible.sum())
        if kind == "PERSP":
            scene.render.resolution_percentage = (
                100  # world_to_camera_view knows no percentage, so no rounding to pixels
            )
            eye = cameras.read_cameras(scene, depsgraph_of(scene))[0]
            for point in points[:50]:
                x, y, depth = world_to_camera_view(scene, scene.camera, Vector(point))
                if 1e-4 < min(x, y) and max(x, y) < 1 - 1e-4 and eye.near < depth < eye.far:
                    assert radar(
                        standing_crowd(point[None]), eye, np.zeros(1), np.full(1, 1e-4 * eye.far)
                    )[0][0]
    assert 0.1 * total < shown <= kept < 0.95 * total


@pytest.mark.parametrize("kind", KINDS[:3])
def test_the_window_is_blenders(scene, kind):
    random = np.random.default_rng(20)
    for _ in range(30):
        depsgraph = shuffle(scene, random, kind)
        camera = cameras.read_cameras(scene, depsgraph)[0]
        view, clip = matrices(scene, depsgraph)
        corners = (
            np.concatenate([frustum_corners(camera, camera.far), np.ones((4, 1))], axis=1)
            @ (clip @ view).T
        )
        corners = corners[:, :3] / corners[:, 3:]
        np.testing.assert_allclose(
            corners, [(-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)], atol=2e-3
        )


@pytest.mark.parametrize("mode", ["OFFAXIS", "PARALLEL", "TOE"])
@pytest.mark.parametrize("pivot", ["LEFT", "RIGHT", "CENTER"])
def test_eyes_are_blenders(scene, mode, pivot):
    camera = scene.camera
    render = scene.render
    camera.rotation_euler = (1.0, 0.2, 0.3)
    camera.location = (1, 2, 3)
    camera.scale = (2, 0.5, 3)
    stereo = camera.data.stereo
    stereo.convergence_mode = mode
    stereo.pivot = pivot
    stereo.interocular_distance = 0.5
    stereo.convergence_distance = 3.0
    render.engine = Asked.bl_idname
    render.use_multiview = True
    render.resolution_x = render.resolution_y = 16
    bpy.ops.render.render(scene=scene.name)
    eyes = cameras.read_cameras(scene, depsgraph_of(scene))
    plain = cameras.camera_from(camera, render, depsgraph_of(scene))
    for eye, side in zip(eyes, ("left", "right"), strict=True):
        matrix, shift = Asked.answers[side]
        np.testing.assert_allclose(eye.origin, matrix[:3, 3], atol=1e-6)
        np.testing.assert_allclose(
            np.stack([eye.X, eye.Y, -eye.Z], axis=1), matrix[:3, :3], atol=1e-6
        )
        moved = (eye.window.left - plain.window.left) * camera.data.lens / camera.data.sensor_width
        assert moved == pytest.approx(shift, abs=1e-6)
    assert np.linalg.norm(eyes[0].origin - eyes[1].origin) == pytest.approx(0.5, abs=1e-6)


def test_views_with_cameras_of_their_own(scene):
    render = scene.render
    for name, x in (("Shot_L", 1.0), ("Shot_R", 2.0)):
        item = bpy.data.objects.new(name, scene.camera.data)
        item.location.x = x
        scene.collection.objects.link(item)
    scene.camera = scene.objects["Shot_L"]
    render.use_multiview = True
    render.views_format = "MULTIVIEW"
    assert [camera.origin[0] for camera in cameras.read_cameras(scene, depsgraph_of(scene))] == [
        1,
        2,
    ]
    render.views["right"].use = False
    assert [camera.origin[0] for camera in cameras.read_cameras(scene, depsgraph_of(scene))] == [1]


def lit(scene, point, folder, engine, size=(96, 64)):
    """(x, y) in parts of the image of the middle of what is lit in a render of one small bright
    ball at `point`.
    """
    corners = 0.15 * np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
    faces = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    mesh = mesh_of("ball", corners + point, faces)
    material = bpy.data.materials.new("glow")
    nodes = switch_nodes_on(material)
    glow = nodes.nodes.new("ShaderNodeEmission")
    nodes.links.new(
        glow.outputs[0], next(n for n in nodes.nodes if n.type == "OUTPUT_MATERIAL").inputs[0]
    )
    mesh.materials.append(material)
    ball = placed("ball", mesh)
    render = scene.render
    render.engine = engine
    render.film_transparent = True
    render.resolution_x, render.resolution_y, render.resolution_percentage = *size, 100
    render.image_settings.file_format = "PNG"
    render.image_settings.color_mode = "RGBA"
    render.filepath = str(folder / "picture.png")
    if engine == "CYCLES":
        scene.cycles.samples = 4
        scene.cycles.device = "CPU"
        scene.cycles.use_denoising = False
    bpy.ops.render.render(scene=scene.name, write_still=True)
    red, _, _, alpha = np.moveaxis(image_data.load_pixels(render.filepath), 2, 0)
    scene.collection.objects.unlink(ball)
    rows, columns = np.nonzero(
        (red > 50) & (alpha > 100)
    )  # beyond a fisheye's circle Cycles is black and opaque
    if not len(rows):
        return None
    return (columns.mean() + 0.5) / size[0], (rows.mean() + 0.5) / size[1]


@pytest.mark.parametrize("engine", ["BLENDER_WORKBENCH", "CYCLES"])
def test_a_sheared_mirrored_camera_renders_where_its_coordinates_say(scene, engine, tmp_path):
    if engine == "CYCLES":
        import addon_utils

        addon_utils.enable("cycles")
    parent = placed("Parent")
    parent.matrix_world = Matrix.Diagonal((-2.0, 1.0, 0.5, 1))
    scene.camera.parent = parent
    scene.camera.rotation_euler = 0.7, 0.4, 0.9
    scene.camera.data.lens = 20
    scene.render.resolution_x = 96
    scene.render.resolution_y = 64
    scene.render.resolution_percentage = 100
    camera = cameras.read_cameras(scene, depsgraph_of(scene))[0]
    assert abs(camera.X @ camera.Z) > 0.1  # sheared indeed
    point = camera.origin + np.linalg.inv([camera.X, camera.Y, camera.Z]) @ (3.0, -1.5, 8.0)
    w = camera.window
    expected = (3 / 8 - w.left) / (w.right - w.left), (-1.5 / 8 - w.bottom) / (w.top - w.bottom)
    assert lit(scene, point, tmp_path, engine) == pytest.approx(expected, abs=0.02)


def test_fisheye_shows_its_cone(scene, tmp_path):
    import addon_utils

    addon_utils.enable("cycles")
    data = scene.camera.data
    data.type = "PANO"
    data.panorama_type = "FISHEYE_EQUIDISTANT"
    data.fisheye_fov = 2.4
    camera = cameras.read_cameras(scene, depsgraph_of(scene))[0]
    assert camera.kind == "PANO" and camera.cone == pytest.approx(1.2)
    for angle, seen in ((1.1, True), (1.35, False)):
        point = np.array([0, 4 * np.sin(angle), -4 * np.cos(angle)])
        assert (lit(scene, point, tmp_path, "CYCLES") is not None) == seen
        assert (
            radar(standing_crowd(point[None]), camera, np.zeros(1), np.full(1, 0.15))[0][0] == seen
        )


def test_every_panoramic_type_has_the_density_that_cycles_renders(scene, tmp_path):
    import addon_utils

    addon_utils.enable("cycles")
    data = scene.camera.data
    size = (90, 180)
    data.type = "PANO"
    data.central_cylindrical_radius = 1.5
    scene.render.pixel_aspect_y = 2
    scene.render.resolution_x, scene.render.resolution_y = size
    for item in data.bl_rna.properties["panorama_type"].enum_items:
        data.panorama_type = item.identifier
        camera = cameras.read_cameras(scene, depsgraph_of(scene))[0]
        fisheye = item.identifier.startswith("FISHEYE")
        assert camera.cone == pytest.approx(min(np.pi, data.fisheye_fov / 2) if fisheye else np.pi)
        angle = min(20 / camera.pixels_per_unit, 0.25)
        beside = 3 * np.tan(angle)
        x, y = lit(scene, (beside, beside, -3), tmp_path, "CYCLES", size)
        seen = max((x - 0.5) * size[0], (y - 0.5) * size[1]) / angle
        assert camera.pixels_per_unit == pytest.approx(seen, rel=0.08), item.identifier


def test_depth_of_field_widens_the_view(scene):
    data = scene.camera.data
    data.dof.use_dof = True
    data.dof.aperture_fstop = 1.0
    data.lens = 100.0
    target = placed("Focus", location=(3, 0, -4))
    data.dof.focus_object = target
    camera = cameras.read_cameras(scene, depsgraph_of(scene))[0]
    assert camera.pad == pytest.approx(0.05) and camera.turn == pytest.approx(0.05 / 4)
