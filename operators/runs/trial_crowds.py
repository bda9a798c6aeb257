"""Small crowds that *Calibrate* renders: people on open ground, in a scene of their own."""

from dataclasses import dataclass

import bpy
import numpy as np

from ...crowd_lod.culling.coverage import covered_pixels
from ...crowd_lod.levels.cost_model import Work
from ...sample_scenes.characters import BUILDS, make_characters
from ...sample_scenes.scenery import add, aim, camera, child, film, material, tile
from ..blender import mesh_data, scene_data
from ..blender.cameras import read_cameras
from ..render_setup.nodes.instances import instances

ROOM = 1.5  # square meters of ground for each agent
WIDENING = 0.3  # of the part of the ground that the camera sees, on either side
FRAME = 7  # that is rendered


@dataclass(frozen=True)
class TrialCrowd:
    """A crowd to render.

    finer: steps of subdivision of a character beyond the samples', each with four times the faces;
        from -1 on.
    characters: how many are posed, each by a rig of its own.
    visible: how many of these agents show.
    agents: how many there are.
    nearest: meters from the camera to the first agent.
    split: whether the corners of faces have normals of their own, as LODs have.
    """

    finer: int
    characters: int
    visible: int
    agents: int
    nearest: float = 4.0
    split: bool = False


def make_stage(scene: bpy.types.Scene, width: int) -> bpy.types.Scene:
    """Return a new scene of empty ground, to be rendered by the engine and device of `scene`.

    width: of the picture, pixels.
    """
    stage = bpy.data.scenes.new(".Crowd LOD calibration")
    film(stage)
    ground = tile(-3000, -3000, 3000, 3000, -0.02)
    add(stage.collection, "Ground", [(ground, material("Ground", (0.5, 0.5, 0.48)))])
    stage.camera = camera(stage, "Camera", near=0.1, far=5000.0)
    aim(stage.camera, (0, 0, 3), (100, 0, -0.5))
    render = stage.render
    render.engine = scene_data.BLENDER_ENGINES[scene_data.engine_of(scene)]
    if render.engine == "CYCLES":
        stage.cycles.device = scene.cycles.device
        stage.cycles.max_bounces = scene.cycles.max_bounces
        stage.cycles.use_adaptive_sampling = False
        stage.cycles.use_denoising = False
    render.resolution_x = width
    render.resolution_y = round(width * 9 / 16)
    stage.frame_set(FRAME)
    return stage


def show_crowd(stage: bpy.types.Scene, crowd: TrialCrowd) -> Work:
    """Put the crowd into the scene; return the work of a render of it, with one sample a pixel."""
    library = child(stage, "Crowd LOD calibration", hidden=True)
    library.hide_render = library.hide_viewport = True
    shelf = bpy.data.collections.new("Characters")
    library.children.link(shelf)
    body = _make_cast(shelf, crowd)
    places = _places_of(crowd)
    _instance(stage, shelf, places, np.arange(crowd.agents) % crowd.visible)
    mesh = body.data
    triangles = len(mesh.loops) - 2 * len(mesh.polygons)
    box = np.array(body.bound_box)
    centers = np.column_stack([places, np.full(len(places), box[:, 2].mean())])
    radius = np.full(len(places), np.linalg.norm(np.ptp(box, axis=0)) / 2)
    layer = stage.view_layers[0]
    layer.update()
    (camera,) = read_cameras(stage, layer.depsgraph)
    unique = float(min(crowd.visible, crowd.agents) * triangles)
    return Work(
        posed=float(crowd.characters * triangles),
        unique=unique,
        split=unique * crowd.split,
        instances=float(crowd.agents),
        instanced=float(crowd.agents * triangles),
        rigs=float(crowd.characters),
        rays=covered_pixels(camera, (centers - camera.origin).T, radius),
    )


def _make_cast(shelf: bpy.types.Collection, crowd: TrialCrowd) -> bpy.types.Object:
    """Put the crowd's characters into `shelf`, a collection each; return the first one's body.

    They share one mesh and one action, and each has a rig of its own.
    """
    (home,) = make_characters(shelf, builds=BUILDS[:1], finer=crowd.finer)
    home.name = "0000"
    rig, body = home.objects
    if crowd.split:
        normals = [vertex.normal for vertex in body.data.vertices]
        body.data.normals_split_custom_set_from_vertices(normals)
    for number in range(1, crowd.characters):
        home = bpy.data.collections.new(f"{number:04d}")
        shelf.children.link(home)
        own_rig = rig.copy()
        own_body = body.copy()
        own_body.parent = own_rig
        own_body.modifiers[0].object = own_rig
        for item in (own_rig, own_body):
            home.objects.link(item)
    return body


def _places_of(crowd: TrialCrowd) -> np.ndarray:
    """Return where the agents stand, (n, 2) float64 meters: on the ground that the camera sees."""
    random = np.random.default_rng(0)
    area = crowd.agents * ROOM
    farthest = np.sqrt(area / WIDENING + crowd.nearest**2)
    depth = np.sqrt(random.uniform(crowd.nearest**2, farthest**2, crowd.agents))
    return np.stack([depth, depth * random.uniform(-WIDENING, WIDENING, crowd.agents)], axis=1)


def _instance(
    stage: bpy.types.Scene, shelf: bpy.types.Collection, places: np.ndarray, poses: np.ndarray
) -> None:
    """Instance the characters of `shelf` at `places` (n, 2); poses: (n,), which of them each is."""
    mesh = bpy.data.meshes.new("Crowd LOD calibration")
    positions = np.zeros((len(places), 3), np.float32)
    positions[:, :2] = places
    mesh_data.write_points(mesh, {"position": positions, "pose": poses.astype(np.int32)})
    points = bpy.data.objects.new("Crowd LOD calibration", mesh)
    stage.collection.objects.link(points)
    modifier = points.modifiers.new("Crowd LOD", "NODES")
    modifier.node_group = instances()
    scene_data.set_node_input(modifier, "Characters", shelf)
