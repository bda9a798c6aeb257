"""A Drawing of draw_data.py and its characters as textures and vertex batches on the GPU.

All of it needs a GPU context.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from ...crowd_lod.animation.skinning import SkinnedMesh, axes
from ...crowd_lod.crowd.agents import Group
from ..blender.colors import to_srgb
from . import shader_programs
from .draw_data import Drawing
from .skinned_characters import SkinnedCharacter

if TYPE_CHECKING:
    from gpu.types import GPUBatch, GPUTexture

TEXEL = 16  # bytes
WIDEST = 16384  # texels, of a texture on every GPU
MOST_SKINNED = 32e6  # bytes of a LOD's skinned frames


class GpuBodies:
    """The characters on the GPU: everything that stays the same from frame to frame.

    characters: one per group, or () to draw boxes.
    """

    def __init__(self, groups: tuple[Group, ...], characters: tuple[SkinnedCharacter, ...]):
        self.characters = characters
        self.boxes = [batch_of(*_box(group)) for group in groups] if not characters else []
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
    """A Drawing uploaded to the GPU."""

    def __init__(
        self, drawing: Drawing, bodies: GpuBodies | None = None, before: "Batches | None" = None
    ):
        """Upload the Drawing `drawing`.

        bodies: the characters or boxes to instance; None draws points and lines alone.
        before: an earlier Batches; every texture or batch whose arrays are equal is reused from it.
        """
        from gpu.types import Buffer, GPUUniformBuf

        self.origin = drawing.origin
        self.diameter = drawing.diameter
        self.bodies = bodies
        self.draws = drawing.draws if bodies is not None else ()
        self.materials = drawing.materials
        self.plays = drawing.plays or ("",) * len(drawing.draws)
        self._uploads: dict[str, tuple] = {}
        if self.draws:
            self.agents = self._upload(
                "agents", before, _agent_texture, drawing.agents, np.array(drawing.turn)
            )
            self.palette = self._upload("palette", before, _palette_texture, drawing.palette)
            self.view = GPUUniformBuf(Buffer("FLOAT", 20))
        self.points = self._upload(
            "points", before, _point_batch, drawing.positions, drawing.colors, drawing.sizes
        )
        self.lines = self._upload("lines", before, _line_batch, drawing.lines, drawing.line_colors)

    def _upload(
        self, name: str, before: "Batches | None", make: Callable, *arrays: np.ndarray
    ) -> Any:
        """Return make(*arrays), or the result of `before` if its arrays are equal."""
        uploads = before._uploads if before is not None else {}
        earlier_arrays, upload = uploads.get(name, ((), None))
        if len(earlier_arrays) != len(arrays) or not all(
            map(np.array_equal, earlier_arrays, arrays)
        ):
            upload = make(*arrays)
        self._uploads[name] = arrays, upload
        return upload


@contextmanager
def drawing_state() -> Iterator[None]:
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
    return batch_of(columns, None, "POINTS") if len(positions) else None


def _line_batch(lines: np.ndarray, colors: np.ndarray) -> "GPUBatch | None":
    """Return the batch of a Drawing's lines, or None without lines."""
    from gpu_extras.batch import batch_for_shader

    columns = {"pos": lines.reshape(-1, 3), "color": to_srgb(colors).reshape(-1, 4)}
    return batch_for_shader(shader_programs.lines(), "LINES", columns) if len(lines) else None


def _agent_texture(agents: np.ndarray, turn: np.ndarray) -> "GPUTexture":
    """Return the texture of instances, three texels each, shader_programs.TEXELS to a row.

    The texels hold what each vertex would have to compute anew: axes, position, phase, color and
    scale.

    agents: (m, 8) or (m, 9) float32, of a Drawing.
    turn: () radians, of a Drawing.
    """
    m = len(agents)
    (heading, phase, color, pitch, roll, *scale) = agents.T[3:]
    rows = -(-3 * m // shader_programs.TEXELS)
    texels = np.zeros((rows * shader_programs.TEXELS, 4), np.float32)
    first, second, third = (texels[k : 3 * m : 3] for k in range(3))
    first[:, :3] = agents[:, :3]
    first[:, 3] = phase
    second[:, 3] = color
    third[:, 3] = scale[0] if scale else 1.0
    second[:, :3], third[:, :3] = axes(heading, pitch, roll, float(turn))
    return _texture(texels.reshape(rows, shader_programs.TEXELS, 4))


def _joint_texture(frames: np.ndarray) -> "GPUTexture":
    """Return a texture with a row per frame and three texels per joint.

    frames: (F, J, 3, 4) float32.
    """
    return _texture(frames.reshape(len(frames), -1, 4))


def _skinned_frames(mesh: SkinnedMesh, frames: int, joints) -> "GPUTexture | None":
    """Return a texture of the mesh skinned at every frame, or None.

    A row is a frame, a texel a vertex: its position and its packed normal, skinned on the GPU.
    None if the mesh has no triangles, or is too large (WIDEST, MOST_SKINNED). A mesh that is too
    large is skinned in each draw instead.

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
    with GPUFrameBuffer(color_slots=texture).bind(), drawing_state():
        gpu.state.depth_test_set("NONE")
        gpu.state.blend_set("NONE")
        shader.bind()
        shader.uniform_sampler("joint_frames", joints)
        shader.uniform_float("size", size)
        batch_of(_jointed(mesh), None, "POINTS").draw_instanced(
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
    return batch_of(columns, mesh.triangles) if len(mesh.triangles) else None


def _jointed(mesh: SkinnedMesh) -> dict[str, np.ndarray]:
    """Return the vertex attributes of kind JOINTS (shader_programs.mesh_interface)."""
    return {
        "position": mesh.points,
        "normal": mesh.normals,
        "joints": mesh.joints,
        "weights": mesh.weights,
    }


def batch_of(
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

    A box stands on the ground: eight vertices, no floor, smooth normals. Boxes are drawn in runs
    because so small an instance costs more than its triangles.
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
