"""How the scene's settings want the overlay to look: the style, what it draws instances of, their colours, the drawing."""

from dataclasses import replace

from ...crowd_lod.behaviour.trajectory import Trajectory
from ...crowd_lod.levels.assignment import Bias
from ...crowd_lod.planning.cross_fade import fades_of
from ...crowd_lod.planning.frame import Frame
from ..blender import scene_data
from . import agent_colors, character_cache
from .draw_data import Drawing, Style, drawing
from .gpu_draw import Cast
from .skinned_characters import Character


def style_of(scene, levels: int) -> tuple[Style, tuple[Character, ...], tuple[str, ...]]:
    """(style, the characters as far as it needs them, sentences for the user) of the scene, which has so many LODs."""
    settings = scene.crowd_lod
    style = Style(
        settings.overlay_mode,
        settings.overlay_culled,
        float(scene_data.rotation(settings.forward)),
        settings.overlay_color == "MATERIAL",
    )
    if style.mode != "MESHES" and not style.materials:
        return style, (), ()
    points = replace(style, mode="POINTS") if style.mode == "MESHES" else style
    casting = character_cache.casting_of(scene)
    if casting is None:
        return points, (), ("Press Make LOD Meshes in the Levels of Detail panel to see the characters.",)
    if not casting.ready:
        return points, (), (f"The characters are being read for the overlay: {casting.progress:.0%}.",)
    fits = [character.name for character in casting.characters] == [group.name for group in settings.groups]
    if fits and all(len(character.meshes) >= levels for character in casting.characters):
        return style, casting.characters, casting.told
    misfit = "The LOD meshes do not fit the settings: press Make LOD Meshes to see the characters."
    return points, (), casting.told or (misfit,)


def cast_of(groups, style: Style, characters: tuple[Character, ...]) -> Cast | None:
    """What the style draws instances of, on the GPU."""
    if style.mode == "POINTS":
        return None
    return Cast(groups, characters if style.mode == "MESHES" else ())


def colours_of(  # noqa: PLR0913 - to be cut with the overlay
    chosen: str, frame: Frame, trajectory: Trajectory, eyes, policy, bias: Bias | None, characters: tuple[Character, ...]
) -> agent_colors.Colours:
    """The agents' colours; `chosen` is of the setting overlay_colour."""
    if chosen == "STATE":
        return agent_colors.by_state(frame, trajectory.machine)
    if chosen == "GROUP":
        return agent_colors.by_group(frame)
    if chosen == "REASON":
        return agent_colors.by_reason(frame, trajectory.groups, eyes, policy, bias)
    if chosen == "MATERIAL" and characters:
        return agent_colors.by_material(frame, characters)
    return agent_colors.by_level(frame)


def drawing_of(  # noqa: PLR0913 - to be cut with the overlay
    settings, frame: Frame, trajectory: Trajectory, eyes, policy, bias: Bias | None, style: Style, coloured, framed: bool = True
) -> Drawing:
    """The drawing of the frame as the settings have it; `framed` with the lines of the camera's frustum."""
    groups = trajectory.groups
    slopes = trajectory.heights if settings.tilt else None
    fades = None
    if style.mode == "MESHES" and settings.overlay_fade:
        fades = fades_of(frame, groups, eyes, policy, bias, settings.overlay_fade)
    what = drawing(frame, groups, style, coloured, slopes, fades)
    return what if framed else replace(what, lines=what.lines[:0], line_colours=what.line_colours[:0])
