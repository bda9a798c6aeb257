"""Use Measured Error: what a proof saw of a LOD becomes its bound; it then begins farther away."""

import bpy

from ....crowd_lod.format import number
from ...blender import scene_data
from ...blender.operator import Reporting
from ...freshness.artifacts import current_proof, look_again


def lacks_error(scene: bpy.types.Scene) -> str:
    """Return why the last proof mends no LOD; "" if it does."""
    if scene.crowd_lod.choice != "BY_TOLERANCE":
        return "LODs by distance begin where you set them: change Threshold"
    proof = current_proof(scene)
    if proof is None or not proof.worst:
        return "All LODs passed the last proof"
    return "" if proof.worst["predicted_px"] else "The agent that is off shows no LOD"


class CROWDLOD_OT_use_measured_error(Reporting, bpy.types.Operator):
    """Start the failed LOD farther away, where its measured error is within the tolerance"""

    bl_idname = "crowd_lod.use_measured_error"
    bl_label = "Use Measured Error"
    needs = (lacks_error,)

    def run(self, context) -> str:
        scene = context.scene
        worst = current_proof(scene).worst
        level = worst["lod"]
        group = scene.crowd_lod.groups[worst["group"]]
        bounds = [*group.bounds]
        measured = bounds[level] * worst["error_px"] / worst["predicted_px"]
        # coarser LODs begin no nearer
        group.bounds = [
            max(bound, measured) if k >= level else bound for k, bound in enumerate(bounds)
        ]
        look_again(scene)
        millimeters = 1000 * scene_data.meters(scene)
        return (
            f"LOD {level} of {group.name} counts with an error of {number(millimeters * measured)} "
            f"mm, before {number(millimeters * bounds[level])} mm: press Update All."
        )


CLASSES = (CROWDLOD_OT_use_measured_error,)
