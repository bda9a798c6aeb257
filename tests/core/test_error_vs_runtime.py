"""The report's figures against independent counts: brute rational arithmetic, another way to the
same number.
"""

from dataclasses import replace
from fractions import Fraction as F

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset
from crowd_lod_extension.crowd_lod.culling.radar import RadarOptions, radar
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy, assign, threshold_distances
from crowd_lod_extension.crowd_lod.validation import error_vs_runtime
from crowd_lod_extension.crowd_lod.validation.exact_frustum import sees, standing_crowd
from crowd_lod_extension.crowd_lod.validation.extreme_cases import camera_of
from crowd_lod_extension.crowd_lod.world.maps import Area, edge_map

CENTER = np.array([0.9, 0.5])
RADIUS = np.array([1.0, 0.4])


def view(count=400, seed=3):
    random = np.random.default_rng(seed)
    points = random.uniform((-30, 0, -2), (60, 110, 2), (count, 3))
    return standing_crowd(points, random.integers(2, size=count, dtype=np.uint8)), (camera_of(),)


def test_missed_and_surplus_are_those_that_rational_arithmetic_counts():
    crowd, (camera,) = view()
    points = np.stack([crowd.x, crowd.y, crowd.z + CENTER[crowd.group]], axis=1)
    truth = np.array([sees(camera, p, r) for p, r in zip(points, RADIUS[crowd.group], strict=True)])
    rows = list(error_vs_runtime.compare_culling([(crowd, (camera,))], CENTER, RADIUS, repeats=1))
    assert all(row["visible"] == truth.sum() for row in rows if not row["offset_m"])
    for row in rows:
        if row["method"] == "fixed Delta":
            kept = radar(crowd, camera, CENTER, RADIUS, RadarOptions(row["delta_m"]))[0]
            assert (row["missed"], row["surplus"]) == ((truth & ~kept).sum(), (kept & ~truth).sum())
    by = {(r["method"], r["delta_m"]): r for r in rows if not r["offset_m"]}
    assert by["fixed Delta", 0.0]["missed"] > 0 and by["fixed Delta", 10.0]["surplus"] > 0
    assert [r["method"] for r in rows if r["default"]] == ["derived Delta"] and by[
        "derived Delta", ""
    ]["missed"] == 0
    assert all(0 <= r["ms_least"] <= r["ms"] <= r["ms_most"] for r in rows)


def test_a_fixed_delta_of_the_scene_is_the_default():
    rows = error_vs_runtime.compare_culling([view(20)], CENTER, RADIUS, 0.7, repeats=1)
    assert [(r["method"], r["delta_m"]) for r in rows if r["default"]] == [("fixed Delta", 0.7)]


@pytest.mark.parametrize("radial", [False, True])
def test_exact_levels_agree_with_rational_arithmetic_for_each_agent(radial):
    crowd, (camera,) = view()
    steps = error_vs_runtime.exact_thresholds(LevelPolicy((0.16, 0.4)), camera, len(RADIUS))
    ids = error_vs_runtime.exact_levels(crowd, camera, CENTER, steps, radial)
    for i in range(len(crowd)):
        place = (crowd.x[i], crowd.y[i], crowd.z[i] + CENTER[crowd.group[i]])
        v = [F(float(p)) - F(float(c)) for p, c in zip(place, camera.origin, strict=True)]
        if radial:
            want = sum(sum(p * p for p in v) >= s**2 for s in steps[crowd.group[i]])
        else:
            want = sum(
                sum(p * F(float(q)) for p, q in zip(v, camera.Z, strict=True)) >= s
                for s in steps[crowd.group[i]]
            )
        assert ids[i] == want
    assert set(ids) == {0, 1, 2}


@pytest.mark.parametrize("kind", ["PERSP", "PANO"])
def test_the_default_in_the_report_is_the_arithmetic_of_the_plan(kind):
    crowd, (camera,) = view()
    camera = replace(camera, kind=kind)
    policy = LevelPolicy((0.16, 0.4))
    distance, ids = error_vs_runtime.distances_and_levels(
        (crowd, (camera,)), CENTER, RADIUS, policy, "float64"
    )
    same = radar(crowd, camera, CENTER, RADIUS)[1]
    assert (distance == same).all() and (
        ids == assign(same, threshold_distances(policy, camera, RADIUS), crowd.group)
    ).all()


def test_float32_in_the_world_loses_ids_far_out_and_float64_none(monkeypatch):
    monkeypatch.setattr(error_vs_runtime, "LEVEL_OFFSETS", (0.0, 1e7))
    rows = list(
        error_vs_runtime.compare_levels(
            [view(4000)], CENTER, RADIUS, LevelPolicy((0.16, 0.4)), repeats=1
        )
    )
    by = {(r["precision"], r["offset_m"]): r for r in rows}
    assert by["float32 world", 1e7]["differ"] > 0 and by["float32 world", 1e7]["worst_m"] > 0.1
    for offset in (0.0, 1e7):
        assert by["float64", offset]["differ"] == 0 and by["float64", offset]["worst_m"] < 1e-12
        assert by["float32 relative", offset]["worst_m"] < 1e-4
    assert sum(r["default"] for r in rows) == 1


@pytest.mark.once
def test_behavior_of_the_chapter_is_exact_and_the_listing_of_first_order():
    from crowd_lod_extension.crowd_lod.world.first_frame import populate

    machine = load_preset("chapter")
    world = edge_map(Area(-20, -20, 20, 20, 0), machine.labels)
    rows = list(
        error_vs_runtime.compare_behavior(
            populate(300, 1, 1, machine, world), machine, world, 1 / 24, 48, repeats=1
        )
    )
    step, listing = ([r for r in rows if r["method"] == name] for name in ("step", "listing"))
    assert max(r["worst_m"] for r in step) < 1e-11 and listing[0]["order"] == pytest.approx(
        1, abs=0.3
    )
    assert [r["dt_s"] for r in rows if r["default"]] == [pytest.approx(1 / 24)]


def test_some_takes_agents_evenly():
    crowd, _ = view()
    few = error_vs_runtime.thin_out(crowd, 3)
    assert (
        list(few.x) == [crowd.x[0], crowd.x[200], crowd.x[399]]
        and len(error_vs_runtime.thin_out(crowd, 1000)) == 400
    )
