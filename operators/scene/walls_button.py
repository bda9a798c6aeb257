"""Walls from Selection: agents walk round what is selected, or round what is in their way."""

from collections.abc import Iterator, Sequence

import bpy

from ...crowd_lod.crowd.machine_edits import WALL, add_wall, edit_text
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import counted
from ...crowd_lod.message_words import listed
from ...crowd_lod.messages import MessageKind, from_json, to_json
from ..blender import scene_data
from ..blender.character_objects import selected_scenery
from ..blender.operator import Reporting
from ..settings import needs
from ..settings.crowds import crowds_of, index_of_active
from .machine import map_areas
from .machine.scene_world import machine_of, machine_text
from .obstacles import find_obstacles, look_around, no_scenery
from .plausible import places_of
from .scene_crowd import trajectory_of


class CROWDLOD_OT_walls_from_selection(Reporting, bpy.types.Operator):
    """Make agents avoid the selected objects; with nothing selected, all objects in their way"""

    bl_idname = "crowd_lod.walls_from_selection"
    bl_label = "Walls from Selection"
    needs = (needs.crowd,)

    def run(self, context) -> str:
        scene = context.scene
        depsgraph = context.evaluated_depsgraph_get()
        walls = [
            (crowd, [item for item in items if _has_faces(item, depsgraph)])
            for crowd, items in _in_the_way(scene, depsgraph, selected_scenery(context))
        ]
        sentences = [_lead_round(*wall, depsgraph) for wall in walls if wall[1]]
        if not sentences:
            raise CrowdError(
                "Nothing stands in the agents' way: select the objects that agents are to walk "
                "around."
            )
        if not any(items for _, items in _in_the_way(scene, depsgraph, ())):
            told = from_json(scene.crowd_lod.trouble)
            others = [message for message in told if message.kind is not MessageKind.OBSTACLE]
            scene.crowd_lod.trouble = to_json(others)
        return " ".join(sentences)


def _in_the_way(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    selected: Sequence[bpy.types.Object],
) -> Iterator[tuple[bpy.types.PropertyGroup, Sequence[bpy.types.Object]]]:
    """Yield each crowd of the scene, and what its agents are to walk round.

    That is what they would walk through; with objects `selected`, those of it, and all of them for
    the active crowd, but for the ground.
    """
    settings = scene.crowd_lod
    left_out = no_scenery(scene)
    parts = trajectory_of(scene).parts
    active = index_of_active(settings)
    for index, (crowd, part) in enumerate(zip(crowds_of(settings), parts, strict=True)):
        places = places_of(part)
        around = look_around(depsgraph, places, 0.0, scene_data.meters(scene), left_out)
        grounds = set(around.names) - {""}
        if index == active and selected:
            yield crowd, [item for item in selected if grounds != {item.name}]
        elif crowd.use_crowd:
            items = find_obstacles(crowd, depsgraph, part, places, around.names)
            yield crowd, [item for item in items if not selected or item in selected]


def _has_faces(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    return any(True for _ in map_areas.triangles_in([item], depsgraph))


def _lead_round(
    crowd: bpy.types.PropertyGroup,
    items: Sequence[bpy.types.Object],
    depsgraph: bpy.types.Depsgraph,
) -> str:
    """Make the items walls of the crowd's map; return a sentence."""
    turned = _add_wall_label(crowd)
    map_areas.add_areas(crowd, items, WALL)
    cells = map_areas.make(crowd, depsgraph)
    name = f"{crowd.name}: " if len(crowd.id_data.crowd_lod.crowds) > 1 else ""
    walls = counted(len(items), "wall")
    items_named = listed(item.name for item in items)
    return f"{name}{items_named}: {walls} on {counted(cells, 'cell')} of the map.{turned}"


def _add_wall_label(crowd) -> str:
    """Give the state machine a wall, if it has none; return a sentence on that.

    A machine that the scene does not own, such as the chapter's, gets a copy.
    """
    if WALL in machine_of(crowd).labels:
        return ""
    text = crowd.machine
    name = text.name if text is not None else "chapter"
    content = edit_text(machine_text(crowd), name, add_wall())
    if text is None or text.library is not None:
        text = crowd.machine = bpy.data.texts.new(name)
    text.from_string(content)
    return f" Agents turn back there (state machine {text.name})."


CLASSES = (CROWDLOD_OT_walls_from_selection,)
