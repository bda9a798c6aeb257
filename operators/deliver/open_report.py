"""The button that shows a report in the web browser."""

from pathlib import Path

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import printable
from ..blender.labeled_properties import EnumProperty
from ..blender.operator import Reporting
from ..blender.output_folders import output_folder

# the buttons that write a report, by what scripts call it; the folder is named alike
REPORTS = {
    "PREVIEW": "Preview",
    "PLAN": "Plan Shot",
    "VERIFY": "Verify",
    "ERROR": "Report Error",
}


def report_path(scene: bpy.types.Scene, kind: str) -> Path:
    """Return where the report is, once it is made.

    kind: one of REPORTS.

    CrowdError if the setting of the folder is empty, or the working folder was deleted.
    """
    return output_folder(scene, kind.lower()) / "report.html"


class CROWDLOD_OT_open_report(Reporting, bpy.types.Operator):
    """Show the report in the web browser"""

    bl_idname = "crowd_lod.open_report"
    bl_label = "Open Report"
    bl_options = {"REGISTER"}

    which: EnumProperty(
        name="Report",
        items=[(kind, title, f"The report of {title}") for kind, title in REPORTS.items()],
    )

    def run(self, context) -> str:
        path = report_path(context.scene, self.which)
        if not path.is_file():
            raise CrowdError(
                f"There is no report {printable(path)} yet: press {REPORTS[self.which]}."
            )
        bpy.ops.wm.url_open(url=path.as_uri())
        return f"The web browser shows {printable(path)}."


CLASSES = (CROWDLOD_OT_open_report,)
