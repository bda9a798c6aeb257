"""Whom the culling drops, no render shows: of every way to film, the dropped spheres alone are
rendered by Cycles, and the picture is black. That it can show them is seen with spheres that are
dropped by their centers."""

from dataclasses import replace

import addon_utils
import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.culling.radar import radar
from crowd_lod_extension.crowd_lod.validation.exact_frustum import standing_crowd
from crowd_lod_extension.operators.blender import cameras, image_data
from crowd_lod_extension.operators.blender.materials import switch_nodes_on
from mathutils import Matrix

from ..support.objects import filmed_from, mesh_of, placed

SPHERES = 80
BALL = np.array(
    [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z],
    np.float64,
)
BALL /= np.linalg.norm(BALL, axis=1, keepdims=True)


@pytest.fixture
def scene():
    """A camera above and beside the origin, in a small picture."""
    addon_utils.enable("cycles")
    scene = bpy.context.scene
    filmed_from((3, -2, 5), (1.1, 0.2, 0.7))
    render = scene.render
    render.engine = "CYCLES"
    render.resolution_x = 36
    render.resolution_y = 22
    render.resolution_percentage = 100
    render.image_settings.file_format = "PNG"
    render.image_settings.color_mode = "RGB"
    scene.view_settings.view_transform = "Raw"
    scene.world = None
    render.dither_intensity = 0
    cycles = scene.cycles
    cycles.samples = 24
    cycles.device = "CPU"
    cycles.use_denoising = False
    cycles.max_bounces = 0
    cycles.use_adaptive_sampling = False
    return scene


@pytest.fixture
def lit(scene, tmp_path):
    """(points (n, 3), radius (n,)) -> how many pixels show the spheres, over all of the picture's
    views.
    """
    glow = bpy.data.materials.new("glow")
    nodes = switch_nodes_on(glow).nodes
    light = nodes.new("ShaderNodeEmission")
    light.inputs["Strength"].default_value = 1e5
    glow.node_tree.links.new(
        light.outputs[0], next(n for n in nodes if n.type == "OUTPUT_MATERIAL").inputs[0]
    )
    faces = [tuple(np.argsort(np.linalg.norm(BALL - corner, axis=1))[:3]) for corner in BALL]

    def count(points, radius):
        corners = (points[:, None] + radius[:, None, None] * BALL).reshape(-1, 3)
        every = [
            tuple(int(k) + len(BALL) * n for k in face)
            for n in range(len(points))
            for face in faces
        ]
        mesh = mesh_of("balls", corners, every)
        mesh.materials.append(glow)
        placed("balls", mesh)
        for path in tmp_path.glob("*.png"):
            path.unlink()
        scene.render.filepath = str(tmp_path / "view.png")
        bpy.ops.render.render(write_still=True)
        bpy.data.meshes.remove(mesh)
        pictures = list(tmp_path.glob("*.png"))
        assert len(pictures) == (2 if scene.render.use_multiview else 1)
        return sum(
            int((image_data.load_pixels(path)[..., :3] > 0).any(axis=2).sum()) for path in pictures
        )

    return count


def scattered(eye, random):
    """(points (n, 3), radius (n,)): spheres about the edges of what the camera `eye` sees, of its
    near and far end, too.
    """
    depth = 10.0 ** random.uniform(
        np.log10(max(eye.near / 2, 1e-2)), np.log10(min(eye.far * 1.3, 1e5)), SPHERES
    )
    if eye.kind == "PANO":
        way = random.normal(size=(SPHERES, 3))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        ends = np.where(
            random.random(SPHERES) < 0.5,
            eye.near * random.uniform(0.6, 1.1),
            eye.far * random.uniform(0.9, 1.4, SPHERES),
        )
        depth = np.where(random.random(SPHERES) < 0.5, ends, depth)
        return eye.origin + depth[:, None] * way, depth * 10.0 ** random.uniform(
            -1.5, -0.5, SPHERES
        )
    w = eye.window
    across = 1.0 if eye.kind == "ORTHO" else depth
    x, y = random.uniform(-0.4, 1.4, (2, SPHERES))
    edge = random.random(SPHERES)  # half of them within a few pixels of an edge
    x = np.where(edge < 0.25, np.where(x < 0.5, 0, 1) + random.uniform(-0.1, 0.1, SPHERES), x)
    y = np.where(edge > 0.75, np.where(y < 0.5, 0, 1) + random.uniform(-0.1, 0.1, SPHERES), y)
    at = np.stack(
        [
            (w.left + x * (w.right - w.left)) * across,
            (w.bottom + y * (w.top - w.bottom)) * across,
            depth,
        ],
        axis=1,
    )
    points = eye.origin + at @ np.linalg.inv(np.array([eye.X, eye.Y, eye.Z])).T
    return points, (w.right - w.left) * across * 10.0 ** random.uniform(-2.5, -0.7, SPHERES)


def plain(scene):
    pass


def orthographic(scene):
    scene.camera.data.type = "ORTHO"
    scene.camera.data.ortho_scale = 9
    scene.camera.data.shift_y = 0.3


def shifted(scene):
    scene.camera.data.shift_x = 0.7
    scene.camera.data.shift_y = -0.9
    scene.camera.data.lens = 18


def fit(kind, width, height):
    def set_up(scene):
        data = scene.camera.data
        data.sensor_fit = kind
        data.sensor_width = 20
        data.sensor_height = 35
        scene.render.resolution_x = width
        scene.render.resolution_y = height

    return set_up


def pixel_aspect(scene):
    scene.render.pixel_aspect_x = 1
    scene.render.pixel_aspect_y = 1.9


def below(matrix):
    def set_up(scene):
        parent = placed("Parent")
        parent.matrix_world, scene.camera.parent = matrix, parent

    return set_up


def linked(scene):
    """The camera is another file's."""
    path = bpy.app.tempdir + "eyes.blend"
    scene.camera.data.lens = 24
    bpy.data.libraries.write(path, {scene.camera})
    bpy.data.objects.remove(scene.camera)
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.objects = ["Camera"]
    scene.camera = wanted.objects[0]
    scene.collection.objects.link(scene.camera)


def constrained(scene):
    """It looks at one thing and is carried by another."""
    target, carrier = (bpy.data.objects.new(name, None) for name in ("target", "carrier"))
    target.location = (-4, 6, 1)
    carrier.location = (2, 1, 3)
    carrier.scale = (1, 2, 0.5)
    for item in (target, carrier):
        scene.collection.objects.link(item)
    scene.camera.constraints.new("CHILD_OF").target = carrier
    tracks = scene.camera.constraints.new("TRACK_TO")
    tracks.target = target
    tracks.track_axis = "TRACK_NEGATIVE_Z"
    tracks.up_axis = "UP_Y"


def two_eyes(mode, pivot):
    def set_up(scene):
        scene.render.use_multiview = True
        scene.render.image_settings.views_format = "INDIVIDUAL"
        eyes = scene.camera.data.stereo
        eyes.convergence_mode = mode
        eyes.pivot = pivot
        eyes.interocular_distance = 2.0
        eyes.convergence_distance = 4.0

    return set_up


def spherical(scene):
    two_eyes("OFFAXIS", "CENTER")(scene)
    panorama("EQUIRECTANGULAR")(scene)
    stereo = scene.camera.data.stereo
    stereo.use_spherical_stereo = True
    stereo.interocular_distance = 0.2


def two_cameras(scene):
    scene.camera.name = "Eye_L"
    other = bpy.data.objects.new("Eye_R", scene.camera.data.copy())
    other.location = (-4, 1, 2)
    other.rotation_euler = (1.3, 0, -0.9)
    other.data.lens = 22
    scene.collection.objects.link(other)
    scene.render.use_multiview = True
    scene.render.views_format = "MULTIVIEW"
    scene.render.image_settings.views_format = "INDIVIDUAL"


def panorama(kind):
    def set_up(scene):
        data = scene.camera.data
        data.type = "PANO"
        data.panorama_type = kind
        data.fisheye_fov = 2.4
        data.clip_start = 0.5
        data.clip_end = 40
        data.fisheye_polynomial_k1 = -0.06
        scene.render.resolution_y = 36

    return set_up


def clipped(start, end):
    def set_up(scene):
        scene.camera.data.clip_start = start
        scene.camera.data.clip_end = end

    return set_up


def open_lens(scene):
    dof = scene.camera.data.dof
    dof.use_dof = True
    dof.aperture_fstop = 0.2
    dof.focus_distance = 3.0
    dof.aperture_ratio = 0.5


def filtered(kind, width):
    def set_up(scene):
        scene.cycles.pixel_filter_type = kind
        scene.cycles.filter_width = width
        scene.cycles.samples = 200

    return set_up


WAYS = {
    "perspective": plain,
    "orthographic": orthographic,
    "shifted": shifted,
    "fit auto, upright": fit("AUTO", 20, 36),
    "fit horizontal, upright": fit("HORIZONTAL", 20, 36),
    "fit vertical, wide": fit("VERTICAL", 36, 20),
    "pixel aspect": pixel_aspect,
    "scaled": below(Matrix.Scale(0.01, 4)),
    "mirrored": below(Matrix.Diagonal((-2, 1, 1, 1))),
    "sheared": below(Matrix.Diagonal((2, 0.6, 1.2, 1)) @ Matrix.Rotation(0.5, 4, "X")),
    "linked": linked,
    "constrained": constrained,
    **{
        f"stereo {m} {p}": two_eyes(m, p)
        for m in ("OFFAXIS", "PARALLEL", "TOE")
        for p in ("LEFT", "RIGHT", "CENTER")
    },
    "spherical stereo": spherical,
    "two cameras": two_cameras,
    "near": clipped(1e-6, 1.0),
    "far": clipped(2.0, 1e9),
    "near and far": clipped(1e-6, 1e9),
    "thin": clipped(5.0, 5.5),
    "depth of field": open_lens,
    "box": filtered("BOX", 1.5),
    "Gaussian": filtered("GAUSSIAN", 4.0),
    "Blackman-Harris": filtered("BLACKMAN_HARRIS", 10.0),
}
PANORAMAS = (
    "EQUIRECTANGULAR EQUIANGULAR_CUBEMAP_FACE MIRRORBALL FISHEYE_EQUIDISTANT FISHEYE_EQUISOLID "
    "FISHEYE_LENS_POLYNOMIAL "
    "CENTRAL_CYLINDRICAL"
).split()


def judged(scene, lit, seed):
    """(pixels that show dropped spheres, pixels that show those dropped by their centers, how many
    are dropped and kept).
    """
    scene.view_layers[0].update()
    eyes = cameras.read_cameras(scene, scene.view_layers[0].depsgraph)
    random = np.random.default_rng(seed)
    spheres = [scattered(eye, random) for eye in eyes]
    points = np.concatenate([p for p, _ in spheres])
    radius = np.concatenate([r for _, r in spheres])
    points = points.astype(np.float32).astype(np.float64)
    crowd = standing_crowd(points, np.arange(len(points)))
    seen, _ = radar(crowd, eyes, np.zeros(len(points)), radius)
    pinholes = [replace(eye, pad=0.0, turn=0.0) for eye in eyes]
    center_seen, _ = radar(crowd, pinholes, np.zeros(len(points)), np.zeros(len(points)))
    touching = seen & ~center_seen
    return (
        lit(points[~seen], radius[~seen]),
        lit(points[touching], radius[touching]),
        int((~seen).sum()),
        int(seen.sum()),
    )


@pytest.mark.parametrize("way", WAYS)
def test_nobody_who_is_seen_is_culled(scene, lit, way):
    WAYS[way](scene)
    missed, touching, dropped, kept = judged(scene, lit, len(way))
    assert missed == 0 < touching and min(dropped, kept) > 3


@pytest.mark.parametrize("kind", PANORAMAS)
def test_no_panorama_misses_anybody(scene, lit, kind):
    panorama(kind)(scene)
    missed, touching, dropped, kept = judged(scene, lit, len(kind))
    assert missed == 0 < touching and min(dropped, kept) > 3
