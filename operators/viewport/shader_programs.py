"""Shader programs, compiled on first use.

The shader bodies are files in shaders/. Their interfaces are declared here.
"""

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from ..blender.colors import BY_AGENT

if TYPE_CHECKING:
    from gpu.types import GPUShader, GPUShaderCreateInfo

SHADERS = Path(__file__).parents[2] / "shaders"
TEXELS = 4096  # in a row of the texture of instances
# boxes that an instance draws, vertices of a box
BOXES = 64
BOX_CORNERS = 8
VIEW = "struct CrowdView { mat4 matrix; vec4 key; };"


def source(*names: str) -> str:
    """Return the text of the shader files, one after the other."""
    return "\n".join((SHADERS / name).read_text(encoding="utf-8") for name in names)


def mesh_interface(kind: str, materials: bool = False) -> "GPUShaderCreateInfo":
    """Return the inputs that all programs for mesh instances share.

    For what the inputs hold, see gpu_batches.Batches.

    kind: RIGID for boxes; JOINTS for meshes skinned in the draw from joint frames; FRAMES for
        meshes skinned before at each frame of the action.
    materials: whether meshes have the colors of their materials, where these do not vary by agent,
        instead of the palette's.
    """
    info = _vertex_interface(kind)
    info.typedef_source(VIEW)
    info.define("INSTANCES", "1")
    info.define("TEXELS", str(TEXELS))
    info.uniform_buf(0, "CrowdView", "view")
    info.sampler(0, "FLOAT_2D", "agents")
    info.sampler(2, "FLOAT_2D", "palette")
    info.push_constant("INT", "base")
    if kind == "RIGID":
        info.define("BOXES", str(BOXES))
        info.define("BOX_CORNERS", str(BOX_CORNERS))
        info.push_constant("INT", "count")
    else:
        info.push_constant("INT", "first_frame")
        info.push_constant("INT", "frame_count")
    if materials:
        info.define("MATERIALS", "1")
        info.define("BY_AGENT", str(BY_AGENT))
        info.vertex_in(4, "VEC2", "uv")
        info.vertex_in(5, "VEC3", "base_color")
        info.vertex_in(6, "FLOAT", "layer")
    return info


def _vertex_interface(kind: str) -> "GPUShaderCreateInfo":
    from gpu.types import GPUShaderCreateInfo

    info = GPUShaderCreateInfo()
    info.define(kind, "1")
    if kind != "RIGID":
        info.sampler(1, "FLOAT_2D", "joint_frames" if kind == "JOINTS" else "skinned_frames")
    if kind != "FRAMES":
        info.vertex_in(0, "VEC3", "position")
        info.vertex_in(1, "VEC3", "normal")
    if kind == "JOINTS":
        info.vertex_in(2, "UVEC4", "joints")
        info.vertex_in(3, "VEC4", "weights")
    return info


def _compiled(info, name: str, *shared: str) -> "GPUShader":
    """Compile the program `name`; the `shared` files go before its vertex shader."""
    from gpu import shader

    info.vertex_source(source(*shared, f"{name}.vert.glsl"))
    info.fragment_source(source(f"{name}.frag.glsl"))
    return shader.create_from_info(info)


@cache
def meshes(kind: str, materials: bool) -> "GPUShader":
    """Return the program that draws instances of LOD meshes or of rigid boxes.

    kind, materials: see mesh_interface.
    """
    from gpu.types import GPUStageInterfaceInfo

    info = mesh_interface(kind, materials)
    between = GPUStageInterfaceInfo(f"crowd_lod_mesh_{kind}_{materials:d}")
    between.smooth("VEC3", "lit")
    if materials:
        between.smooth("VEC3", "image_at")
        info.sampler(3, "FLOAT_2D_ARRAY", "images")
    info.vertex_out(between)
    info.fragment_out(0, "VEC4", "result")
    return _compiled(info, "mesh", "common.glsl")


@cache
def skin() -> "GPUShader":
    """Return the program that skins a mesh at all frames of an action into a texture."""
    from gpu.types import GPUStageInterfaceInfo

    between = GPUStageInterfaceInfo("crowd_lod_skin")
    between.flat("VEC4", "texel")
    info = _vertex_interface("JOINTS")
    info.push_constant("VEC2", "size")
    info.vertex_out(between)
    info.fragment_out(0, "VEC4", "result")
    return _compiled(info, "skin", "common.glsl")


@cache
def points() -> "GPUShader":
    """Return the program that draws round points."""
    from gpu.types import GPUShaderCreateInfo, GPUStageInterfaceInfo

    between = GPUStageInterfaceInfo("crowd_lod_points")
    between.flat("VEC4", "tint")
    info = GPUShaderCreateInfo()
    info.push_constant("MAT4", "matrix")
    info.push_constant("FLOAT", "pixels_per_meter")  # at a distance of 1 m; orthographic: anywhere
    info.push_constant("FLOAT", "diameter")  # meters
    info.push_constant("VEC2", "bounds")  # pixels
    info.vertex_in(0, "VEC3", "position")
    info.vertex_in(1, "VEC4", "color")
    info.vertex_in(2, "FLOAT", "size")
    info.vertex_out(between)
    info.fragment_out(0, "VEC4", "result")
    return _compiled(info, "points")


@cache
def depth() -> "GPUShader":
    """Return the program that writes depths and no color."""
    from gpu.types import GPUShaderCreateInfo

    info = GPUShaderCreateInfo()
    info.sampler(0, "FLOAT_2D", "depths")
    info.vertex_in(0, "VEC2", "position")
    info.depth_write("ANY")
    info.fragment_out(0, "VEC4", "result")
    return _compiled(info, "depth")


@cache
def lines() -> "GPUShader":
    """Return Blender's own program for lines with a width in pixels."""
    from gpu import shader

    return shader.from_builtin("POLYLINE_FLAT_COLOR")


def forget() -> None:
    """Drop the compiled programs."""
    for made in (meshes, skin, points, depth, lines):
        made.cache_clear()
