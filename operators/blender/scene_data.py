"""Values from a scene's settings, and which scene owns a collection."""

from collections.abc import Iterator
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame_range import parse_frames
from ...crowd_lod.levels.cost_model import Costs, default_costs

EEVEE = "BLENDER_EEVEE" if bpy.app.version >= (5, 0, 0) else "BLENDER_EEVEE_NEXT"
BLENDER_ENGINES = {"CYCLES": "CYCLES", "EEVEE": EEVEE}  # the engine of each result of engine_of


def engine_of(scene: bpy.types.Scene) -> str:
    """Return CYCLES or EEVEE, the engine that stands for the scene's own.

    Costs are known only for these two. EEVEE stands for every engine other than Cycles.
    """
    return "CYCLES" if scene.render.engine == "CYCLES" else "EEVEE"


def remap(render: bpy.types.RenderSettings, frames: float) -> float:
    """Convert frames of the timeline to frames of the animation (Time Stretching)."""
    return frames * render.frame_map_old / render.frame_map_new


def frame_rate(scene: bpy.types.Scene) -> float:
    """Return the frames of the timeline a second."""
    return scene.render.fps / scene.render.fps_base


def time_of(scene: bpy.types.Scene) -> float:
    """Return the scene's current time with its sub-frame, in frames of the animation.

    Keyframes are evaluated at these frames.
    """
    return remap(scene.render, scene.frame_current + scene.frame_subframe)


def frames_of(scene: bpy.types.Scene, step: int = 1) -> list[int]:
    """Return the frames of the shot: those of the settings, or the scene's.

    step: every so many frames of a range.
    """
    return parse_frames(scene.crowd_lod.frames or range_of(scene), step)


def range_of(scene: bpy.types.Scene) -> str:
    """Return the scene's range of frames as the settings write it: 1:250."""
    return f"{scene.frame_start}:{scene.frame_end}"


def meters(scene: bpy.types.Scene) -> float:
    """Return the meters in one unit of length of the scene."""
    units = scene.unit_settings
    return 1.0 if units.system == "NONE" else units.scale_length


def set_node_input(modifier: bpy.types.NodesModifier, name: str, value) -> None:
    """Set the input `name` of the modifier's node group, in any Blender version."""
    socket = next(
        s
        for s in modifier.node_group.interface.items_tree
        if s.item_type == "SOCKET" and s.name == name
    )
    if bpy.app.version >= (5, 2, 0):
        getattr(modifier.properties.inputs, socket.identifier).value = value
    else:
        modifier[socket.identifier] = value


def node_inputs(modifier: bpy.types.NodesModifier) -> dict[str, Any]:
    """Return the inputs of the modifier's node group, in any Blender version: RNA path -> value.

    The paths begin at the modifier; values are as of `plain`. There are none without a node group.
    """
    if bpy.app.version < (5, 2, 0):
        # a boolean of a file that was opened again is an integer
        values = (
            (f'["{key}"]', int(value) if isinstance(value, bool) else value)
            for key, value in modifier.items()
        )
    else:
        values = _node_properties(modifier.properties.inputs) if modifier.properties else ()
    return {path: plain(value) for path, value in values}


def plain(value) -> Any:
    """Return a node's value: a number, text, data-block or None as it is, a vector as a tuple."""
    return tuple(value) if hasattr(value, "__len__") and not isinstance(value, str) else value


def _node_properties(inputs: bpy.types.bpy_struct) -> Iterator[tuple[str, Any]]:
    for identifier in inputs.bl_rna.properties.keys():
        # Blender may list sockets of a node group that has changed since
        socket = None if identifier == "rna_type" else getattr(inputs, identifier, None)
        for name in ("type", "attribute_name", "layer_name", "value"):
            if hasattr(socket, name):
                yield f".properties.inputs.{identifier}.{name}", getattr(socket, name)


def rotation(forward: str) -> float:
    """Return the radians about z that turn a character from facing `forward` to +x.

    +x is heading 0.

    forward: X, Y, -X or -Y.
    """
    return {"X": 0.0, "Y": -np.pi / 2, "-X": np.pi, "-Y": np.pi / 2}[forward]


def look_at(camera: bpy.types.Object, origin, X, Y, Z) -> None:
    """Place `camera` at `origin` (3,) with the axes X, Y, Z of its referential."""
    matrix = np.eye(4)
    matrix[:3, 0] = X
    matrix[:3, 1] = Y
    matrix[:3, 2] = -np.asarray(Z)
    matrix[:3, 3] = origin
    camera.matrix_world = Matrix(matrix.tolist())


def check_own(scene: bpy.types.Scene) -> None:
    """Raise CrowdError if the scene is linked: Blender allows no changes to it."""
    if scene.library is not None:
        raise CrowdError(
            f"The scene {scene.name} is linked from {scene.library.filepath}: work in that file, "
            "or make the scene local in the Outliner (ID Data, Make Local)."
        )


def is_shared(scene: bpy.types.Scene, name: str) -> bool:
    """Return whether another scene or file has the collection of the setting `name`.

    True if another scene has the same collection in that setting (one of the scenes may be a linked
    copy of the other), or if the collection comes from a library.
    """
    top = getattr(scene.crowd_lod, name)
    return top is not None and (top.library is not None or _of_others(scene, name, top))


def _of_others(scene: bpy.types.Scene, name: str, top: bpy.types.Collection) -> bool:
    return any(
        other != scene and getattr(other.crowd_lod, name) == top for other in bpy.data.scenes
    )


def let_go(scene: bpy.types.Scene, name: str) -> None:
    """Unlink the collection of the setting `name`; other scenes keep it."""
    top = getattr(scene.crowd_lod, name)
    setattr(scene.crowd_lod, name, None)
    if top is not None and top.name in scene.collection.children:
        scene.collection.children.unlink(top)


def samples_of(scene: bpy.types.Scene) -> int:
    """Return the samples per pixel that the scene's engine takes."""
    return (
        scene.cycles.samples if scene.render.engine == "CYCLES" else scene.eevee.taa_render_samples
    )


def costs_of(scene: bpy.types.Scene) -> Costs:
    """Return the costs of the scene's engine and samples."""
    return default_costs(engine_of(scene), samples_of(scene))
