"""The station: 340 people cross a concourse on two floors, and 60 wait.

JuPedSim has simulated those who walk.

Two crowds: the walkers follow station.npz (station_tracks.py makes it), those who wait play another
action by a state machine. Both stand on the station's floors.
"""

import json
from pathlib import Path

import bpy
import numpy as np

from ..operators.blender import image_data
from ..operators.scene.machine import scene_world
from . import station_plan as site
from .characters import make_characters
from .scenery import add, aim, box, camera, child, film, material, tile, windows

TRACKS = Path(__file__).with_name("station.npz")
WAITS = {
    "version": 1,
    "name": "waiting",
    "edge": "stop",
    "labels": {"hall": {"color": "#808080", "spawn": False}, "waiting": {"color": "#e0a020"}},
    "states": {"wait": {"color": "#e0a020", "action": "idle", "on": {"*": {}}}},
}


def make(scene: bpy.types.Scene) -> None:
    """Fill the new scene."""
    film(scene)
    scene.frame_end = 240
    characters = child(scene, "Characters", hidden=True)
    make_characters(characters, speed=1.25, plays=("idle", "walk"))
    floors = child(scene, "Floors")
    scenery = child(scene, "Scenery")
    build_floors(floors)
    build_walls(scenery)
    scene.camera = camera(scene, "Main camera", near=0.2, far=120.0, lens=24.0)
    aim(scene.camera, (-20, -12.5, 3.2), (2, 5, 1.8))

    settings = scene.crowd_lod
    settings.characters = characters
    settings.forward = "X"
    for name in ("Walking", "Waiting"):
        settings.crowds.add().name = name
    walking, waiting = settings.crowds
    walking.source = "FILE"
    walking.tracks_file = str(TRACKS)
    walking.terrain = floors
    walking.seed = 4
    walking.first_frame = 1
    settings.frames = ""
    settings.step = 20
    settings.width = 960
    settings.margin_kind = "DERIVED"
    waiting.count = 60
    waiting.seed = 2
    waiting.terrain = floors
    waiting.map_image = waiting_map()
    waiting.machine = bpy.data.texts.new("waiting.json")
    waiting.machine.from_string(json.dumps(WAITS, indent=2))
    waiting.machine.cursor_set(0)
    x0, y0, x1, y1 = site.CONCOURSE
    waiting.size = x1 - x0, y1 - y0
    layer = scene.view_layers[0]
    layer.update()
    for crowd in settings.crowds:
        scene_world.read_terrain(crowd, layer.depsgraph)


def waiting_map() -> bpy.types.Image:
    """Return the label map of the people who wait, one cell for each square meter."""
    x0, y0, x1, y1 = site.CONCOURSE
    colors = np.full((y1 - y0, x1 - x0, 3), 0x80, np.uint8)
    for left, low, right, high in site.WAITING:
        colors[low - y0 : high - y0, left - x0 : right - x0] = 0xE0, 0xA0, 0x20
    return image_data.write_image("Waiting map", colors)


def build_floors(floors: bpy.types.Collection) -> None:
    """Add what people walk on: concourse, gallery, landing and stairs."""
    tones = [
        material("Terrazzo light", (0.62, 0.60, 0.56)),
        material("Terrazzo dark", (0.52, 0.50, 0.47)),
    ]
    concrete = material("Concrete", (0.45, 0.45, 0.46))
    waiting = material("Waiting", (0.70, 0.48, 0.20))
    x0, y0, x1, y1 = site.CONCOURSE
    parts = [
        (tile(x, y, x + 3, y + 3), tones[(x + y) // 3 % 2])
        for x in range(x0, x1, 3)
        for y in range(y0, y1, 3)
    ]
    parts += [(box(*area, -0.1, 0.01), waiting) for area in site.WAITING]
    add(floors, "Concourse", parts)
    slabs = [box(*area, site.HEIGHT - 0.3, site.HEIGHT) for area in (site.GALLERY, site.LANDING)]
    first, low, last, high = site.STAIRS
    edges = np.linspace(first, last, site.STEPS + 1)
    rises = site.height_on_stairs((edges[:-1] + edges[1:]) / 2)
    steps = [
        box(a, low, b, high, 0, rise)
        for a, b, rise in zip(edges[:-1], edges[1:], rises, strict=True)
    ]
    add(floors, "Gallery and stairs", [(part, concrete) for part in (*slabs, *steps)])


def build_walls(scenery: bpy.types.Collection) -> None:
    """Add walls with gaps for the doors, columns, railings, the kiosk, and the ground around."""
    stone = material("Stone", (0.66, 0.60, 0.52))
    glass = material("Glass", (0.10, 0.16, 0.20), 0.2)
    steel = material("Steel", (0.20, 0.22, 0.25))
    wood = material("Kiosk", (0.35, 0.12, 0.08))
    around = material("Around", (0.30, 0.30, 0.31))
    x0, y0, x1, y1 = site.CONCOURSE
    top = 9.0
    thick = 0.4
    door = 3.2
    parts = [(tile(-300, -300, 300, 300, -0.06), around)]
    for x in (x0 - thick, x1):
        parts += [
            (box(x, a, x + thick, b, 0, top), stone) for a, b in ((y0, -8), (0, 10), (14, y1))
        ]
        parts += [(box(x, -8, x + thick, 0, door, top), stone)]
        parts += [
            (box(x, 10, x + thick, 14, 0, site.HEIGHT), stone),
            (box(x, 10, x + thick, 14, site.HEIGHT + door, top), stone),
        ]
    parts += [
        (box(a, y1, b, y1 + thick, 0, top), stone) for a, b in ((x0, -20), (-10, 12), (20, x1))
    ]
    parts += [(box(a, y1, b, y1 + thick, door, top), stone) for a, b in ((-20, -10), (12, 20))]
    parts += [(windows(x0, y1, x1, y1 + thick, site.HEIGHT, top, storey=4.2), glass)]
    parts += [(box(*column, 0, site.HEIGHT - 0.3), stone) for column in site.COLUMNS]
    parts += [(box(*site.KIOSK, 0, 2.6), wood), (box(*site.KIOSK, 2.6, 3.0, inset=-0.4), steel)]
    for a, b in ((x0, site.LANDING[0]), (site.LANDING[2], x1)):
        parts += [
            (box(a, 9.0, b, 9.05, site.HEIGHT + low, site.HEIGHT + low + 0.06), steel)
            for low in (0.5, 1.0)
        ]
    first, low, last, high = site.STAIRS
    edges = np.linspace(first, last, site.STEPS + 1)
    for y in (low - 0.05, high):
        for a, b in zip(edges[:-1], edges[1:], strict=True):
            rise = float(site.height_on_stairs(np.array((a + b) / 2)))
            parts.append((box(a, y, b, y + 0.05, rise + 0.9, rise + 1.05), steel))
    add(scenery, "Station", parts)
