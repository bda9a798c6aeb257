"""The plaza: 10,000 agents among walls, around a fountain.

They walk, and some stop and wait for a while where people wait, then turn and go on. The camera
flies: it sees nearly all agents first, nearly none at the end.
"""

import json
from math import atan2, hypot, pi

import bpy
import numpy as np

from ..crowd_lod.crowd.state_machine import parse, preset_text
from ..operators.blender import image_data
from ..operators.settings.crowds import first_crowd
from . import plaza_map as site
from .characters import make_characters
from .scenery import add, animate, box, camera, child, film, lathe, material, tile, windows

# The flight: frame, where the camera is, what it looks at (meters), focal length (mm).
FLIGHT = (
    (1, (-64, -64, 32), (-20, -20, 5), 18),
    (36, (-44, -48, 18), (0, -4, 2), 22),
    (60, (-18, -22, 2.2), (2, 4, 2.6), 30),
    (84, (-15, 6, 2.0), (4, 20, 2.4), 35),
    (102, (-8, 34, 2.0), (-3, 58, 3.0), 35),
    (120, (-2, 61, 2.0), (-2, 90, 3.0), 50),
)
FAR = 250.0


def make(scene: bpy.types.Scene) -> None:
    """Fill the new scene."""
    film(scene)
    machine = bpy.data.texts.new("plaza.json")
    machine.from_string(who_wait(preset_text("plaza")))
    machine.cursor_set(0)
    table = parse(machine.as_string(), "plaza")
    world = site.plan(table)
    characters = child(scene, "Characters", hidden=True)
    make_characters(characters, speed=1.25, plays=("idle", "walk"))
    obstacles = child(scene, "Obstacles")
    scenery = child(scene, "Scenery")
    build_houses(obstacles, scenery)
    build_furniture(obstacles, scenery)
    build_fountain(obstacles)
    build_ground(scenery)
    scene.camera = fly(scene)

    settings = scene.crowd_lod
    settings.characters = characters
    settings.forward = "X"
    crowd = first_crowd(settings)
    crowd.count = 10_000
    crowd.seed = 7
    crowd.center = (0, 0, 0)
    crowd.size = (site.SIZE, site.SIZE)
    crowd.map_image = image_data.write_image("Plaza map", table.label_colors[world.labels])
    crowd.machine = machine
    crowd.first_frame = 1
    settings.frames = ""
    settings.step = 10
    settings.width = 960
    settings.level_count = 3
    settings.ratios[:3] = (1.0, 0.4, 0.12)
    settings.thresholds[:2] = (0.16, 0.4)
    settings.margin_kind = "DERIVED"


def who_wait(text: str) -> str:
    """Return the state machine `text` with one more state, in which agents wait.

    One agent in five that enters a waiting area comes into it. It plays the action "idle", and then
    goes on in any direction.
    """
    root = json.loads(text)
    states = root["states"]
    for name, state in states.items():
        state["on"]["waiting area"] |= {"next": {name: 4, "wait": 1}}
    then = dict.fromkeys(states, 1)
    states["wait"] = {
        "color": "#f0f0f0",
        "action": "idle",
        "after": [4, 15],
        "then": then,
        "on": {"*": {}},
    }
    return json.dumps(root, indent=1)


def fly(scene: bpy.types.Scene) -> bpy.types.Object:
    """Add the camera with its flight."""
    flight = camera(scene, "Flight", near=0.2, far=FAR)
    frames, places, targets, lenses = zip(*FLIGHT, strict=True)
    places = np.array(places, float)
    x, y, z = (np.array(targets, float) - places).T
    pitch = [pi / 2 + atan2(height, hypot(*ahead)) for height, *ahead in zip(z, x, y, strict=True)]
    yaw = np.unwrap(np.arctan2(y, x)) - pi / 2
    curves = {("location", axis): places[:, axis].tolist() for axis in range(3)}
    for axis, angles in enumerate((pitch, [0.0] * len(frames), yaw.tolist())):
        curves["rotation_euler", axis] = angles
    animate(flight, frames, curves)
    animate(flight.data, frames, {("lens", 0): lenses})
    return flight


def build_houses(obstacles: bpy.types.Collection, scenery: bpy.types.Collection) -> None:
    """Add the houses around the plaza, the town hall's tower, and the town behind."""
    stucco = [
        material(f"Stucco {i}", color)
        for i, color in enumerate(
            (
                (0.86, 0.72, 0.48),
                (0.80, 0.52, 0.36),
                (0.90, 0.84, 0.72),
                (0.74, 0.66, 0.52),
                (0.84, 0.62, 0.42),
            )
        )
    ]
    roof = material("Roof tiles", (0.50, 0.17, 0.09))
    pane = material("Window panes", (0.05, 0.07, 0.10), 0.2)

    def house(x0, y0, x1, y1, height, look, inset=3.5, top=3.0):
        return [
            (box(x0, y0, x1, y1, 0, height), look),
            (box(x0, y0, x1, y1, height, height + top, inset), roof),
            (windows(x0, y0, x1, y1, 0, height), pane),
        ]

    parts = []
    for i, rectangle in enumerate(site.HOUSES):
        parts += house(*rectangle, stucco[i % 5])
    parts += house(*site.TOWER, stucco[2], inset=3.9, top=9.0)
    add(obstacles, "Houses", parts)

    random = np.random.Generator(np.random.PCG64(1))
    parts = []
    for x in range(-230, 200, 48):
        for y in range(-230, 200, 48):
            # a street's width about the plaza stays free
            x0 = x
            y0 = y
            x1 = x + 36
            y1 = y + 36
            height = float(random.integers(9, 20))
            if max(abs(x0 + 18), abs(y0 + 18)) > 84 + 18:
                parts += house(x0, y0, x1, y1, height, stucco[int(random.integers(5))], inset=8.0)
    add(scenery, "Town", parts)


def build_furniture(obstacles: bpy.types.Collection, scenery: bpy.types.Collection) -> None:
    """Add columns, trees in planters, benches, café tables with parasols, bollards.

    The bollards stand at the entrances.
    """
    stone = material("Stone", (0.80, 0.76, 0.68))
    wood = material("Wood", (0.24, 0.12, 0.05))
    iron = material("Iron", (0.04, 0.04, 0.05))
    bark = material("Bark", (0.14, 0.09, 0.05))
    leaves = [material("Leaves 0", (0.14, 0.34, 0.07)), material("Leaves 1", (0.22, 0.42, 0.10))]
    canvas = [
        material("Canvas red", (0.60, 0.06, 0.04)),
        material("Canvas cream", (0.80, 0.72, 0.55)),
    ]
    shaft = ((0.75, 0.0), (0.75, 0.6), (0.5, 0.7), (0.45, 6.0), (0.75, 6.2), (0.75, 6.6))
    parts = [(lathe(x, y, shaft, 16), stone) for x, y in site.COLUMNS]
    parts += [(box(*planter, 0, 0.5), stone) for planter in site.PLANTERS]
    parts += [(box(*bench, 0, 0.45), wood) for bench in site.BENCHES]
    parts += [(box(*table, 0, 0.75), wood) for table in site.TABLES]
    add(obstacles, "Furniture", parts)

    parts = []
    crown = ((0.2, 2.0), (1.3, 2.5), (1.8, 3.4), (1.7, 4.4), (1.1, 5.4), (0.3, 5.9))
    for i, (x, y) in enumerate(site.TREES):
        parts += [
            (lathe(x, y, ((0.16, 0.4), (0.12, 2.4)), 6), bark),
            (lathe(x, y, crown, 9), leaves[i % 2]),
        ]
    for i, (x0, y0, x1, y1) in enumerate(site.TABLES):
        x = (x0 + x1) / 2
        y = (y0 + y1) / 2
        parts.append((lathe(x, y, ((0.04, 0.7), (0.04, 2.9)), 6), iron))
        parts.append((lathe(x, y, ((1.7, 2.3), (0.05, 3.0)), 8), canvas[i % 2]))
    half = site.SIZE / 2 - 0.4
    for x0, y0, x1, y1 in site.ENTRANCES:
        for step in range(1, int(x1 - x0 + y1 - y0) // 2):
            x, y = (x0 + 2 * step, y0) if y0 == y1 else (x0, y0 + 2 * step)
            x = max(-half, min(half, x))
            y = max(-half, min(half, y))
            parts.append((lathe(x, y, ((0.12, 0), (0.12, 0.9), (0.05, 1.0)), 8), iron))
    add(scenery, "Trees, parasols, bollards", parts)


def build_fountain(obstacles: bpy.types.Collection) -> None:
    """Add the fountain: basin, water, and a column with two bowls."""
    stone = material("Fountain stone", (0.84, 0.80, 0.73))
    water = material("Water", (0.06, 0.32, 0.60), 0.1)
    rim = site.FOUNTAIN
    basin = ((rim, 0), (rim, 0.7), (rim - 0.5, 0.7), (rim - 0.5, 0.45))
    column = ((1.4, 0.4), (0.6, 0.9), (0.5, 2.4), (2.5, 3.0), (2.6, 3.3), (2.3, 3.3), (2.2, 3.1))
    upper = ((0.4, 3.0), (0.25, 4.4), (1.1, 4.8), (1.15, 5.0), (1.0, 5.0), (0.9, 4.9))
    parts = [
        (lathe(0, 0, basin, 64), stone),
        (lathe(0, 0, column, 24), stone),
        (lathe(0, 0, upper, 24), stone),
    ]
    for radius, z in ((rim - 0.5, 0.55), (2.25, 3.2), (0.95, 4.95)):
        parts.append((lathe(0, 0, ((radius, z - 0.1), (radius, z)), 48), water))
    parts.append((lathe(0, 0, ((0.16, 4.9), (0.1, 6.0), (0.02, 6.6)), 12), water))
    add(obstacles, "Fountain", parts)


def build_ground(scenery: bpy.types.Collection) -> None:
    """Add paving in two tones, tinted where people wait, and asphalt around it."""
    tones = [
        material("Paving light", (0.76, 0.70, 0.61)),
        material("Paving dark", (0.68, 0.62, 0.54)),
    ]
    waiting = material("Waiting area", (0.80, 0.56, 0.32))
    asphalt = material("Asphalt", (0.36, 0.36, 0.38))
    half = int(site.SIZE / 2)
    pitch = 4
    parts = [(tile(-500, -500, 500, 500, -0.05), asphalt)]
    for x in range(-half, half, pitch):
        for y in range(-half, half, pitch):
            parts.append((tile(x, y, x + pitch, y + pitch), tones[(x + y) // pitch % 2]))
    parts += [(tile(*area, 0.01), waiting) for area in site.WAITING]
    parts.append(
        (lathe(0, 0, ((site.AROUND_FOUNTAIN, 0), (site.AROUND_FOUNTAIN, 0.01)), 64), waiting)
    )
    add(scenery, "Ground", parts)
