"""Two plans side by side, from whole and from spoilt files."""

import json

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.reporting.plan_comparison import compare
from crowd_lod_extension.crowd_lod.shot import plan_file
from crowd_lod_extension.crowd_lod.shot.phases import Phases


def row(number, triangles, visible=10, **more):
    return {"frame": number, "agents": 20, "visible": visible, "triangles": triangles, **more}


def write(folder, content):
    folder.mkdir(exist_ok=True)
    (folder / "plan.json").write_text(content if isinstance(content, str) else json.dumps(content))
    return folder


def planned(folder, rows, **more):
    """A folder as crowd-lod plan writes it, `more` in its shot."""
    shot = {"frames": [each["frame"] for each in rows], "engine": "CYCLES", **more}
    return write(
        folder,
        {
            "version": 2,
            "made_for": {"the crowd": "a", "the map": "b"},
            "frames": rows,
            "shot": shot,
        },
    )


def test_pairs_of_all_figures_that_both_have(tmp_path):
    a = planned(
        tmp_path / "a",
        [row(1, 100, switches=0), row(2, 300, switches=2), row(3, 5, switches=1)],
        plan={"triangles": 405, "memory_mb": 8.0, "switches": 3},
    )
    b = planned(
        tmp_path / "b",
        [row(2, 150), row(3, 5), row(4, 1)],
        plan={"triangles": 156, "memory_mb": 6.0, "switches": 0},
    )
    told = compare(a, b).as_json
    assert told["total"] == {
        "triangles": [405, 156],
        "visible": [30, 30],
        "switches": [3, 0],
        "memory_mb": [8.0, 6.0],
    }
    assert told["frames"] == [
        {"frame": 2, "triangles": [300, 150], "visible": [10, 10]},
        {"frame": 3, "triangles": [5, 5], "visible": [10, 10]},
    ]
    assert (told["only_in_a"], told["only_in_b"], told["made_for_differs"]) == ([1], [4], [])
    lines = compare(a, b).text.splitlines()
    assert "Only in A: frame 1. They count in its total." in lines
    assert next(line.split() for line in lines if line.startswith("triangles")) == [
        "triangles",
        "405",
        "156",
        "-61.5%",
    ]
    assert [line.split()[0] for line in lines[-2:]] == ["Frame", "2"]  # frame 3 is the same


def test_a_plan_is_like_itself_and_a_file_is_as_good_as_its_folder(tmp_path):
    a = planned(tmp_path / "a", [row(1, 100), row(2, 300)])
    same = compare(a, a / "plan.json")
    assert same.as_json["made_for_differs"] == [] and same.as_json["total"]["triangles"] == [
        400,
        400,
    ]
    assert same.text.endswith("All 2 common frames are the same.")


def test_what_plans_were_made_for_is_told_where_it_differs(tmp_path):
    a, b = (planned(tmp_path / name, [row(1, 1), row(2, 1)]) for name in "ab")
    content = json.loads((b / "plan.json").read_text())
    content["made_for"] |= {"the map": "other", "the overrides": "new"}
    content["shot"] |= {"engine": "EEVEE", "tolerance": 2.0}
    write(b, content)
    cameras = np.zeros((2, 1, 21))
    for folder, scale in ((a, 0.0), (b, 1.0)):
        stored = plan_file.StoredPlan(
            folder / "plan.npz",
            np.array([1, 2]),
            np.array([1.0, 2]),
            cameras + scale,
            {"the map": "b"},
            None,
            Phases(np.zeros(3, np.uint8), np.array([4], np.uint8), np.zeros(3, np.uint8)),
            np.ones((3, 16), bool),
        )
        plan_file.write(stored.path, stored, np.zeros((2, 3), np.uint8))
    assert compare(a, b).differs == (
        "the map",
        "the overrides",
        "the engine",
        "the tolerance",
        "the camera",
    )
    assert compare(a, a).differs == ()


def test_plans_of_previews_are_compared_by_their_parts(tmp_path):
    a, b = (
        write(
            tmp_path / name,
            {"version": 1, "crowd": {"seed": seed}, "camera": {"x": 1}, "frames": [row(1, seed)]},
        )
        for name, seed in (("a", 3), ("b", 4))
    )
    assert compare(a, b).differs == ("the crowd",) and compare(a, b).as_json["total"][
        "triangles"
    ] == [3, 4]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, "There is no plan"),
        ("", "is not JSON"),
        ("{", "is not JSON"),
        ("\udcff", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ("[]", "has neither frames nor a shot"),
        ({"frames": 3, "shot": []}, "has neither frames nor a shot"),
        (
            {"frames": [[1], {"frame": "1", "triangles": 3}, {"frame": True, "triangles": 3}]},
            "has neither frames nor a shot",
        ),
        ({"shot": {"plan": {"triangles": None}, "frames": 7}}, "has neither frames nor a shot"),
    ],
)
def test_spoilt_plans_are_named_in_one_sentence(tmp_path, content, says):
    good = planned(tmp_path / "good", [row(1, 1)])
    bad = tmp_path / "bad"
    if isinstance(content, str):
        bad.mkdir()
        (bad / "plan.json").write_bytes(content.encode("utf-8", "surrogateescape"))
    elif content is not None:
        write(bad, content)
    for pair in ((good, bad), (bad, good)):
        with pytest.raises(CrowdError, match=says) as told:
            compare(*pair)
        assert "bad" in str(told.value) and "good" not in str(told.value)


def test_figures_that_are_no_numbers_are_left_out(tmp_path):
    rows = [row(1, 4, switches=None), row(2, 5, switches="many"), row(3, True)]
    a = write(
        tmp_path / "a",
        {"frames": rows, "shot": {"memory_mb": float("nan"), "plan": 3, "frames": ["x"]}},
    )
    told = compare(a, a).as_json
    assert told["total"] == {"visible": [30, 30]} and told["frames"][2] == {
        "frame": 3,
        "visible": [10, 10],
    }
    assert json.dumps(told, allow_nan=False)


def test_an_integer_greater_than_any_float_is_no_figure(tmp_path):
    a = planned(tmp_path / "a", [row(1, 100)], plan={"memory_mb": 10**309})
    b = planned(tmp_path / "b", [row(1, 10**400, switches=2)], plan={"memory_mb": 2.0})
    assert compare(a, b).as_json["total"] == {"visible": [10, 10]}
    assert compare(a, b).text
