"""The button that shows a report in the web browser."""

from pathlib import Path

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.format import printable
from ..blender.labeled_properties import EnumProperty
from ..blender.operator import Reporting
from ..blender.output_folders import output_folder

# of each report: what makes it, and the setting of its folder
MADE_BY = {"PREVIEW": ("Preview", "folder"), "PLAN": ("Plan Shot", "plan_folder"), "VERIFY": ("Verify", "verify_folder")}


def report_path(scene: bpy.types.Scene, which: str) -> Path:
    """Return where the report is, once it is made.

    which: one of MADE_BY.

    CrowdError if the folder is relative and the working folder was deleted.
    """
    return output_folder(getattr(scene.crowd_lod, MADE_BY[which][1])) / "report.html"


class CROWDLOD_OT_open_report(Reporting, bpy.types.Operator):
    """Show the report in the web browser"""

    bl_idname = "crowd_lod.open_report"
    bl_label = "Open Report"
    bl_options = {"REGISTER"}

    which: EnumProperty(name="Report", items=[(key, name, f"The report of {name}") for key, (name, _) in MADE_BY.items()])

    def run(self, context) -> str:
        path = report_path(context.scene, self.which)
        if not path.is_file():
            raise CrowdError(f"There is no report {printable(path)} yet: press {MADE_BY[self.which][0]}.")
        bpy.ops.wm.url_open(url=path.as_uri())
        return f"The web browser shows {printable(path)}."


CLASSES = (CROWDLOD_OT_open_report,)
