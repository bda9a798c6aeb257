"""The rules that hold the house up."""

import ast
import functools
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CORE = sorted((ROOT / "crowd_lod").rglob("*.py"))
pytestmark = pytest.mark.once

ALLOWED = {*sys.stdlib_module_names, "numpy", "fast_simplification"}


@functools.cache
def parsed(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def test_core_imports_numpy_and_the_standard_library_only():
    other = {}
    for path in CORE:
        nodes = list(ast.walk(parsed(path)))
        names = [each.name for node in nodes if isinstance(node, ast.Import) for each in node.names]
        names += [
            node.module for node in nodes if isinstance(node, ast.ImportFrom) and not node.level
        ]
        other[path.name] = {name.partition(".")[0] for name in names} - ALLOWED
    assert other and not any(other.values()), other


def test_package_imports_without_blender(tmp_path):
    import subprocess

    code = "import sys; sys.modules['bpy'] = None; import crowd_lod_extension.crowd_lod.frame.frame"
    assert subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=False).returncode == 0


# The floors of each package, lowest first; "" are the modules that lie in the package itself.
FLOORS = {
    "crowd_lod": (
        *(
            "",
            "crowd",
            "world",
            "animation",
            "tracks",
            "sources",
            "behavior",
            "culling",
            "levels",
            "sorting",
        ),
        *("simplification", "frame", "shot", "validation", "output"),
    ),
    "operators": (
        *("blender", "settings", "scene", "freshness", "lods", "plan"),
        *("viewport", "build", "deliver", "cli", "ui", ""),
    ),
}


# The folders of a floor that has some, lowest first; "" are its own modules.
ROOMS = {
    "operators/scene": ("machine", "characters", "sources", ""),
    "operators/deliver": ("usd", "preview", "proof", "accuracy", ""),
    "operators/build": ("nodes", ""),
}


def modules():
    """Of each file of the floors: (package, floor, path in it without .py)."""
    for package in FLOORS:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT / package).with_suffix("").parts
            yield package, parts[0] if len(parts) > 1 else "", path


@functools.cache
def imported(path):
    """The files of ours that the file at `path` imports, wherever in it."""
    found = set()
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = path.parents[node.level - 1].joinpath(*(node.module or "").split("."))
            for place in [base, *(base / alias.name for alias in node.names)]:
                if place.with_suffix(".py").is_file():
                    found.add(place.with_suffix(".py"))
    return found


def floor_of(path):
    package, *rest = path.relative_to(ROOT).parts
    return package, rest[0] if len(rest) > 1 else ""


def test_every_folder_is_a_floor_that_says_what_comes_in_and_goes_out():
    for package, floors in FLOORS.items():
        found = {
            path.name for path in (ROOT / package).iterdir() if (path / "__init__.py").exists()
        }
        assert found == set(floors) - {""}
        for floor in found - {"ui", "cli"}:
            contract = ast.get_docstring(parsed(ROOT / package / floor / "__init__.py"))
            assert "In: " in contract and "Out: " in contract, floor


def test_imports_go_down_the_floors():
    up = []
    for package, floor, path in modules():
        for other in imported(path):
            home, own = floor_of(other)
            if home in FLOORS and (
                (package, home) == ("crowd_lod", "operators")
                or (package == home and FLOORS[package].index(own) > FLOORS[package].index(floor))
            ):
                up.append(f"{path.relative_to(ROOT)} imports {other.relative_to(ROOT)}")
    assert not up


@pytest.mark.parametrize("floor", ROOMS)
def test_imports_go_down_the_rooms_of_a_floor(floor):
    rooms = ROOMS[floor]
    found = {path.name for path in (ROOT / floor).iterdir() if (path / "__init__.py").exists()}
    assert found == set(rooms) - {""}

    def room_of(path):
        parts = path.relative_to(ROOT / floor).parts
        return rooms.index(parts[0] if len(parts) > 1 else "")

    up = [
        f"{path.relative_to(ROOT)} imports {other.relative_to(ROOT)}"
        for path in (ROOT / floor).rglob("*.py")
        for other in imported(path)
        if other.is_relative_to(ROOT / floor) and room_of(other) > room_of(path)
    ]
    assert not up


def test_no_files_import_each_other_in_a_circle():
    known = {path: imported(path) for *_, path in modules()}
    while free := [path for path, others in known.items() if not others & known.keys()]:
        for path in free:
            del known[path]
    assert not known


def test_a_class_name_means_one_thing():
    homes = {}
    for *_, path in modules():
        for node in parsed(path).body:
            if isinstance(node, ast.ClassDef):
                homes.setdefault(node.name.lstrip("_"), []).append(str(path.relative_to(ROOT)))
    assert {name: files for name, files in homes.items() if len(files) > 1} == {}


@pytest.mark.parametrize("folder", ["crowd_lod", "operators", "sample_scenes", "tests"])
def test_files_are_what_one_head_holds(folder):
    lengths = {
        str(p.relative_to(ROOT)): len(p.read_text(encoding="utf-8").splitlines())
        for p in (ROOT / folder).rglob("*.py")
    }
    assert lengths
    assert {name: n for name, n in lengths.items() if n > 500} == {}
