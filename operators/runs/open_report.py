"""The button that shows a report in the web browser."""

from pathlib import Path

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import printable
from ...crowd_lod.reporting.output_index import NAME as INDEX
from ..blender.labeled_properties import EnumProperty
from ..blender.operator import Reporting
from ..blender.output_folders import output_folder
from ..blender.output_index import TITLES

# the names of the reports, by what they are called in scripts: of a step, and the index of all
REPORTS = {name.upper(): name for name in ("preview", "plan", "verify")} | {"ALL": ""}


def report_path(scene: bpy.types.Scene, kind: str) -> Path:
    """Return where the report is, once it is made.

    kind: one of REPORTS; ALL is the index of all that lies in the output folder.

    CrowdError if the setting of the folder is empty, or the working folder was deleted.
    """
    part = REPORTS[kind]
    return output_folder(scene, part) / ("report.html" if part else INDEX)


class CROWDLOD_OT_open_report(Reporting, bpy.types.Operator):
    """Show the report in the web browser"""

    bl_idname = "crowd_lod.open_report"
    bl_label = "Open Report"
    bl_options = {"REGISTER"}

    which: EnumProperty(
        name="Report",
        items=[
            (
                key,
                TITLES.get(part, "All"),
                f"The report of {TITLES[part]}" if part else "What lies in the output folder",
            )
            for key, part in REPORTS.items()
        ],
    )

    def run(self, context) -> str:
        path = report_path(context.scene, self.which)
        if not path.is_file():
            raise CrowdError(
                f"There is no report {printable(path)} yet: press "
                f"{TITLES.get(REPORTS[self.which], 'Plan Shot')}."
            )
        bpy.ops.wm.url_open(url=path.as_uri())
        return f"The web browser shows {printable(path)}."


CLASSES = (CROWDLOD_OT_open_report,)
