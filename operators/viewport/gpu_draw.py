"""Draws a Drawing of draw_data.py on the GPU.

The target is the viewport, or any framebuffer with any view.
"""

from typing import TYPE_CHECKING

import numpy as np

from . import shader_programs
from .gpu_batches import Batches, batch_of, drawing_state

if TYPE_CHECKING:
    from gpu.types import Buffer

POINT_PIXELS = 4.0, 14.0  # least and greatest width of a visible agent's point
LINE_PIXELS = 1.5
# Lines beyond the viewport's clip end are drawn in this last part of the depth's range.
BEHIND_ALL = 1e-6
NEAREST_LINE = 0.005  # of the viewport's clip start; nearer lines are not drawn
KEY = np.array([-0.4, 0.55, 0.75])  # towards the key light, in the viewer's space


def paint(
    batches: Batches,
    view: np.ndarray,
    projection: np.ndarray,
    size: tuple[int, int],
    ui_scale: float,
) -> None:
    """Draw into the active framebuffer.

    view: (4, 4) float64, world to viewer's space.
    projection: (4, 4) float64, viewer's space to OpenGL's clip space.
    size: width and height of the framebuffer in pixels.
    ui_scale: pixels of this screen per nominal pixel of POINT_PIXELS and LINE_PIXELS.
    """
    import gpu
    from mathutils import Matrix

    view = np.array(view, np.float64)
    view[:3, 3] += view[:3, :3] @ batches.origin
    matrix = projection @ view
    with drawing_state():
        if batches.draws:
            gpu.state.blend_set("NONE")
            _paint_meshes(batches, matrix, view)
            gpu.state.blend_set("ALPHA")
        if batches.points is not None:
            shader = shader_programs.points()
            shader.bind()
            shader.uniform_float("matrix", Matrix(matrix.tolist()))
            shader.uniform_float("pixels_per_meter", float(projection[1, 1] * size[1] / 2))
            shader.uniform_float("diameter", batches.diameter)
            shader.uniform_float("bounds", [pixels * ui_scale for pixels in POINT_PIXELS])
            batches.points.draw(shader)
        if batches.lines is not None:
            for lens in (np.array(projection, np.float64), _farther(projection)):
                _paint_lines(batches, view, lens, size, ui_scale)


def _paint_lines(
    batches: Batches,
    view: np.ndarray,
    projection: np.ndarray,
    size: tuple[int, int],
    ui_scale: float,
) -> None:
    import gpu
    from mathutils import Matrix

    shader = shader_programs.lines()
    with gpu.matrix.push_pop(), gpu.matrix.push_pop_projection():
        gpu.matrix.load_matrix(Matrix(view.tolist()))
        gpu.matrix.load_projection_matrix(Matrix(projection.tolist()))
        shader.bind()
        shader.uniform_float("viewportSize", size)
        shader.uniform_float("lineWidth", LINE_PIXELS * ui_scale)
        batches.lines.draw(shader)


def _farther(projection: np.ndarray) -> np.ndarray:
    """Return the `projection` (4, 4) without a clip end, at depths behind all that is drawn.

    So the lines of a frustum that reaches beyond the viewport's clip end are drawn as well, where
    nothing hides them.
    """
    lens = np.array(projection, np.float64)
    # the last term clips what is behind the viewer
    lens[2] = (1 - BEHIND_ALL) * lens[3] + (0, 0, 0, lens[2, 3] * NEAREST_LINE * (lens[3, 3] == 0))
    return lens


def put_depth(depth, size: tuple[int, int]) -> None:
    """Fill the depth of the active framebuffer with depths read from another one.

    depth: a Buffer of depths.
    size: width and height of the framebuffer in pixels.
    """
    import gpu
    from gpu.types import GPUTexture

    shader = shader_programs.depth()
    depths = GPUTexture(size, format="R32F", data=depth)
    with drawing_state():
        gpu.state.depth_test_set("ALWAYS")
        shader.bind()
        shader.uniform_sampler("depths", depths)
        batch_of({"position": np.array([(-1, -1), (3, -1), (-1, 3)], np.float32)}).draw(shader)


def _paint_meshes(batches: Batches, matrix: np.ndarray, view: np.ndarray) -> None:
    """Draw each LOD and group with one instanced draw, the finest LOD first."""
    import gpu

    bodies = batches.bodies
    bound_kind = None
    batches.view.update(view_buffer(matrix, view))
    materials = batches.materials and bool(bodies.characters)
    for (level, group, first, count), action in zip(batches.draws, batches.plays, strict=False):
        batch = bodies.meshes[group][level] if bodies.characters else bodies.boxes[group]
        if batch is None:
            continue
        kind = bodies.kind(level, group)
        if kind != bound_kind:
            shader = shader_programs.meshes(kind, materials)
            bound_kind = kind
            shader.bind()
            shader.uniform_block("view", batches.view)
            shader.uniform_sampler("agents", batches.agents)
            shader.uniform_sampler("palette", batches.palette)
        if bodies.characters:
            bodies.bind(shader, level, group, action)
        else:
            shader.uniform_int("count", count)
        if materials:
            shader.uniform_sampler("images", bodies.images[group])
        closed = not bodies.characters or bodies.characters[group].meshes[level].closed
        gpu.state.face_culling_set("BACK" if closed else "NONE")
        shader.uniform_int("base", first)
        instances = count if bodies.characters else -(-count // shader_programs.BOXES)
        batch.draw_instanced(shader, instance_start=0, instance_count=instances)
    gpu.state.face_culling_set("NONE")


def view_buffer(matrix: np.ndarray, view: np.ndarray) -> "Buffer":
    """Return the values that change with the view, as the shaders' CrowdView.

    matrix: (4, 4), from the drawing's space to clip space.
    view: (4, 4), from the drawing's space to the viewer's.
    """
    from gpu.types import Buffer

    key = view[:3, :3].T @ KEY
    values = np.zeros(20, np.float32)
    values[:16] = matrix.T.ravel()
    values[16:19] = key / np.linalg.norm(key)
    return Buffer("FLOAT", 20, values)
