"""How large what is handed over will be: Estimate Cost, and its answers for the panel."""

from collections.abc import Generator
from contextlib import suppress
from typing import NamedTuple

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import byte_size
from ...crowd_lod.progress import share
from ..blender import scene_data
from ..blender.operator import Stepwise
from ..render_setup.cost_estimate import CHOICES, estimate
from ..settings import needs
from ..usd.size import estimate_usd

# the names of their rows in the table of the estimate
USD = "USD"
TASK = "Farm Task"


class Size(NamedTuple):
    """What an output takes, as text such as "12 MB"; "-" where it takes none."""

    memory: str
    file: str


def sizes_of(settings) -> dict[str, Size]:
    """Return the sizes of a bake, of the USD file and of what a farm's task opens, as far as known.

    The keys are the operators that make them.
    """
    rows = {
        name: Size(*cells[:2])
        for name, *cells in (line.split("\t") for line in settings.estimate.splitlines()[1:])
        if len(cells) > 1
    }
    names = {
        "crowd_lod.bake": f"{CHOICES[settings.choice]}, Baked",
        "crowd_lod.export_usd": USD,
        "crowd_lod.write_farm_job": TASK,
    }
    return {operator: rows[name] for operator, name in names.items() if name in rows}


class CROWDLOD_OT_estimate(Stepwise, bpy.types.Operator):
    """Estimate memory, file size and render time for each way to choose LODs"""

    bl_idname = "crowd_lod.estimate"
    bl_label = "Estimate Cost"
    needs = (
        needs.crowd,
        needs.camera,
    )

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        settings = scene.crowd_lod
        costs = yield from share(estimate(scene, settings), 0.0, 0.7)
        memory = costs.prices[f"{CHOICES[settings.choice]}, Baked"].memory
        task = (TASK, byte_size(memory), byte_size(costs.rendered_file), "-")
        lines = [costs.table, "\t".join(task)]
        sentence = costs.sentence
        with suppress(CrowdError):  # nobody is in sight, which Export USD says
            frames = scene_data.frames_of(scene)
            size = yield from share(estimate_usd(scene, frames, settings.usd_animated), 0.7, 1.0)
            file = byte_size(size)
            lines.append("\t".join((USD, "-", file, "-")))
            sentence = f"{sentence} The USD file: about {file}."
        settings.estimate = "\n".join(lines)
        return sentence


CLASSES = (CROWDLOD_OT_estimate,)
