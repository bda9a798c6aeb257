"""The button that proves a few frames of the shot by renders."""

from collections.abc import Generator
from pathlib import Path

import bpy

from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame_range import spread_evenly
from ...crowd_lod.validation.render_proof import verdict, worst_agents
from ..blender import scene_data
from ..blender.operator import Reporting, Stepwise
from ..blender.output_folders import output_folder, place_of
from ..freshness.artifacts import ProofResult, note_proof, proof_parts
from ..overlay.viewport_image import show_image
from ..settings import needs
from .verify import Verify, verify
from .verify_build import frames_to_verify

PICTURE = "Crowd LOD Proof"


def _show_agents(path: Path) -> None:
    """Keep the picture of the worst agents in the file as the image PICTURE, for the Image Editor."""
    image = bpy.data.images.get(PICTURE) or bpy.data.images.load(str(path))
    image.name = PICTURE
    image.use_fake_user = True  # nothing else uses it
    if image.packed_file is not None:
        image.unpack(method="REMOVE")
    image.filepath = str(path)
    image.reload()
    image.pack()


class CROWDLOD_OT_verify(Stepwise, bpy.types.Operator):
    bl_description = (
        "Render a few frames of the build beside everyone at full detail, compare them, and "
        "write a report"
    )
    bl_idname = "crowd_lod.verify"
    bl_label = "Verify"
    renders = True
    bl_options = {"REGISTER"}
    needs = (needs.characters, needs.camera)

    def work(self, scene: bpy.types.Scene) -> Generator[float, None, str]:
        settings = scene.crowd_lod
        frames = frames_to_verify(scene, scene_data.frames_of(scene))
        task = Verify(
            frames=spread_evenly(frames, settings.verify_count),
            folder=output_folder(scene, "verify"),
        )
        made_of = proof_parts(scene)
        result = yield from verify(scene, task, ["sidebar"])
        if result["agents"]:
            worst = result["agents"][worst_agents(result["agents"])[0]]
            _show_agents(task.folder / f"frame_{worst['frame']:04d}_agents.png")
        sentence = f"{verdict(result)} The report is in {place_of(task.folder)}."
        note_proof(scene, ProofResult(sentence, result["ok"], made_of))
        if not result["ok"]:
            raise CrowdError(sentence)  # the report stays
        return sentence


def _no_proof(scene: bpy.types.Scene) -> str:
    return "" if PICTURE in bpy.data.images else "There is no proof yet: press Verify"


class CROWDLOD_OT_show_proof(Reporting, bpy.types.Operator):
    """Show the worst agents of the last proof: at full detail, as built, and where they differ"""

    bl_idname = "crowd_lod.show_proof"
    bl_label = "Show Proof"
    bl_options = {"REGISTER"}
    needs = (_no_proof,)

    def run(self, context) -> str:
        show_image(PICTURE)
        return f"A window shows the image {PICTURE}."


CLASSES = (CROWDLOD_OT_verify, CROWDLOD_OT_show_proof)
