"""Draws a Drawing of draw_data.py on the GPU.

The target is the viewport, or any framebuffer with any view.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from ...crowd_lod.animation.skinning import SkinnedMesh, axes
from ...crowd_lod.crowd.agents import Group
from ..blender.color_space import encoded
from . import shader_programs
from .draw_data import Drawing
from .skinned_characters import Character

if TYPE_CHECKING:
    from gpu.types import Buffer, GPUBatch, GPUTexture

POINT_PIXELS = 4.0, 14.0  # least and greatest width of a visible agent's point
LINE_PIXELS = 1.5
BEHIND_ALL = (
    1e-6  # part of the depth's range, behind all else, that lines beyond the clip end lie in
)
NEAREST_LINE = 0.005  # of the viewport's clip start, from which on they are drawn
TEXEL = 16  # bytes
WIDEST = 16384  # texels, of a texture on every GPU
MOST_SKINNED = 32e6  # bytes of a LOD's skinned frames
KEY = np.array([-0.4, 0.55, 0.75])  # towards the key light, in the viewer's space


class Cast:
    """The characters on the GPU: everything that stays the same from frame to frame.

    Like all code below, it needs a GPU context.

    characters: one per group, or () to draw boxes.
    nbytes: bytes of the characters' arrays and of the textures of skinned frames; boxes are not
        counted.
    """

    def __init__(self, groups: tuple[Group, ...], characters: tuple[Character, ...]):
        arrays = [
            each
            for character in characters
            for mesh in character.meshes
            for each in vars(mesh).values()
        ]
        arrays += [
            each for character in characters for each in (character.frames, character.images)
        ]
        self.characters = characters
        self.boxes = [_batch(*_box(group)) for group in groups] if not characters else []
        self.joints = [_joint_texture(character.frames) for character in characters]
        self.images = [_images(character.images) for character in characters]
        self.skinned = [
            [_skinned_frames(mesh, len(character.frames), joints) for mesh in character.meshes]
            for character, joints in zip(characters, self.joints, strict=True)
        ]
        self.meshes = [
            [
                _mesh_batch(mesh, frames is None)
                for mesh, frames in zip(character.meshes, skinned, strict=True)
            ]
            for character, skinned in zip(characters, self.skinned, strict=True)
        ]
        skinned = sum(
            TEXEL * each.width * each.height for levels in self.skinned for each in levels if each
        )
        self.nbytes = skinned + sum(each.nbytes for each in arrays if isinstance(each, np.ndarray))

    def kind(self, level: int, group: int) -> str:
        """Return the kind (shader_programs.mesh_interface) that draws the group's LOD."""
        if not self.characters:
            return "RIGID"
        return "JOINTS" if self.skinned[group][level] is None else "FRAMES"

    def bind(self, shader, level: int, group: int, action: str = "") -> None:
        """Bind the joint texture or skinned frames that pose the group's LOD to `shader`.

        shader: a program with shader_programs.mesh_interface of the same kind().
        action: the name of the action that is shown; "" for the group's own.
        """
        if self.kind(level, group) == "JOINTS":
            shader.uniform_sampler("joint_frames", self.joints[group])
        else:
            shader.uniform_sampler("skinned_frames", self.skinned[group][level])
        first, count = self.characters[group].rows_of(action)
        shader.uniform_int("first_frame", first)
        shader.uniform_int("frame_count", count)


class Batches:
    """A Drawing uploaded to the GPU.

    nbytes: bytes of the Drawing's arrays.
    """

    def __init__(self, drawing: Drawing, cast: Cast | None = None, before: "Batches | None" = None):
        """Upload the Drawing `drawing`.

        cast: the characters or boxes to instance; None draws points and lines alone.
        before: an earlier Batches; every texture or batch whose arrays are equal is reused from it.
        """
        from gpu.types import Buffer, GPUUniformBuf

        self.origin = drawing.origin
        self.diameter = drawing.diameter
        self.cast = cast
        self.draws = drawing.draws if cast is not None else ()
        self.materials = drawing.materials
        self.plays = drawing.plays or ("",) * len(drawing.draws)
        self.fading = drawing.fading
        self.nbytes = drawing.nbytes
        self._made: dict[str, tuple] = {}
        if self.draws:
            self.agents = self._make(
                "agents", before, _agent_texture, drawing.agents, np.array(drawing.turn)
            )
            self.palette = self._make("palette", before, _palette_texture, drawing.palette)
            self.view = GPUUniformBuf(Buffer("FLOAT", 20))
        self.points = self._make(
            "points", before, _point_batch, drawing.positions, drawing.colors, drawing.sizes
        )
        self.lines = self._make("lines", before, _line_batch, drawing.lines, drawing.line_colors)

    def _make(
        self, name: str, before: "Batches | None", make: Callable, *arrays: np.ndarray
    ) -> Any:
        """Return make(*arrays), or the result of `before` if its arrays are equal."""
        known, made = before._made.get(name, ((), None)) if before is not None else ((), None)
        if len(known) != len(arrays) or not all(map(np.array_equal, known, arrays)):
            made = make(*arrays)
        self._made[name] = arrays, made
        return made


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
    with _gpu_state():
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
    """Return the `projection` (4, 4) without an end: all that it shows lies behind what the
    viewport has drawn.

    With it a frustum that reaches beyond the viewport's clip end is drawn whole, where nothing is
    in front.
    """
    lens = np.array(projection, np.float64)
    # the last term keeps what is behind the viewer away
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
    with _gpu_state():
        gpu.state.depth_test_set("ALWAYS")
        shader.bind()
        shader.uniform_sampler("depths", depths)
        _batch({"position": np.array([(-1, -1), (3, -1), (-1, 3)], np.float32)}).draw(shader)


def _paint_meshes(batches: Batches, matrix: np.ndarray, view: np.ndarray) -> None:
    """Draw each LOD and group with one instanced draw, the finest LOD first."""
    import gpu

    cast = batches.cast
    bound = None
    batches.view.update(view_buffer(matrix, view))
    materials = batches.materials and bool(cast.characters)
    for (level, group, first, count), action in zip(batches.draws, batches.plays, strict=False):
        batch = cast.meshes[group][level] if cast.characters else cast.boxes[group]
        if batch is None:
            continue
        kind = cast.kind(level, group)
        if kind != bound:
            shader = shader_programs.meshes(kind, materials, batches.fading)
            bound = kind
            shader.bind()
            shader.uniform_block("view", batches.view)
            shader.uniform_sampler("agents", batches.agents)
            if not materials:
                shader.uniform_sampler("palette", batches.palette)
        if cast.characters:
            cast.bind(shader, level, group, action)
        else:
            shader.uniform_int("count", count)
        if materials:
            shader.uniform_sampler("images", cast.images[group])
        closed = not cast.characters or cast.characters[group].meshes[level].closed
        gpu.state.face_culling_set("BACK" if closed else "NONE")
        shader.uniform_int("base", first)
        instances = count if cast.characters else -(-count // shader_programs.BOXES)
        batch.draw_instanced(shader, instance_start=0, instance_count=instances)
    gpu.state.face_culling_set("NONE")


def view_buffer(matrix: np.ndarray, view: np.ndarray) -> "Buffer":
    """Return the values that change with the view, as the shaders' CrowdView.

    matrix, view: (4, 4), from the drawing's origin to clip space, and world to viewer's space.
    """
    from gpu.types import Buffer

    key = view[:3, :3].T @ KEY
    values = np.zeros(20, np.float32)
    values[:16] = matrix.T.ravel()
    values[16:19] = key / np.linalg.norm(key)
    return Buffer("FLOAT", 20, values)


@contextmanager
def _gpu_state() -> Iterator[None]:
    """Enable depth test, alpha blending and point sizes; restore at the end."""
    import gpu

    depth_test = gpu.state.depth_test_get()
    depth_mask = gpu.state.depth_mask_get()
    blend = gpu.state.blend_get()
    try:
        gpu.state.depth_test_set("LESS_EQUAL")
        gpu.state.depth_mask_set(True)
        gpu.state.blend_set("ALPHA")
        gpu.state.program_point_size_set(True)
        yield
    finally:
        gpu.state.program_point_size_set(False)
        gpu.state.blend_set(blend)
        gpu.state.depth_mask_set(depth_mask)
        gpu.state.depth_test_set(depth_test)


def _texture(texels: np.ndarray) -> "GPUTexture":
    """Return a texture of texels (height, width, 4) float32."""
    from gpu.types import Buffer, GPUTexture

    height, width, _ = texels.shape
    values = np.ascontiguousarray(texels, np.float32).ravel()
    return GPUTexture((width, height), format="RGBA32F", data=Buffer("FLOAT", values.size, values))


def _palette_texture(palette: np.ndarray) -> "GPUTexture":
    """Return a texture with one row of colors (p, 4) float32."""
    return _texture(palette[None])


def _point_batch(positions: np.ndarray, colors: np.ndarray, sizes: np.ndarray) -> "GPUBatch | None":
    """Return the batch of a Drawing's points, or None without points."""
    columns = {"position": positions, "color": colors, "size": sizes}
    return _batch(columns, None, "POINTS") if len(positions) else None


def _line_batch(lines: np.ndarray, colors: np.ndarray) -> "GPUBatch | None":
    """Return the batch of a Drawing's lines, or None without lines."""
    from gpu_extras.batch import batch_for_shader

    columns = {"pos": lines.reshape(-1, 3), "color": encoded(colors).reshape(-1, 4)}
    return batch_for_shader(shader_programs.lines(), "LINES", columns) if len(lines) else None


def _agent_texture(agents: np.ndarray, turn: np.ndarray) -> "GPUTexture":
    """Return the texture of instances, three texels each.

    The texels hold what every vertex would compute again: the axes, position, phase, look and
    scale. Texels follow one another, shader_programs.TEXELS to a row.

    agents: (m, 8) or (m, 9) float32, of a Drawing.
    turn: () radians, of a Drawing.
    """
    m = len(agents)
    (heading, phase, look, pitch, roll, *scale) = agents.T[3:]
    rows = -(-3 * m // shader_programs.TEXELS)
    texels = np.zeros((rows * shader_programs.TEXELS, 4), np.float32)
    one, two, three = (texels[k : 3 * m : 3] for k in range(3))
    one[:, :3] = agents[:, :3]
    one[:, 3] = phase
    two[:, 3] = look
    three[:, 3] = scale[0] if scale else 1.0
    two[:, :3], three[:, :3] = axes(heading, pitch, roll, float(turn))
    return _texture(texels.reshape(rows, shader_programs.TEXELS, 4))


def _joint_texture(frames: np.ndarray) -> "GPUTexture":
    """Return a texture with a row per frame and three texels per joint.

    frames: (F, J, 3, 4) float32.
    """
    return _texture(frames.reshape(len(frames), -1, 4))


def _skinned_frames(mesh: SkinnedMesh, frames: int, joints) -> "GPUTexture | None":
    """Return a texture of the mesh skinned at every frame, or None.

    A row per frame, a texel per vertex: its position and its packed normal, skinned on the GPU.
    None if the mesh has no triangles or is too large (WIDEST, MOST_SKINNED); a mesh that is too
    large is skinned again in each draw.

    frames: number of frames.
    joints: the texture of joint frames.
    """
    import gpu
    from gpu.types import GPUFrameBuffer, GPUTexture

    size = len(mesh.points), frames
    if not len(mesh.triangles) or size[0] > WIDEST or TEXEL * size[0] * size[1] > MOST_SKINNED:
        return None
    texture = GPUTexture(size, format="RGBA32F")
    shader = shader_programs.skin()
    with GPUFrameBuffer(color_slots=texture).bind(), _gpu_state():
        gpu.state.depth_test_set("NONE")
        gpu.state.blend_set("NONE")
        shader.bind()
        shader.uniform_sampler("joint_frames", joints)
        shader.uniform_float("size", size)
        _batch(_jointed(mesh), None, "POINTS").draw_instanced(
            shader, instance_start=0, instance_count=frames
        )
    return texture


def _images(pictures: np.ndarray) -> "GPUTexture":
    """Return an array texture of pictures; one white texel if there are none.

    pictures: (n, size, size, 4) uint8.
    """
    from gpu.types import Buffer, GPUTexture

    if not len(pictures):
        pictures = np.full((1, 1, 1, 4), 255, np.uint8)
    values = np.ascontiguousarray(pictures, np.float32).ravel() / np.float32(255)
    layers, height, width, _ = pictures.shape
    texture = GPUTexture(
        (width, height), layers=layers, format="RGBA8", data=Buffer("FLOAT", values.size, values)
    )
    texture.filter_mode(True)
    texture.extend_mode("REPEAT")
    return texture


def _mesh_batch(mesh: SkinnedMesh, joints: bool) -> "GPUBatch | None":
    """Return the batch of a LOD mesh, or None without triangles.

    joints: whether the draw skins the mesh, so that the batch needs positions, normals, joints and
        weights.
    """
    columns = {"uv": mesh.uvs, "base_color": mesh.colors, "layer": mesh.layers} | (
        _jointed(mesh) if joints else {}
    )
    return _batch(columns, mesh.triangles) if len(mesh.triangles) else None


def _jointed(mesh: SkinnedMesh) -> dict[str, np.ndarray]:
    """Return the vertex attributes of kind JOINTS (shader_programs.mesh_interface)."""
    return {
        "position": mesh.points,
        "normal": mesh.normals,
        "joints": mesh.joints,
        "weights": mesh.weights,
    }


def _batch(
    columns: dict[str, np.ndarray], triangles: np.ndarray | None = None, kind: str = "TRIS"
) -> "GPUBatch":
    """Return a batch with one vertex attribute per column.

    columns: name to values (n,) or (n, k), float32 or uint16.
    triangles: vertex indices, or None for a batch without an index buffer.
    kind: GPU primitive type.
    """
    from gpu.types import GPUBatch, GPUIndexBuf, GPUVertBuf, GPUVertFormat

    form = GPUVertFormat()
    for name, values in columns.items():
        whole = values.dtype == np.uint16
        form.attr_add(
            id=name,
            comp_type="U16" if whole else "F32",
            len=values[0].size,
            fetch_mode="INT" if whole else "FLOAT",
        )
    buffer = GPUVertBuf(format=form, len=len(next(iter(columns.values()))))
    for name, values in columns.items():
        buffer.attr_fill(name, np.ascontiguousarray(values))
    if triangles is None:
        return GPUBatch(type=kind, buf=buffer)
    return GPUBatch(
        type=kind,
        buf=buffer,
        elem=GPUIndexBuf(type=kind, seq=np.ascontiguousarray(triangles, np.uint32)),
    )


def _box(group: Group) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return (columns, triangles) of a run of BOXES boxes inscribed in the group's bounding sphere.

    A box stands on the ground: eight vertices, no floor, smooth normals. They are drawn in runs
    because an instance so small costs more than its triangles.
    """
    half = np.sqrt(max(group.radius**2 - group.center**2, (0.2 * group.radius) ** 2) / 2)
    corners = np.array([(x, y, z) for z in (0, 1) for y in (-1, 1) for x in (-1, 1)], np.float32)
    normals = corners * (1, 1, 2) - (0, 0, 0.5)
    triangles = [
        (0, 1, 5),
        (0, 5, 4),
        (1, 3, 7),
        (1, 7, 5),
        (3, 2, 6),
        (3, 6, 7),
        (2, 0, 4),
        (2, 4, 6),
        (4, 5, 7),
        (4, 7, 6),
    ]
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    points = (corners * (half, half, 2 * group.center)).astype(np.float32)
    run = shader_programs.BOXES
    runs = (np.arange(run)[:, None, None] * len(corners) + triangles).reshape(-1, 3)
    return {
        "position": np.tile(points, (run, 1)),
        "normal": np.tile(normals, (run, 1)),
    }, runs.astype(np.uint32)
