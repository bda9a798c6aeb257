"""The scene of the chapter's figure 1.5: 4,096 agents on a plane.

They walk right to the edge, turn, and walk left.
"""

import bpy
import numpy as np

from ..crowd_lod.crowd.state_machine import parse, preset_text
from ..operators.blender import image_data
from ..operators.settings.crowds import first_crowd
from .characters import make_characters
from .scenery import add, aim, camera, child, film, material, tile

SIZE = 80  # meters, and cells of the map, along x and y


def make(scene: bpy.types.Scene) -> None:
    """Fill the new scene."""
    film(scene)
    machine = bpy.data.texts.new("chapter.json")
    machine.from_string(preset_text("chapter"))
    machine.cursor_set(0)
    table = parse(machine.as_string(), "chapter")
    labels = np.full((SIZE, SIZE), table.labels.index("ground"), np.uint8)
    labels[:, 0] = table.labels.index("left edge")
    labels[:, -1] = table.labels.index("right edge")
    characters = child(scene, "Characters", hidden=True)
    make_characters(characters, speed=1.25)
    build_ground(child(scene, "Scenery"))

    # The main camera stands at one corner: the near agents and both flanks are culled.
    scene.camera = camera(scene, "Main camera", near=0.5, far=90.0)
    aim(scene.camera, (-34, -42, 8), (2, 4, -6))
    above = camera(scene, "Auxiliary camera", near=1.0, far=400.0)
    aim(above, (-52, -122, 112), (2, 2, 0))

    settings = scene.crowd_lod
    settings.characters = characters
    settings.forward = "X"
    crowd = first_crowd(settings)
    crowd.count = 4096
    crowd.seed = 1
    crowd.center = (0, 0, 0)
    crowd.size = (SIZE, SIZE)
    crowd.map_image = image_data.write_image("Chapter map", table.label_colors[labels])
    crowd.machine = machine
    crowd.first_frame = 1
    settings.frames = ""
    settings.step = 10
    settings.width = 960
    settings.choice = "BY_DISTANCE"
    settings.level_count = 3
    settings.ratios[:3] = (1.0, 0.4, 0.12)
    settings.thresholds[:2] = (0.3, 0.6)
    settings.margin_kind = "DERIVED"


def build_ground(scenery: bpy.types.Collection) -> None:
    """Add the plane in tiles of 4 m, and the strips of the two edges.

    The strips have the colors of their labels.
    """
    tones = [
        material("Ground light", (0.66, 0.66, 0.63)),
        material("Ground dark", (0.58, 0.58, 0.56)),
    ]
    left = material("Left edge", (0.70, 0.05, 0.05))
    right = material("Right edge", (0.05, 0.05, 0.70))
    around = material("Around", (0.42, 0.44, 0.42))
    half = SIZE // 2
    pitch = 4
    parts = [(tile(-400, -400, 400, 400, -0.05), around)]
    for x in range(-half, half, pitch):
        for y in range(-half, half, pitch):
            parts.append((tile(x, y, x + pitch, y + pitch), tones[(x + y) // pitch % 2]))
    parts.append((tile(-half, -half, 1 - half, half, 0.05), left))
    parts.append((tile(half - 1, -half, half, half, 0.05), right))
    add(scenery, "Ground", parts)
