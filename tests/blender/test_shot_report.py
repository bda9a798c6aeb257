"""The files that Plan Shot writes beside the plan."""

import csv
import io
import json

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.crowd_lod.shot import plan_file
from crowd_lod_extension.operators.render_setup.frame_update import Held
from crowd_lod_extension.operators.scene.scene_crowd import frame_of
from crowd_lod_extension.operators.shot.shot_plan import PlanRequest, plan_shot
from crowd_lod_extension.operators.shot.switch_crops import posed_agent

from ..support.pages import Reader


def files_of(scene, folder):
    """The names and bytes of the files that Plan Shot writes into the folder, of a zoom towards the
    crowd.
    """
    settings = scene.crowd_lod
    lens = scene.camera.data
    settings.choice = "BY_TOLERANCE"
    settings.tolerance = 4.0
    for frame, lens.lens in ((1, 15), (12, 200)):
        lens.keyframe_insert("lens", frame=frame)
    settings.frames = "1:12"
    settings.output_folder = str(folder)
    assert bpy.ops.crowd_lod.plan_shot() == {"FINISHED"}
    return {path.name: path.read_bytes() for path in (folder / "plan").iterdir()}


def test_files_agree_and_come_out_the_same_again(levelled, tmp_path):
    found = files_of(levelled, tmp_path / "one")
    again = files_of(levelled, tmp_path / "again")
    assert found.keys() == again.keys() >= {"plan.npz", "plan.json", "switches.csv", "report.html"}
    assert all(found[name] == again[name] for name in ("plan.npz", "switches.csv"))
    told, own = (json.loads(each["plan.json"])["shot"] for each in (found, again))
    assert told == own
    rows = list(csv.DictReader(io.StringIO(found["switches.csv"].decode())))
    switches = [row for row in rows if row["from"]]
    assert len(switches) == told["plan"]["switches"] > 0
    assert max(float(row["change_px"]) for row in switches) == pytest.approx(
        told["plan"]["largest_switch_pixels"], abs=1e-3
    )
    stored = plan_file.read(tmp_path / "one" / "plan" / "plan.npz")
    for row in switches:
        frame = int(row["frame"])
        agent = int(row["agent"])
        before, after = (
            int(stored.row(f, levelled.crowd_lod.count)[agent]) for f in (frame - 2, frame - 1)
        )
        assert (before, after) == (int(row["from"]), int(row["to"]))


def test_report_tells_the_stages_and_the_curve(levelled, tmp_path):
    found = files_of(levelled, tmp_path / "one")
    read = Reader(found["report.html"].decode())
    assert {"behavior", "culling", "levels", "sorting"} <= set(
        read.texts
    ) and "Milliseconds by stage" in read.texts
    curve = json.loads(found["plan.json"])["shot"]["curve"]
    assert curve["agents"] == levelled.crowd_lod.count
    own = [point for point in curve["points"] if point["kind"] == "plan"]
    assert own[0]["switches"] == json.loads(found["plan.json"])["shot"]["plan"]["switches"]
    assert {point["kind"] for point in curve["points"]} == {
        "plan",
        "thresholds",
        "hysteresis",
        "tolerance",
        "avoid",
    }


def test_largest_changes_are_drawn_into_the_report_and_leave_nothing_in_the_file(
    levelled, tmp_path
):
    before = set(bpy.data.user_map())
    page = Reader(files_of(levelled, tmp_path / "one")["report.html"].decode())
    assert sum(link.startswith("data:image/png;base64,") for link in page.links) == 9
    assert {block.id_type for block in set(bpy.data.user_map()) - before} <= {
        "ACTION"
    }  # that of the zoom
    told = finished(plan_shot(levelled, PlanRequest(range(1, 13), tmp_path / "again"))).report
    for one, other in told.crops:
        assert (
            one.shape == other.shape and (one != other).any() and (one[0, 0] == one[-1, -1]).all()
        )


def shown_of(scene):
    """The points (n, 3) of each instance of the build, world space, by the place of its agent,
    rounded.
    """
    found = {}
    for each in bpy.context.evaluated_depsgraph_get().object_instances:
        if (
            each.is_instance
            and "crowd_lod_level" in each.parent.original
            and each.object.type == "MESH"
        ):
            matrix = np.array(each.matrix_world, np.float64)
            mesh = each.object.data
            points = np.empty((len(mesh.vertices), 3), np.float32)
            mesh.vertices.foreach_get("co", points.ravel())
            found.setdefault(tuple(matrix[:2, 3].round(3)), []).append(
                points @ matrix[:3, :3].T + matrix[:3, 3]
            )
    return {place: np.concatenate(parts) for place, parts in found.items()}


@pytest.mark.parametrize("forward", ["X", "-Y"])
def test_an_agent_is_drawn_as_the_build_shows_it(levelled, forward):
    levelled.crowd_lod.forward = forward
    bpy.ops.crowd_lod.build()
    levelled.frame_set(9)
    frame = frame_of(levelled, bpy.context.evaluated_depsgraph_get())
    shown = shown_of(levelled)
    order = frame.buckets.order.tolist()
    levels = frame.buckets.levels.tolist()
    for agent, level in list(zip(order, levels, strict=True))[:: len(order) // 6]:
        own = shown[tuple(np.array(frame.crowd.places(None, agent)[:2]).round(3))]
        (body,), _ = posed_agent(levelled, agent, Held(frame.crowd, 9.0), [level])
        for end in (np.min, np.max, np.mean):
            assert end(body.points, axis=0) == pytest.approx(end(own, axis=0), abs=1e-4)
