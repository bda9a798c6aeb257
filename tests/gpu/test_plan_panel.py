"""What the sidebar and the eyedropper say of a shot plan, as the overlay finds it."""

import bpy
from crowd_lod_extension.operators.ui import shot_panels, steps
from crowd_lod_extension.operators.viewport import viewport_overlay
from crowd_lod_extension.operators.viewport.hud import describe

from ..support.overlays import populated, shown


def test_the_panel_says_whether_the_plan_holds_in_the_frame_that_is_shown(tmp_path):
    with populated(60, cone=1.0, cube=2.0) as scene:
        settings = scene.crowd_lod
        shown(scene)
        seen = viewport_overlay.latest(scene).visible
        settings.agent = int(seen.argmax())
        settings.level_count = 1
        entry = settings.overrides.add()
        entry.agents = str(settings.agent)
        entry.type = "HIDE"
        settings.frames = "1:3"
        settings.output_folder = str(tmp_path)
        with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
            assert bpy.ops.crowd_lod.plan_shot() == {"FINISHED"}
        scene.frame_set(2)
        frame = shown(scene).frame
        assert shot_panels.describe_hold(scene) == ("Plan up to date", "CHECKMARK")
        assert not frame.visible[settings.agent] and seen[settings.agent]
        said = describe(viewport_overlay.account_of(scene))
        assert said == f"Agent {settings.agent}, culled: override"
        # what the user changes shows at the next redraw
        entry.type = "ALWAYS"
        entry.level = 0
        shown(scene)
        assert shot_panels.describe_hold(scene) == (
            "Outdated: the overrides changed. Plan again.",
            "ERROR",
        )
        said = [sentence for sentence, *_ in steps.messages(scene)]
        assert any(
            each.startswith("The shot plan is not used, for the overrides changed since")
            for each in said
        )
        said = describe(viewport_overlay.account_of(scene))
        assert said.startswith(f"Agent {settings.agent}, LOD 0 (override): ")
        entry.type = "HIDE"
        shown(scene)
        assert shot_panels.describe_hold(scene)[1] == "CHECKMARK"
        scene.frame_set(9)
        shown(scene)
        said = [sentence for sentence, *_ in steps.messages(scene)]
        assert "The shot plan covers frames 1 to 3: elsewhere LODs follow from distances." in said
        settings.overlay = False
        assert shot_panels.describe_hold(scene) == ("Plan up to date", "CHECKMARK")
