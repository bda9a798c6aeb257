"""The overlay's text in the viewport, and the ring around the picked agent."""

import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from ...crowd_lod.format import counted, number
from ...crowd_lod.frame.frame import Frame
from ...crowd_lod.frame.reasons import REASONS, Account, Reason
from ..blender.colors import to_srgb
from . import shader_programs
from .draw_data import HIDDEN, Colors
from .gpu_draw import LINE_PIXELS

STAGES = {
    "behavior": "Behavior",
    "culling": "Culling",
    "levels": "Levels",
    "sorting": "Sorting",
    "occlusion": "Occlusion",
    "surroundings": "Shadows",
    "drawing": "Drawing",
}
# sRGB
WHITE = (0.9, 0.9, 0.9, 1.0)
RING = (1.0, 1.0, 1.0, 1.0)
BEHIND = (0.0, 0.0, 0.0, 0.5)
SAMPLE = "Agents 0123456789, visible"  # of the figures' letters, for their mean width
# nominal pixels; LINE is that of Blender's own text, the viewport's name and so on
LETTERS = 11.0
LINE = 18.0
MARGIN = 10.0
LEAST = 8.0  # nominal pixels, the ring's least radius
CORNERS = 48
NARROWEST = 120.0  # nominal pixels, below which nothing is written
MOST_NAMES = 12  # of a legend
BY_DISTANCE = REASONS[Reason.NEAR_ENOUGH], REASONS[Reason.DISTANCE]  # reasons that the depth tells


@dataclass(frozen=True)
class HudLine:
    """A line of text.

    color: linear color of a square before the text, or None for no square.
    """

    text: str
    color: tuple[float, float, float] | None = None


def figures(
    frame: Frame,
    colors: Colors,
    notes: Sequence[str] = (),
    worst: float | None = None,
) -> tuple[HudLine, ...]:
    """Return the overlay's lines of text about `frame`, with the legend of its colors.

    colors: of the agents.
    notes: sentences for the user.
    worst: pixels by which LODs in sight deviate at most; None if that is not known.
    """
    agents = frame.people
    people = frame.without_worn(frame.buckets)
    visible = len(people.order)
    culled = (agents - visible) / agents if agents else 0.0
    lines = [HudLine(f"{counted(agents, 'agent')}, {visible:,} visible, {culled:.1%} culled")]
    counts = enumerate(people.counts)
    lines += [
        HudLine(f"LOD {k}  {count:,}", colors.of_name(k) if colors.by_lod else None)
        for k, count in counts
    ]
    if frame.hidden is not None:
        hidden = frame.hidden[: len(frame.trajectory.bare.start)].sum()
        lines.append(HudLine(f"Occluded  {hidden:,}", None if colors.culled else HIDDEN[:3]))
    lines += [] if colors.by_lod else legend(colors)
    lines += map(HudLine, notes)
    if frame.full_triangles:
        lines.append(
            HudLine(f"Triangles  {share(frame.triangles, frame.full_triangles)} without LOD")
        )
    if worst is not None:
        lines.append(HudLine(f"Largest error  {number(worst)} px"))
    if frame.dropped:
        lines.append(
            HudLine(
                f"{counted(frame.dropped, 'agent')} at NaN or infinity "
                f"{'is' if frame.dropped == 1 else 'are'} left out."
            )
        )
    return tuple(lines)


def legend(colors: Colors) -> list[HudLine]:
    """Return a line for each of the colors' names, MOST_NAMES at most, and the count of others.

    Where culled agents are colored, too, only the names of colors that some agent has.
    """
    used = range(len(colors.names))
    if colors.culled:
        used = np.flatnonzero(np.bincount(colors.index)).tolist()
    lines = [HudLine(colors.names[k], colors.of_name(k)) for k in used[:MOST_NAMES]]
    more = len(used) - MOST_NAMES
    return [*lines, HudLine(f"and {more} more")] if more > 0 else lines


def line_of(account: Account, colors: Colors) -> HudLine:
    """Return the line about the picked agent, in its color."""
    return HudLine(describe(account), colors.of_agent(account.agent, account.visible))


def describe(account: Account) -> str:
    """Return an agent's LOD, depth and error, or why it is culled."""
    if not account.visible:
        return f"Agent {account.agent:,}, culled: {account.reason}"
    why = "" if account.reason in BY_DISTANCE else f" ({account.reason})"
    off = "" if account.error is None else f", error {account.error:.2g} px"
    return f"Agent {account.agent:,}, LOD {account.level}{why}: {account.depth:.3g} m away{off}"


def share(drawn: int, full: int) -> str:
    return f"{short(drawn)} of {short(full)}"


def short(count: int) -> str:
    """Return a count with three digits and a letter: 12,345,678 gives 12.3 M."""
    for least, unit, letter in ((1e9, 1e9, "G"), (1e6, 1e6, "M"), (1e4, 1e3, "k")):
        if count >= least:
            return f"{count / unit:.3g} {letter}"
    return f"{count:,}"


def wrap_lines(lines: Sequence[HudLine], letters: int, rows: int) -> list[HudLine]:
    """Return `lines` wrapped to lines of at most `letters` characters.

    rows: the most lines returned; if there are more, the last one is "...".
    """
    broken_lines = []
    for line in lines:
        first, *rest = textwrap.wrap(line.text, max(3, letters), subsequent_indent="  ") or [""]
        broken_lines += [HudLine(first, line.color), *map(HudLine, rest)]
    return (
        broken_lines
        if len(broken_lines) <= rows
        else [*broken_lines[: max(0, rows - 1)], HudLine("...")][:rows]
    )


def write(
    lines: Sequence[HudLine], box: tuple[float, float, float, float], ui_scale: float
) -> tuple[float, float]:
    """Write lines of text from the top down into a box of the region being drawn.

    Returns (right, bottom) of the text, or (left, top) if the box is too small for any text.

    box: (left, bottom, right, top) in pixels of the region.
    """
    import blf

    left, bottom, right, top = box
    indent = 2 * MARGIN * ui_scale
    line_height = LINE * ui_scale
    blf.size(0, LETTERS * ui_scale)
    letter = blf.dimensions(0, SAMPLE)[0] / len(SAMPLE)
    fitting = wrap_lines(
        lines, int((right - left - 2 * indent) / letter), int((top - bottom) / line_height)
    )
    if right - left < NARROWEST * ui_scale or not fitting:
        return left, top
    width = indent + max(blf.dimensions(0, line.text)[0] for line in fitting)
    edge = MARGIN * ui_scale / 2
    fill(
        left + edge,
        top - len(fitting) * line_height - 2 * edge,
        left + width + 2 * edge,
        top,
        BEHIND,
    )
    for row, line in enumerate(fitting, start=1):
        base = top - row * line_height
        if line.color is not None:
            color = to_srgb(np.array([*line.color, 1.0], np.float32))
            fill(
                left + 2 * edge,
                base,
                left + 2 * edge + line_height / 2,
                base + line_height / 2,
                color,
            )
        blf.color(0, *WHITE)
        blf.position(0, left + indent + edge, base, 0)
        blf.draw(0, line.text)
    return left + width + 2 * edge, top - len(fitting) * line_height - 2 * edge


def fill(left: float, bottom: float, right: float, top: float, color) -> None:
    """Fill a rectangle of the region, in pixels, with an sRGB color."""
    import gpu
    from gpu_extras.batch import batch_for_shader

    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    batch = batch_for_shader(
        shader, "TRI_STRIP", {"pos": [(left, bottom), (right, bottom), (left, top), (right, top)]}
    )
    with blended():
        shader.uniform_float("color", [float(value) for value in color])
        batch.draw(shader)


@contextmanager
def blended() -> Iterator[None]:
    """Enable alpha blending; restore the blend mode at the end."""
    import gpu

    before = gpu.state.blend_get()
    gpu.state.blend_set("ALPHA")
    try:
        yield
    finally:
        gpu.state.blend_set(before)


def free_box(area, region, overlay, ui_scale: float) -> tuple[float, float, float, float]:
    """Return the part of a viewport's region that is free of other regions and text.

    Left out: sidebar, toolbar, headers, asset shelf, and the lines of text that Blender itself
    writes at the top.
    Returns (left, bottom, right, top) in pixels of the region.
    """
    left = region.x
    bottom = region.y
    right = region.x + region.width
    top = region.y + region.height
    for other in area.regions:
        if other.width <= 1 or other.height <= 1:
            continue
        if other.type == "TOOLS":
            left = max(left, other.x + other.width)
        elif other.type == "UI":
            right = min(right, other.x)
        elif other.type in ("HEADER", "TOOL_HEADER", "ASSET_SHELF_HEADER", "ASSET_SHELF"):
            if other.y > area.y + area.height / 2:
                top = min(top, other.y)
            else:
                bottom = max(bottom, other.y + other.height)
    lines = 3 * overlay.show_text + 6 * overlay.show_stats
    return (
        left - region.x,
        bottom - region.y,
        right - region.x,
        top - region.y - (lines * LINE + MARGIN) * ui_scale,
    )


def ring(frame: Frame, agent: int, region, ui_scale: float) -> None:
    """Draw a ring around an agent into the region being drawn, in its pixels.

    Draws nothing if the agent is behind the viewer.
    """
    from gpu_extras.batch import batch_for_shader

    matrix = np.array(region.data.perspective_matrix, np.float64)
    group = frame.trajectory.groups[frame.crowd.group[agent]]
    x, y, _, w = matrix @ (*frame.crowd.places(frame.trajectory.spheres.center, agent), 1.0)
    if w <= 0:
        return
    half = np.array([region.width, region.height]) / 2
    across = group.radius * region.data.window_matrix[1][1] * half[1] / w
    angles = np.linspace(0, 2 * np.pi, CORNERS + 1)
    circle = max(LEAST * ui_scale, across) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = np.zeros((CORNERS + 1, 3), np.float32)
    points[:, :2] = (np.array([x, y]) / w + 1) * half + circle
    shader = shader_programs.lines()
    batch = batch_for_shader(
        shader, "LINE_STRIP", {"pos": points, "color": np.tile(np.float32(RING), (len(points), 1))}
    )
    shader.bind()
    shader.uniform_float("viewportSize", (region.width, region.height))
    shader.uniform_float("lineWidth", LINE_PIXELS * ui_scale)
    with blended():
        batch.draw(shader)
