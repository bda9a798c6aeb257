"""The whole pipeline, drawn into a picture without a window.

By the overlay's own way from plan to pixels.
"""

from dataclasses import replace

import bpy  # noqa: F401  bmesh and gpu come with it
import numpy as np
from crowd_lod_extension.crowd_lod.animation.skinning import SkinnedMesh
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.culling.camera import Camera
from crowd_lod_extension.crowd_lod.frame.frame import Frame, cost, plan, tally
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.sorting.buckets import sort
from crowd_lod_extension.crowd_lod.sources.trajectory import Trajectory
from crowd_lod_extension.operators.viewport.draw_data import Style, drawing
from crowd_lod_extension.operators.viewport.gpu_batches import Batches, GpuBodies
from crowd_lod_extension.operators.viewport.gpu_draw import paint
from crowd_lod_extension.operators.viewport.skinned_characters import SkinnedCharacter

SIZE = 900, 900  # the chapter's viewport
JOINTS = 20
FRAMES = 24


def figure(vertices: int, group: Group) -> SkinnedMesh:
    """A person's worth of vertices on an ellipsoid, each moved by four joints."""
    import bmesh

    k = np.arange(vertices) + 0.5
    turn = k * np.pi * (3 - 5**0.5)
    high = 1 - 2 * k / vertices
    unit = np.column_stack(
        [np.cos(turn) * np.sqrt(1 - high**2), np.sin(turn) * np.sqrt(1 - high**2), high]
    )
    points = (unit * (0.25, 0.25, group.center) + (0, 0, group.center)).astype(np.float32)
    hull = bmesh.new()
    for point in points:
        hull.verts.new(point)
    bmesh.ops.convex_hull(hull, input=hull.verts)
    hull.verts.index_update()
    triangles = np.array(
        [[vertex.index for vertex in face.verts] for face in hull.faces], np.uint32
    )
    hull.free()
    near = np.clip((high[:, None] + 1) / 2 * JOINTS + (-1, 0, 1, 2), 0, JOINTS - 1).astype(
        np.uint16
    )
    weights = np.full((vertices, 4), 0.25, np.float32)
    gray = np.full((vertices, 3), 0.5, np.float32)
    none = np.full(vertices, -1, np.float32)
    return SkinnedMesh(
        points,
        triangles,
        unit.astype(np.float32),
        near,
        weights,
        np.zeros((vertices, 2), np.float32),
        gray,
        none,
        True,
    )


class Screen:
    """A picture that the crowd is drawn into."""

    def __init__(self, group: Group):
        import gpu

        joints = np.tile(np.eye(3, 4, dtype=np.float32), (FRAMES, JOINTS, 1, 1))
        meshes = tuple(figure(vertices, group) for vertices in group.vertices)
        images = np.empty((0, 1, 1, 4), np.uint8)
        self.bodies = GpuBodies(
            (group,),
            (SkinnedCharacter("person", joints, meshes, images, np.full(3, 0.5), 0.0, None),),
        )
        self.canvas = gpu.types.GPUOffScreen(*SIZE, format="RGBA8")

    def __call__(self, frame: Frame) -> np.ndarray:
        """Draw the frame and wait for it.

        Returns the picture (height, width, 4) uint8, bottom row first.
        """
        import gpu

        what = drawing(frame, Style("MESHES", culled=False))
        batches = Batches(
            replace(what, lines=what.lines[:0], line_colors=what.line_colors[:0]), self.bodies
        )
        with self.canvas.bind():
            buffer = gpu.state.active_framebuffer_get()
            buffer.clear(color=(0, 0, 0, 1), depth=1.0)
            paint(batches, *matrices(frame.camera), SIZE, 1.0)
            pixels = buffer.read_color(0, 0, *SIZE, 4, 0, "UBYTE")
        return np.asarray(memoryview(pixels)).reshape(SIZE[1], SIZE[0], 4)

    def free(self) -> None:
        self.canvas.free()


def matrices(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(view, projection), (4, 4) each, of a perspective camera."""
    view = np.eye(4)
    projection = np.zeros((4, 4))
    w = camera.window
    view[:3, :3] = camera.X, camera.Y, -camera.Z
    view[:3, 3] = -view[:3, :3] @ camera.origin
    across = w.right - w.left
    up = w.top - w.bottom
    deep = camera.far - camera.near
    projection[0, 0] = 2 / across
    projection[0, 2] = (w.right + w.left) / across
    projection[1, 1] = 2 / up
    projection[1, 2] = (w.top + w.bottom) / up
    projection[2, 2] = -(camera.far + camera.near) / deep
    projection[2, 3] = -2 * camera.far * camera.near / deep
    projection[3, 2] = -1
    return view, projection


def planned(
    trajectory: Trajectory,
    camera: Camera,
    policy: LevelPolicy,
    time: float,
    lods: bool,
    culling: bool,
) -> Frame:
    """The plan, or what is left of it without LODs or without culling.

    Without LODs all have the finest; without culling all are drawn.
    """
    frame = plan(trajectory, camera, policy if lods else replace(policy, thresholds=()), time)
    if culling:
        return frame
    buckets = sort(np.ones(len(frame.crowd), bool), frame.levels, len(frame.buckets.counts))
    counted = tally(frame.crowd, buckets, len(trajectory.groups))
    vertices, _ = cost(counted, [group.vertices for group in trajectory.groups])
    return replace(frame, buckets=buckets, vertices=vertices)
