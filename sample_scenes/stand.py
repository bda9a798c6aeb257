"""The stand: 3,000 people sit on a curved stand, look at a ball, and cheer.

They stay where they spawn, in rows along a curve. In the middle block they are lively, on the right
they are quiet. Three cameras follow one another: from the pitch, over the shoulders of the upper
rows, along a row.
"""

import json
from math import cos, radians, sin

import bpy
import numpy as np

from ..crowd_lod.crowd.state_machine import parse, preset_text
from ..operators.blender import image_data
from ..operators.scene.sources import spawn_source
from ..operators.settings.crowds import first_crowd
from .characters import make_characters
from .scenery import Polygons, add, aim, camera, child, film, lathe, material, tile
from .walk import SEAT

ROWS = 20
RADIUS = 26.0  # of the first row, meters
DEPTH = 0.9
RISE = 0.4
FRONT = 0.65  # meters from where people sit to the edge of their step
ANGLES = np.radians(np.linspace(-70, 70, 57))  # from +y, clockwise: inward is to the right
LIVELY = radians(22)  # about the middle
QUIET = radians(48)
SIZE = 100
FOCUS = 7, 6, 0  # where the ball lies


def make(scene: bpy.types.Scene) -> None:
    """Fill the new scene."""
    film(scene)
    machine = bpy.data.texts.new("stand.json")
    machine.from_string(who_cheer(preset_text("audience")))
    machine.cursor_set(0)
    characters = child(scene, "Characters", hidden=True)
    make_characters(characters, plays=("cheer", "sit"))
    scenery = child(scene, "Scenery")
    build_stand(scenery)
    ball = add(scenery, "Ball", [(lathe(0, 0, BALL, 16), material("Leather", (0.85,) * 3))])
    ball.location = FOCUS
    for shot, (name, lens, place, target) in enumerate(CAMERAS):
        made = camera(scene, name, near=0.2, far=150.0, lens=lens)
        aim(made, place, target)
        scene.timeline_markers.new(name, frame=1 + 40 * shot).camera = made
    scene.camera = scene.timeline_markers[0].camera

    settings = scene.crowd_lod
    settings.characters = characters
    settings.forward = "X"
    crowd = first_crowd(settings)
    crowd.count = 3000
    crowd.seed = 5
    crowd.size = (SIZE, SIZE)
    crowd.machine = machine
    crowd.map_image = interest_map(parse(machine.as_string(), "stand"))
    crowd.spawn_on = "CURVES"
    crowd.spawn_object = first_row(scenery)
    crowd.rows = ROWS
    crowd.row_depth = DEPTH
    crowd.row_rise = RISE
    crowd.face = ball
    crowd.first_frame = 1
    settings.frames = ""
    settings.step = 20
    settings.width = 960
    settings.margin_kind = "DERIVED"
    layer = scene.view_layers[0]
    layer.update()
    spawn_source.read_places(crowd, settings.forward, layer.depsgraph)


BALL = [(0.11 * sin(radians(a)), 0.11 - 0.11 * cos(radians(a))) for a in range(15, 180, 15)]


def who_cheer(text: str) -> str:
    """Return the state machine `text`, whose state "cheer" plays the action "cheer"."""
    root = json.loads(text)
    root["states"]["cheer"]["action"] = "cheer"
    return json.dumps(root, indent=1)


def on_row(row: float, angle: float, up: float) -> tuple[float, float, float]:
    """Return the place `up` meters above a row, at an angle from +y, radians clockwise."""
    radius = RADIUS + row * DEPTH
    return radius * sin(angle), radius * cos(angle), row * RISE + up


# name, focal length (mm), where it is, what it looks at
CAMERAS = (
    ("From the pitch", 28, (-6, 11, 2.0), (1, 30, 4.2)),
    ("Over shoulders", 28, on_row(17.6, -0.35, 1.5), FOCUS),
    ("Along a row", 50, on_row(5.0, -1.3, 1.6), on_row(7.0, 0.2, 1.0)),
)


def interest_map(machine) -> bpy.types.Image:
    """Return the label map, one cell for each square meter: who is lively, and who is quiet."""
    x, y = np.meshgrid(*[np.arange(SIZE) + 0.5 - SIZE / 2] * 2)
    angle = np.arctan2(x, y)
    labels = np.full(angle.shape, machine.labels.index("seats"))
    labels[np.abs(angle) < LIVELY] = machine.labels.index("lively")
    labels[angle > QUIET] = machine.labels.index("quiet")
    return image_data.write_image("Interest map", machine.label_colors[labels])


def first_row(scenery: bpy.types.Collection) -> bpy.types.Object:
    """Add the curve of the first row; the others follow behind it."""
    curve = bpy.data.curves.new("First row", "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new("POLY")
    spline.points.add(len(ANGLES) - 1)
    for point, angle in zip(spline.points, ANGLES.tolist(), strict=True):
        point.co = (*on_row(0, angle, 0.0), 1)
    made = bpy.data.objects.new("First row", curve)
    scenery.objects.link(made)
    return made


def build_stand(scenery: bpy.types.Collection) -> None:
    """Add steps, benches, and the pitch before them."""
    steps = [material(f"Concrete {k}", (tone,) * 3) for k, tone in enumerate((0.50, 0.44))]
    bench = material("Bench", (0.05, 0.12, 0.30))
    parts = [(tile(-300, -300, 300, 300, -0.06), material("Around", (0.32, 0.33, 0.34)))]
    parts += [
        (tile(x, -40, x + 5, 20, 0), material(f"Grass {x}", (0.10, 0.24 + x % 2 * 0.03, 0.06)))
        for x in range(-35, 35, 5)
    ]
    for row in range(ROWS):
        radius = RADIUS + row * DEPTH
        z = row * RISE
        parts.append((sector(radius - FRONT, radius - FRONT + DEPTH, -0.06, z), steps[row % 2]))
        parts.append((sector(radius - 0.16, radius + 0.16, z + SEAT - 0.08, z + SEAT), bench))
    add(scenery, "Stand", parts)


def sector(inner: float, outer: float, z0: float, z1: float) -> Polygons:
    """Return a bent bar between two radii and two heights, along all ANGLES."""
    corners = ((inner, z0), (outer, z0), (outer, z1), (inner, z1))
    points = [
        (radius * sin(angle), radius * cos(angle), z)
        for angle in ANGLES.tolist()
        for radius, z in corners
    ]
    faces = [
        (4 * k + i, 4 * k + (i + 1) % 4, 4 * k + 4 + (i + 1) % 4, 4 * k + 4 + i)
        for k in range(len(ANGLES) - 1)
        for i in range(4)
    ]
    last = len(points) - 4
    return points, [(3, 2, 1, 0), *faces, (last, last + 1, last + 2, last + 3)]
