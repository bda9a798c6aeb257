"""A picture of a state machine: its states on a circle, and arrows to the states that follow."""

import math
from collections.abc import Iterator
from html import escape

import numpy as np

from ..crowd.state_machine import StateMachine
from ..format import number

# pixels: the radius of a state, and the width of a letter
NODE = 15
LETTER = 7.4
INK = "#1d2026"
DIM = "#646b78"
PAPER = "#ffffff"
TIMED = "#646b78"
Point = tuple[float, float]


def svg(machine: StateMachine) -> str:
    """Return the picture as SVG, on white.

    An arrow has the color of the label on which the state changes; a dashed arrow is a timer's.
    Agents start in states with a thick rim. A tooltip on an arrow names its labels.
    """
    count = len(machine.states)
    radius = max(120.0, 21.0 * count)
    texts = [(name, _does(machine, s)) for s, name in enumerate(machine.states)]
    width = max(
        560.0,
        2 * (radius + NODE + 30 + LETTER * max(len(text) for pair in texts for text in pair)),
    )
    center = width / 2, radius + 70
    turns = [2 * math.pi * s / count - math.pi / 2 for s in range(count)]
    places = [
        (center[0] + radius * math.cos(turn), center[1] + radius * math.sin(turn)) for turn in turns
    ]
    arrows = _arrows(machine)
    parts = [
        part
        for pair, labels in arrows.items()
        for part in _arrow(machine, places, center, pair, labels)
    ]
    for s, (turn, place) in enumerate(zip(turns, places, strict=True)):
        parts += _state(machine, s, turn, place)
    arrow_labels = sorted(
        {label for labels in arrows.values() for label in labels if label is not None}
    )
    legend, bottom = _legend(machine, arrow_labels, width, 2 * radius + 150)
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {bottom:.0f}" '
            f'role="img" '
            f'style="max-width:{width:.0f}px;display:block;margin:0 auto">',
            f"<title>The state machine {escape(machine.name)}</title>",
            f'<rect width="{width:.0f}" height="{bottom:.0f}" rx="10" fill="{PAPER}"/>',
            *parts,
            *legend,
            "</svg>\n",
        ]
    )


def _arrows(machine: StateMachine) -> dict[tuple[int, int], list[int | None]]:
    """Return for each pair (state, next state) the labels on which it changes; None is a timer."""
    arrows: dict[tuple[int, int], list[int | None]] = {}
    for s in range(len(machine.states)):
        for label in range(len(machine.labels)):
            for t in _targets(
                machine, int(machine.next_state[s, label]), int(machine.next_choice[s, label])
            ):
                arrows.setdefault((s, t), []).append(label)
        if np.isfinite(machine.after[s, 0]):
            for t in _targets(machine, int(machine.then[s]), int(machine.then_choice[s])):
                arrows.setdefault((s, t), []).append(None)
    return {pair: labels for pair, labels in arrows.items() if pair[0] != pair[1]}


def _targets(machine: StateMachine, certain: int, choice: int) -> Iterator[int]:
    if choice < 0:
        yield certain
    else:
        yield from np.flatnonzero(np.diff(machine.odds[choice], prepend=0)).tolist()


def _arrow(
    machine: StateMachine,
    places: list[Point],
    center: Point,
    pair: tuple[int, int],
    labels: list[int | None],
) -> Iterator[str]:
    (ax, ay) = places[pair[0]]
    (bx, by) = places[pair[1]]
    # bent toward the center, and to its own side, so that there and back lie apart
    x = 0.75 * (ax + bx) / 2 + 0.25 * center[0] + 0.13 * (by - ay)
    y = 0.75 * (ay + by) / 2 + 0.25 * center[1] - 0.13 * (bx - ax)
    begin = _toward((ax, ay), (x, y), NODE + 2)
    end = _toward((bx, by), (x, y), NODE + 4)
    head = _toward(end, (x, y), 9)
    dx = 0.45 * (end[0] - head[0])
    dy = 0.45 * (end[1] - head[1])
    path = (
        f'd="M{begin[0]:.1f} {begin[1]:.1f}Q{x:.1f} {y:.1f} {head[0]:.1f} {head[1]:.1f}" '
        f'fill="none"'
    )
    names = ["after its time" if label is None else machine.labels[label] for label in labels]
    told = f"{machine.states[pair[0]]} to {machine.states[pair[1]]}: {', '.join(names)}"
    yield f"<g><title>{escape(told)}</title>"
    if labels[0] is not None:  # else light colors would be lost on the paper
        yield f'<path {path} stroke="{INK}" stroke-opacity="0.25" stroke-width="3"/>'
    for k, label in enumerate(labels):
        dash = ' stroke-dasharray="5 4"' if label is None else ""
        if len(labels) > 1:
            dash = f' stroke-dasharray="8 {8 * (len(labels) - 1)}" stroke-dashoffset="{-8 * k}"'
        yield f'<path {path} stroke="{_color(machine, label)}" stroke-width="1.8"{dash}/>'
    corners = end, (head[0] - dy, head[1] + dx), (head[0] + dy, head[1] - dx)
    yield (
        f'<polygon points="{" ".join(f"{px:.1f},{py:.1f}" for px, py in corners)}" '
        f'fill="{_color(machine, labels[0])}"/></g>'
    )


def _state(machine: StateMachine, s: int, turn: float, place: Point) -> Iterator[str]:
    x, y = place
    rim = 3.5 if machine.start[s] > 0 else 1
    yield (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{NODE}" '
        f'fill="#{bytes(machine.state_colors[s]).hex()}" stroke="{INK}" stroke-width="{rim}"/>'
    )
    across = math.cos(turn)
    up = math.sin(turn)
    anchor = "middle" if abs(across) < 0.25 else "start" if across > 0 else "end"
    tx = x + (NODE + 9) * across
    ty = y + (NODE + 15) * up + 1
    yield _text((tx, ty - (6 if up <= 0.9 else -4)), machine.states[s], anchor, INK, 13)
    yield _text((tx, ty + (8 if up <= 0.9 else 18)), _does(machine, s), anchor, DIM, 11)


def _does(machine: StateMachine, s: int) -> str:
    """Return the speeds and the time of a state in a few words."""
    speeds = np.hypot(*machine.velocity[s].T)
    least = float(speeds.min())
    most = float(speeds.max())
    words = (
        "stands"
        if not most
        else f"{number(most)} m/s"
        if least == most
        else f"{number(least)} to {number(most)} m/s"
    )
    if not math.isfinite(machine.after[s, 0]):
        return words
    low, high = machine.after[s].tolist()
    return (
        f"{words}, {number(low)} s"
        if low == high
        else f"{words}, {number(low)} to {number(high)} s"
    )


def _legend(
    machine: StateMachine, arrow_labels: list[int], width: float, top: float
) -> tuple[list[str], float]:
    """Return the legend of the arrows' colors, and where it ends."""
    entries: list[int | None] = [
        *arrow_labels,
        *([None] if np.isfinite(machine.after).any() else []),
    ]
    names = ["after its time" if label is None else machine.labels[label] for label in entries]
    columns = max(1, int((width - 40) / (70 + LETTER * max(map(len, names), default=1))))
    parts = []
    for n, (label, name) in enumerate(zip(entries, names, strict=True)):
        x = 30 + (width - 40) / columns * (n % columns)
        y = top + 22 * (n // columns)
        dash = ' stroke-dasharray="5 4"' if label is None else ""
        line = f'x1="{x:.0f}" y1="{y:.0f}" x2="{x + 26:.0f}" y2="{y:.0f}"'
        parts.append(f'<line {line} stroke="{_color(machine, label)}" stroke-width="4"{dash}/>')
        parts.append(_text((x + 33, y + 4), name, "start", INK, 12))
    return parts, top + 22 * -(-len(entries) // columns) + 6


def _toward(begin: Point, end: Point, length: float) -> Point:
    """Return the place so far from `begin` toward `end`."""
    dx = end[0] - begin[0]
    dy = end[1] - begin[1]
    part = length / max(math.hypot(dx, dy), 1e-9)
    return begin[0] + part * dx, begin[1] + part * dy


def _text(at: Point, text: str, anchor: str, color: str, size: int) -> str:
    # a halo in the paper's color keeps it readable over arrows
    return (
        f'<text x="{at[0]:.1f}" y="{at[1]:.1f}" text-anchor="{anchor}" style="font:{size}px '
        f"system-ui,sans-serif;fill:{color};"
        f'stroke:{PAPER};stroke-width:3;paint-order:stroke">{escape(text)}</text>'
    )


def _color(machine: StateMachine, label: int | None) -> str:
    return TIMED if label is None else f"#{bytes(machine.label_colors[label]).hex()}"
