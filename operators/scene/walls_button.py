"""Walls from Selection: agents walk round what is selected, or round what is in their way."""

from collections.abc import Iterable

import bpy

from ...crowd_lod.crowd.machine_edits import edit_text
from ...crowd_lod.crowd.machine_walls import WALL, add_wall
from ...crowd_lod.errors import CrowdError
from ..blender import scene_data
from ..blender.character_objects import is_scenery
from ..blender.operator import Reporting
from ..machine import map_areas
from ..machine.scene_world import machine_of, machine_text
from ..settings import needs
from .looking_around import look_around
from .obstacles import WALLS, find_obstacles
from .plausible import places_of
from .scene_crowd import trajectory_of


class CROWDLOD_OT_walls_from_selection(Reporting, bpy.types.Operator):
    """Lead agents round the selected objects; with none selected, round all in their way"""

    bl_idname = "crowd_lod.walls_from_selection"
    bl_label = WALLS
    needs = (needs.crowd,)

    def run(self, context) -> str:
        scene = context.scene
        settings = scene.crowd_lod
        depsgraph = context.evaluated_depsgraph_get()
        chosen = [item for item in context.selected_objects if is_scenery(item)]
        items = [
            item
            for item in chosen or _obstacles(scene, depsgraph)
            if any(True for _ in map_areas.triangles_in([item], depsgraph))
        ]
        if not items:
            raise CrowdError(
                "Nothing stands in the agents' way: select the objects that they are to walk round."
            )
        turned = _add_wall_label(settings)
        map_areas.add_areas(settings, items, WALL)
        cells = map_areas.make(settings, depsgraph)
        return (
            f"{_listed(items)}: {len(items)} walls on {cells:,} cells of the map.{turned} Press "
            f"Populate."
        )


def _obstacles(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> list[bpy.types.Object]:
    """Return what the agents of the scene's own crowd would walk through."""
    part = trajectory_of(scene).parts[0]
    places = places_of(part)
    left_out = set(scene.crowd_lod.characters.all_objects)
    around = look_around(depsgraph, places, 0.0, scene_data.meters(scene), left_out)
    return find_obstacles(scene.crowd_lod, depsgraph, part, places, around.names)


def _add_wall_label(settings) -> str:
    """Give the state machine a wall, if it has none; return a sentence on that.

    A machine that the scene does not own, such as the chapter's, gets a copy.
    """
    if WALL in machine_of(settings).labels:
        return ""
    text = settings.machine
    name = text.name if text is not None else "chapter"
    content = edit_text(machine_text(settings), name, add_wall())
    if text is None or text.library is not None:
        text = settings.machine = bpy.data.texts.new(name)
    text.from_string(content)
    return f" The state machine {text.name} turns agents back at them."


def _listed(items: Iterable[bpy.types.Object]) -> str:
    names = [item.name for item in items]
    return ", ".join(names[:4]) + (" ..." if len(names) > 4 else "")


CLASSES = (CROWDLOD_OT_walls_from_selection,)
