"""The press of Simulate: the simulated crowds walk, populated where there are characters."""

from collections.abc import Generator

import bpy

from ..blender.operator import Stepwise
from ..settings import needs
from ..settings.crowds import set_lengths
from .machine import kept_meshes
from .populate import populate_scene
from .sources.crowd_sources import depsgraph_of
from .sources.simulate import lay_out, simulate_changed
from .sources.simulation_sites import lacking
from .sources.simulation_source import simulated_crowds


def simulate_scene(scene: bpy.types.Scene) -> Generator[float, None, tuple[str, list[str]]]:
    """Simulate the scene's crowds whose source it is, and populate them with its characters.

    Yields the progress, and returns a sentence on the result and the sentences that warn. What is
    up to date is not simulated again. CrowdError, before anything changes, if a setting is bad.
    """
    if scene.crowd_lod.characters is not None:
        return (yield from populate_scene(scene))
    crowds = simulated_crowds(scene)
    depsgraph = depsgraph_of(scene)
    set_lengths(scene)
    with kept_meshes.restore_on_failure(crowds):
        lay_out(scene, depsgraph)
        said = yield from simulate_changed(scene, (), depsgraph)
    return said or "The simulation is up to date.", []


def _simulated(scene: bpy.types.Scene) -> str:
    return lacking() if simulated_crowds(scene) else "Set the Source of a crowd to Simulation"


class CROWDLOD_OT_simulate(Stepwise, bpy.types.Operator):
    """Let people walk to their goals, around walls and each other: all crowds of this source"""

    bl_idname = "crowd_lod.simulate"
    bl_label = "Simulate"
    needs = (needs.crowds, _simulated)

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        result, warnings = yield from simulate_scene(scene)
        scene.crowd_lod.overlay = True
        for warning in warnings:
            self.report({"WARNING"}, warning)
        return result


CLASSES = (CROWDLOD_OT_simulate,)
