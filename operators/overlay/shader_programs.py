"""Shader programs: the bodies are files in shaders/, their interfaces are declared here. Compiled when first used."""

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gpu.types import GPUShader, GPUShaderCreateInfo

SHADERS = Path(__file__).parents[2] / "shaders"
TEXELS = 4096  # in a row of the texture of instances
VIEW = "struct CrowdView { mat4 matrix; vec4 key; };"


def source(*names: str) -> str:
    """The shader files one after the other."""
    return "\n".join((SHADERS / name).read_text(encoding="utf-8") for name in names)


def mesh_interface(kind: str, materials: bool = False) -> "GPUShaderCreateInfo":
    """What all programs that draw instances of meshes take in; see `Batches` for what it is.

    kind: RIGID for boxes; JOINTS for meshes that are skinned from joint frames; FRAMES for those that are already, at each
    frame of the action.
    """
    info = _vertex_interface(kind)
    info.typedef_source(VIEW)
    info.define("INSTANCES", "1")
    info.define("TEXELS", str(TEXELS))
    info.uniform_buf(0, "CrowdView", "view")
    info.sampler(0, "FLOAT_2D", "agents")
    info.push_constant("INT", "base")
    if kind != "RIGID":
        info.push_constant("INT", "frame_count")
    if materials:
        info.define("MATERIALS", "1")
        info.vertex_in(4, "VEC2", "uv")
        info.vertex_in(5, "VEC3", "base_colour")
        info.vertex_in(6, "FLOAT", "layer")
    else:
        info.sampler(2, "FLOAT_2D", "palette")
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
    """The program of the shader files of that name, the vertex shader's after the `shared` ones."""
    from gpu import shader

    info.vertex_source(source(*shared, f"{name}.vert.glsl"))
    info.fragment_source(source(f"{name}.frag.glsl"))
    return shader.create_from_info(info)


@cache
def meshes(kind: str, materials: bool, fading: bool) -> "GPUShader":
    """Draws instances: of LOD meshes, in their materials' colours or those of the palette, or of rigid boxes."""
    from gpu.types import GPUStageInterfaceInfo

    info = mesh_interface(kind, materials)
    between = GPUStageInterfaceInfo(f"crowd_lod_mesh_{kind}_{materials:d}{fading:d}")
    between.smooth("VEC3", "lit")
    if materials:
        between.smooth("VEC3", "image_at")
        info.sampler(3, "FLOAT_2D_ARRAY", "images")
    if fading:
        info.define("FADING", "1")
        between.flat("FLOAT", "share")
    info.vertex_out(between)
    info.fragment_out(0, "VEC4", "result")
    return _compiled(info, "mesh", "common.glsl")


@cache
def skin() -> "GPUShader":
    """Skins a mesh at all frames of an action, into a texture."""
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
    """Draws round points."""
    from gpu.types import GPUShaderCreateInfo, GPUStageInterfaceInfo

    between = GPUStageInterfaceInfo("crowd_lod_points")
    between.flat("VEC4", "tint")
    info = GPUShaderCreateInfo()
    info.push_constant("MAT4", "matrix")
    info.push_constant("FLOAT", "pixels_per_metre")  # at a distance of 1 m; orthographic: anywhere
    info.push_constant("FLOAT", "diameter")  # metres
    info.push_constant("VEC2", "bounds")  # pixels
    info.vertex_in(0, "VEC3", "position")
    info.vertex_in(1, "VEC4", "colour")
    info.vertex_in(2, "FLOAT", "size")
    info.vertex_out(between)
    info.fragment_out(0, "VEC4", "result")
    return _compiled(info, "points")


@cache
def depth() -> "GPUShader":
    """Writes depths, and no colour."""
    from gpu.types import GPUShaderCreateInfo

    info = GPUShaderCreateInfo()
    info.sampler(0, "FLOAT_2D", "depths")
    info.vertex_in(0, "VEC2", "position")
    info.depth_write("ANY")
    info.fragment_out(0, "VEC4", "result")
    return _compiled(info, "depth")


@cache
def lines() -> "GPUShader":
    """Draws lines of a width in pixels; Blender's own."""
    from gpu import shader

    return shader.from_builtin("POLYLINE_FLAT_COLOR")


def forget() -> None:
    """Let the programs go."""
    for made in (meshes, skin, points, depth, lines):
        made.cache_clear()
