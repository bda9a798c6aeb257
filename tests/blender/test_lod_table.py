"""What the user is told of the LODs: the table, the rendered silhouettes against the prediction,
the pictures.
"""

import json
import re
from html.parser import HTMLParser

import bpy
import numpy as np
import pytest
from crowd_lod_extension.crowd_lod import progress as work_progress
from crowd_lod_extension.crowd_lod.levels import selection
from crowd_lod_extension.crowd_lod.output.html_report import page
from crowd_lod_extension.crowd_lod.progress import finished
from crowd_lod_extension.operators.blender import image_data
from crowd_lod_extension.operators.cli import commands
from crowd_lod_extension.operators.deliver.preview import lod_picture, lod_table
from crowd_lod_extension.operators.lods.make_lods import make_levels
from crowd_lod_extension.operators.lods.posed_surface import InPose
from crowd_lod_extension.operators.lods.surface import Surface
from crowd_lod_extension.operators.scene import scene_crowd
from crowd_lod_extension.operators.scene.characters import (
    group_measuring,
    stored_groups,
)

from ..support.scene_frames import frame_now

pytestmark = pytest.mark.usefixtures("rough_lods")


def tables_of(scene, folder):
    """The tables of `scene` as its camera sees it, and the frame."""
    frame = frame_now(scene, bpy.context.evaluated_depsgraph_get())
    steps = lod_table.tables(scene_crowd.read_crowd(scene), frame.camera, frame.thresholds, folder)
    progress = []
    while True:
        try:
            progress.append(next(steps))
        except StopIteration as end:
            assert progress == sorted(progress) and progress[-1] == 1.0
            return end.value, frame


WAYS = ("precise", "It has seams.", 12.5), (None, None, None)  # of LOD 1 and 2


def note_ways(levels):
    """Let the LODs of one character say that they were made these ways."""
    for level, way in zip(levels.children[1:], WAYS, strict=False):
        (item,) = (item for item in level.all_objects if item.type == "MESH")
        for key, value in zip(("method", "why", "ms"), way, strict=True):
            item.pop(f"crowd_lod_{key}", None)
            if value is not None:
                item[f"crowd_lod_{key}"] = value


@pytest.mark.once
@pytest.mark.parametrize("choice, kind", [("BY_DISTANCE", "PERSP"), ("BY_TOLERANCE", "ORTHO")])
def test_rendered_silhouettes_stay_within_what_the_deviation_predicts(
    scene, tmp_path, monkeypatch, choice, kind
):
    settings = scene.crowd_lod
    monkeypatch.setattr(selection, "WORTH", 0)  # as many LODs as save anything
    settings.characters.children.unlink(settings.characters.children["adult"])
    scene.camera.data.type = kind
    scene.camera.data.ortho_scale = 40.0
    scene.render.resolution_x = 1920
    settings.choice = choice
    settings.tolerance = 8.0
    settings.frames = "1"
    stored_groups.store_groups(settings, group_measuring.measure_groups(scene))
    list(make_levels(scene))
    note_ways(settings.levels)
    tables, frame = tables_of(scene, tmp_path)
    assert [each["group"] for each in tables] == ["child"]
    for row, way in zip(tables[0]["levels"][1:], WAYS, strict=False):
        assert (row["method"], row["why"], row["ms"]) == way
    checked = 0
    for each, group, thresholds in zip(
        tables, stored_groups.groups_of(settings), frame.thresholds, strict=True
    ):
        assert each["levels"][0]["deviation_mm"] == 0 and len(each["levels"]) == len(
            set(group.triangles)
        )
        assert each["levels"][-1]["to_lod"] == len(group.triangles) - 1
        for row, threshold in zip(each["levels"][1:], thresholds, strict=False):
            assert row["deviation_mm"] == pytest.approx(1000 * group.deviations[row["lod"]])
            assert row["percent"] == pytest.approx(
                100 * group.deviations[row["lod"]] / group.diagonal
            )
            if kind == "PERSP":
                pixels = scene.camera.data.lens / scene.camera.data.sensor_width * 1920
                assert row["from_m"] == threshold
                assert row["predicted_px"] == pytest.approx(
                    group.bounds[row["lod"]] * pixels / (threshold - group.radius), rel=1e-6
                )
            if row["predicted_px"] is not None:
                least, most = row["measured_px_between"]
                assert (
                    least <= row["measured_px"] <= most
                    and most > 0
                    and least <= row["predicted_px"]
                )
                assert 0 < row["picture_difference"] < 0.2 and 0.3 < row["picture_similarity"] < 1
                checked += 1
            if choice == "BY_TOLERANCE" and row["predicted_px"] is not None:
                assert row["predicted_px"] <= 8.0 + 1e-9
    assert checked
    assert json.loads(json.dumps(tables, allow_nan=False)) == tables


@pytest.mark.once
@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_a_group_of_small_agents_is_measured_at_their_size(scene, tmp_path, kind):
    """Predictions hold for the largest agent; a character pictured at its own size shows 1 / 0.44
    of its error.
    """
    settings = scene.crowd_lod
    settings.characters.children.unlink(settings.characters.children["adult"])
    scene.camera.data.type = kind
    scene.camera.data.ortho_scale = 40.0
    scene.render.resolution_x = 1920
    settings.choice = "BY_TOLERANCE"
    settings.tolerance = 8.0
    settings.frames = "1"
    stored_groups.store_groups(settings, group_measuring.measure_groups(scene))
    settings.groups[0].scale = 0.4, 0.44
    list(make_levels(scene))
    (table,), _ = tables_of(scene, tmp_path)
    rows = [row for row in table["levels"] if row["predicted_px"] is not None]
    assert rows
    for row in rows:
        least, most = row["measured_px_between"]
        assert 0 < most and least <= row["predicted_px"] <= 8.0 + 1e-9
        # an error that is measured at the character's own size would be about the double
        assert row["measured_px"] <= 1.05 * row["predicted_px"]


def test_names_make_safe_and_different_files(scene, tmp_path):
    people = scene.crowd_lod.characters
    people.children["adult"].name = "../a <b>"
    people.children["child"].name = "..?a ?b?"
    stored_groups.store_groups(scene.crowd_lod, group_measuring.measure_groups(scene))
    scene.crowd_lod.level_count = 1
    list(make_levels(scene))
    tables, _ = tables_of(scene, tmp_path)
    names = [each["picture"] for each in tables]
    assert len(set(names)) == 2 and all(
        re.fullmatch(r"levels_[A-Za-z0-9._-]+\.png", name) for name in names
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)


@pytest.mark.once
def test_the_picture_tints_by_the_distance_to_the_source():
    square = np.array([(0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)], float)
    faces = np.array([(0, 1, 2), (0, 2, 3)])
    flat = Surface(square, faces)
    off = Surface(square + (0.25, 0, 0), faces)
    nothing = np.zeros(2, bool)
    views = [InPose(flat, level, nothing, level.points[2]) for level in (flat, off)]
    pixels, most = finished(
        lod_picture.draw_lods(views, ["two triangles", "two triangles"], ["hidden", "worst"], 0.0)
    )
    assert most == pytest.approx(0.25, rel=1e-5)
    low = pixels[: len(pixels) // 2, ..., :3].reshape(-1, 3)[::7].astype(int)
    for end in (
        lod_picture.RAMP[[0, -1]] * 255
    ):  # the near one all in the ramp's first color, the far one in its last
        shades = np.arange(0.8, 1.001, 0.01)[:, None] * end
        assert (np.abs(low[:, None] - shades[None]).max(axis=2).min(axis=1) <= 3).mean() > 0.1
    before = len(bpy.data.curves), len(bpy.data.objects), len(bpy.data.meshes)
    finished(lod_picture.draw_lods(views[:1], ["again"], ["hidden"], 1.0))
    assert (len(bpy.data.curves), len(bpy.data.objects), len(bpy.data.meshes)) == before


def test_the_picture_rings_the_worst_place_and_grays_what_nobody_sees():
    square = np.array([(0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)], float)
    faces = np.array([(0, 1, 2), (0, 2, 3)])
    flat = Surface(square, faces)
    off = Surface(square + (0.25, 0, 0), faces)
    hidden = np.array([True, False])
    views = [InPose(flat, level, hidden, level.points[2]) for level in (flat, off)]
    pixels, _ = finished(lod_picture.draw_lods(views, ["whole", "off"], ["hidden", "worst"], 0.0))
    low = pixels[: len(pixels) // 2, ..., :3].astype(int)
    ring = (np.abs(low - np.array(lod_picture.MARK) * 255).max(axis=2) <= 2).nonzero()
    assert (
        ring[0].mean() > len(low) / 2 and ring[1].mean() > low.shape[1] / 2
    )  # up, in the second cell
    gray = (np.ptp(low, axis=2) == 0) & (low[..., 0] > 60) & (low[..., 0] < 220)
    assert (
        gray[:, : low.shape[1] // 2].sum()
        > 10 * gray[:, low.shape[1] // 2 : -9 * lod_picture.LETTER].sum()
    )


@pytest.mark.once
def test_a_preview_by_tolerance_leaves_the_report(by_tolerance, tmp_path, capfd):
    scene = by_tolerance
    settings = scene.crowd_lod
    scene.unit_settings.system = "METRIC"
    scene.unit_settings.scale_length = 0.01
    thresholds = frame_now(scene, bpy.context.evaluated_depsgraph_get()).thresholds
    groups = stored_groups.groups_of(settings)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "crowd.blend"))
    words = [
        "preview",
        tmp_path / "crowd.blend",
        "--frames",
        "1",
        "--width",
        "80",
        "--quiet",
        "--out",
        tmp_path / "out",
    ]
    assert commands.run_command([*map(str, words), "--tolerance", "1"], "crowd-lod") == 0
    plan = json.loads((tmp_path / "out" / "plan.json").read_text())
    for told, threshold, group in zip(
        plan["levels"]["characters"], thresholds, groups, strict=True
    ):
        # the sidebar's figures: of the scene's own renders, in its unit
        assert [row["from_m"] for row in told["levels"][1:]] == pytest.approx(
            0.01 * threshold[: len(told["levels"]) - 1]
        )
        for row in told["levels"]:
            assert row["deviation_mm"] == pytest.approx(10 * group.deviations[row["lod"]])
    assert image_data.load_pixels(tmp_path / "out" / "main_0001.png").shape[:2] == (45, 80)
    assert plan["levels"]["pixels"] == [160, 90] and plan["preview"]["height"] == 45
    assert plan["levels"]["tolerance"] == 1 and plan["levels"]["thresholds"] is None
    assert len(plan["levels"]["characters"]) == 1 and plan["levels"]["dropped"]
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert text == page(plan)
    links = []
    reader = HTMLParser()
    reader.handle_starttag = lambda tag, attrs: links.extend(v for k, v in attrs if k == "src")
    reader.feed(text)
    assert set(links) == {"contact_sheet.png", "levels_adult.png"}
    assert all(image_data.load_pixels(tmp_path / "out" / name).size for name in links)
    for wrong in ("0", "-1", "nan", "inf"):
        assert commands.run_command([*map(str, words), "--tolerance", wrong], "crowd-lod") == 1
        assert "tolerance" in capfd.readouterr().err


def test_measuring_in_steps_gives_the_same_and_characters_play_what_they_did_in_between(
    scene, monkeypatch
):
    def played():
        rigs = (item for item in scene.crowd_lod.characters.all_objects if item.type == "ARMATURE")
        return [(rig.name, rig.animation_data.action) for rig in rigs]

    whole = group_measuring.measure_groups(scene)
    actions = played()
    monkeypatch.setattr(work_progress, "TICK", 0.0)  # a pose at a time
    before = set(bpy.data.user_map())
    progress = []
    steps = group_measuring.measuring_groups(scene)
    while True:
        try:
            progress.append(next(steps))
        except StopIteration as end:
            assert end.value == whole
            break
        assert played() == actions
    assert set(bpy.data.user_map()) == before
    assert progress == sorted(progress) and len(progress) > 20 and progress[-1] == 1.0
