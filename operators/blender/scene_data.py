"""What a scene's settings say, and whose its collections are."""

import bpy
import numpy as np
from mathutils import Matrix

from ...crowd_lod.errors import CrowdError

EEVEE = "BLENDER_EEVEE" if bpy.app.version >= (5, 0, 0) else "BLENDER_EEVEE_NEXT"


def engine_of(scene: bpy.types.Scene) -> str:
    """The engine that `scene` is rendered by, of those whose costs are known: EEVEE in place of one that draws as it does."""
    return "CYCLES" if scene.render.engine == "CYCLES" else "EEVEE"


def remapped(render: bpy.types.RenderSettings, frames: float) -> float:
    """`frames` of the timeline in the frames of the animation, which "Time Stretching" makes others."""
    return frames * render.frame_map_old / render.frame_map_new


def time_of(scene: bpy.types.Scene) -> float:
    """The scene's current time with its sub-frame, in frames of the animation: what keyframes are evaluated at."""
    return remapped(scene.render, scene.frame_current + scene.frame_subframe)


def metres(scene: bpy.types.Scene) -> float:
    """The metres that a unit of length of the scene is."""
    units = scene.unit_settings
    return 1.0 if units.system == "NONE" else units.scale_length


def set_node_input(modifier: bpy.types.NodesModifier, name: str, value) -> None:
    """Set the node group's input called `name` on its modifier, in the way of this Blender."""
    socket = next(s for s in modifier.node_group.interface.items_tree if s.item_type == "SOCKET" and s.name == name)
    if bpy.app.version >= (5, 2, 0):
        getattr(modifier.properties.inputs, socket.identifier).value = value
    else:
        modifier[socket.identifier] = value


def rotation(forward: str) -> float:
    """Radians about z that turn a character that faces `forward` (X, Y, -X, -Y) to +x, which is heading 0."""
    return {"X": 0.0, "Y": -np.pi / 2, "-X": np.pi, "-Y": np.pi / 2}[forward]


def look_at(camera: bpy.types.Object, origin, X, Y, Z) -> None:
    """Place `camera` at `origin` (3,) with the referential X, Y, Z."""
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = X, Y, -np.asarray(Z), origin
    camera.matrix_world = Matrix(matrix.tolist())


def check_own(scene: bpy.types.Scene) -> None:
    """CrowdError if nothing can be put into the scene: Blender lets nobody."""
    if scene.library is not None:
        raise CrowdError(
            f"The scene {scene.name} is linked from {scene.library.filepath}: work in that file, or make the scene local in "
            "the Outliner (ID Data, Make Local)."
        )


def shared(scene: bpy.types.Scene, name: str) -> bool:
    """Whether the collection in the setting `name` is another scene's too, of which this may be a linked copy, or another
    file's."""
    top = getattr(scene.crowd_lod, name)
    return top is not None and (top.library is not None or _of_others(scene, name, top))


def _of_others(scene: bpy.types.Scene, name: str, top: bpy.types.Collection) -> bool:
    return any(other != scene and getattr(other.crowd_lod, name) == top for other in bpy.data.scenes)


def let_go(scene: bpy.types.Scene, name: str) -> None:
    """Take the collection in the setting `name` out of the scene, a copy of another, where it stays."""
    top = getattr(scene.crowd_lod, name)
    setattr(scene.crowd_lod, name, None)
    if top is not None and top.name in scene.collection.children:
        scene.collection.children.unlink(top)
