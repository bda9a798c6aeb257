"""How the overlay looks by the scene's settings: style, characters, colors."""

from dataclasses import replace

from ...crowd_lod.frame.frame import Frame
from ..blender import scene_data
from . import character_cache, draw_data
from .draw_data import Drawing, Style, drawing
from .gpu_batches import GpuBodies
from .skinned_characters import SkinnedCharacter


def style_of(scene, levels: int) -> tuple[Style, tuple[SkinnedCharacter, ...], tuple[str, ...]]:
    """Return (style, characters, notes) of the scene.

    Where the characters are missing, not read yet, or do not fit, meshes become boxes.

    levels: least number of LODs that each character must have.
    characters: only if the style needs them.
    notes: sentences for the user.
    """
    settings = scene.crowd_lod
    style = Style(
        settings.overlay_mode,
        settings.overlay_culled,
        float(scene_data.rotation(settings.forward)),
        settings.overlay_color == "MATERIAL",
    )
    if style.mode != "MESHES" and not style.materials:
        return style, (), ()
    boxes = replace(style, mode="BOXES") if style.mode == "MESHES" else style
    read = character_cache.read_characters_of(scene)
    if read is None:
        is_read_soon = character_cache.has_characters(scene)
        press = "Press Make LOD Meshes to see the characters."
        return boxes, (), ("Loading characters..." if is_read_soon else press,)
    if not read.ready:
        return (
            boxes,
            (),
            (f"Loading characters... {read.progress:.0%}",),
        )
    fits = [character.name for character in read.characters] == [
        group.name for group in settings.groups
    ]
    if fits and all(len(character.meshes) >= levels for character in read.characters):
        return style, read.characters, read.notes
    misfit = "The LOD meshes do not fit the settings: press Make LOD Meshes to see the characters."
    return boxes, (), read.notes or (misfit,)


def bodies_of(groups, style: Style, characters: tuple[SkinnedCharacter, ...]) -> GpuBodies | None:
    """Return the style's characters or boxes, on the GPU; None for points."""
    if style.mode == "POINTS":
        return None
    return GpuBodies(groups, characters if style.mode == "MESHES" else ())


def colors_of(
    mode: str, frame: Frame, characters: tuple[SkinnedCharacter, ...]
) -> draw_data.Colors:
    """Return the agents' colors; `mode` is a value of the setting overlay_color."""
    if mode == "STATE":
        return draw_data.by_state(frame)
    if mode == "GROUP":
        return draw_data.by_group(frame)
    if mode == "REASON":
        return draw_data.by_reason(frame)
    if mode == "ERROR":
        return draw_data.by_error(frame)
    if mode == "MATERIAL" and characters:
        return draw_data.by_material(frame, characters)
    return draw_data.by_level(frame)


def drawing_of(
    settings, frame: Frame, style: Style, colored: draw_data.Colors, framed: bool = True
) -> Drawing:
    """Return the frame's Drawing by the settings.

    framed: whether to draw the lines of the camera's frustum and LOD ranges.
    """
    what = drawing(frame, style, colored)
    return what if framed else replace(what, lines=what.lines[:0], line_colors=what.line_colors[:0])
