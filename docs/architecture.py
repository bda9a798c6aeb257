"""Draws docs/architecture.png from the code: floors as boxes, arrows to those that they import.

    .venv-3.13/bin/python docs/architecture.py

An arrow is left out where a longer way of arrows says the same. Imports are those that
tests/core/test_house.py judges.
"""

import ast
import sys
import textwrap
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "core"))
from test_house import FLOORS, floor_of, imported, modules  # noqa: E402

# Of each package: its title, its color, and what its own modules are to the floors.
HOUSES = {
    "crowd_lod": ("crowd_lod: the method, NumPy without Blender", "#0072b2", "for all floors"),
    "operators": ("operators: Blender's side", "#d55e00", "switches all floors on and off"),
}
# of a box; rows are 1 apart
WIDTH = 1.1
HEIGHT = 0.7
LETTERS = 31  # of a line in a box of that width
ARROW = {"arrowstyle": "-|>", "lw": 1.2}


def imports() -> dict[tuple[str, str], set[tuple[str, str]]]:
    """Of each (package, floor) those that it imports."""
    imported_floors = {
        (package, floor): set() for package, floors in FLOORS.items() for floor in floors
    }
    for package, floor, path in modules():
        imported_floors[package, floor] |= {
            floor_of(other) for other in imported(path)
        } & imported_floors.keys() - {(package, floor)}
    return imported_floors


def arrows(package: str, all_imports: dict) -> dict[str, set[str]]:
    """Of each floor, those that it imports and that none of these imports.

    The package's own modules, "", are no floor.
    """
    below = {
        floor: {name for home, name in all_imports[package, floor] if home == package and name}
        for floor in FLOORS[package]
    }
    del below[""]
    reached = {}
    for floor in (name for name in FLOORS[package] if name):  # lowest first
        reached[floor] = below[floor].union(*(reached[each] for each in below[floor]))
    return {
        floor: others - set().union(*(reached[each] for each in others))
        for floor, others in below.items()
    }


def rows_of(below: dict[str, set[str]]) -> dict[str, int]:
    """The row of each floor: right above what it imports.

    If it imports nothing, right below what imports it.
    """
    rows = {}
    for floor, lower in below.items():
        rows[floor] = 1 + max((rows[each] for each in lower), default=-1)
    for floor, lower in below.items():
        if not lower:
            rows[floor] = min(rows[above] for above in below if floor in below[above]) - 1
    return rows


def describe_floor(package: str, floor: str) -> str:
    """What the floor is, by its docstring up to the first colon or full stop; of own modules, their
    names.
    """
    if not floor:
        return ", ".join(
            sorted(path.stem for path in (ROOT / package).glob("*.py") if path.stem != "__init__")
        )
    says = ast.get_docstring(
        ast.parse((ROOT / package / floor / "__init__.py").read_text(encoding="utf-8"))
    )
    first = " ".join(says.split("\n\n")[0].split())
    return first.partition(". ")[0].rstrip(".").partition(" (")[0].replace("`", "")


def box(axes: Axes, x: float, y: float, wide: float, name: str, text: str, color: str) -> None:
    tall = HEIGHT if name else HEIGHT / 2
    style = {"boxstyle": "round,pad=0,rounding_size=0.05", "fc": "white", "ec": color, "lw": 1.5}
    axes.add_patch(FancyBboxPatch((x - wide / 2, y - tall / 2), wide, tall, zorder=2, **style))
    lines = textwrap.wrap(text, round(LETTERS * wide / WIDTH) if name else 200)
    if name:
        axes.text(
            x,
            y + 0.22,
            name,
            ha="center",
            va="center",
            weight="bold",
            size=11,
            color=color,
            zorder=3,
        )
    axes.text(
        x,
        y - 0.11 * bool(name),
        "\n".join(lines),
        ha="center",
        va="center",
        size=7.5,
        color="#333333",
        zorder=3,
    )


def house(axes: Axes, package: str, all_imports: dict, rows: dict[str, int], tall: int) -> None:
    title, color, role = HOUSES[package]
    below = arrows(package, all_imports)
    places = {}
    top = max(rows.values())
    for row in range(top + 1):
        here = [floor for floor in FLOORS[package] if rows.get(floor) == row]
        places |= {
            floor: (1.2 * (k - (len(here) - 1) / 2), float(row)) for k, floor in enumerate(here)
        }
    for floor, (x, y) in places.items():
        is_alone = list(rows.values()).count(rows[floor]) == 1
        box(
            axes,
            x,
            y,
            2 * WIDTH if is_alone else WIDTH,
            floor,
            describe_floor(package, floor),
            color,
        )
        for other in below[floor]:
            ends = (
                (places[other][0] + 0.15 * (x - places[other][0]), places[other][1] + HEIGHT / 2),
                (x, y - HEIGHT / 2),
            )
            # behind boxes that it passes
            axes.annotate("", *ends, arrowprops=ARROW | {"color": color}, zorder=1)
    side = 0.6 * max(
        len([floor for floor in FLOORS[package] if rows.get(floor) == row])
        for row in range(top + 1)
    )
    side = max(side, 1.8)
    lowest = any((package, "") in all_imports[package, floor] for floor in below)
    box(
        axes,
        0,
        -0.75 if lowest else top + 0.75,
        3.5,
        "",
        f"{describe_floor(package, '')}: {role}",
        color,
    )
    axes.set(xlim=(-side, side), ylim=(-1.1, tall + 0.1), aspect="auto")
    axes.set_title(title, color=color, weight="bold", size=12)
    axes.axis("off")


def main() -> None:
    all_imports = imports()
    rows = {package: rows_of(arrows(package, all_imports)) for package in HOUSES}
    tall = 1 + max(max(package_rows.values()) for package_rows in rows.values())
    figure = Figure(figsize=(15, tall + 1), dpi=100)
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 2, width_ratios=(4, 3))
    figure.subplots_adjust(left=0.01, right=0.99, bottom=0.01, top=0.95, wspace=0.13)
    for axes, package in zip(panels, HOUSES, strict=True):
        house(axes, package, all_imports, rows[package], tall)
    assert not any(
        home == "operators"
        for (package, _), found in all_imports.items()
        if package == "crowd_lod"
        for home, _ in found
    )
    figure.text(
        0.575,
        0.25,
        "imports\n\u27f5\narrays and\nfrozen\ndataclasses",
        ha="center",
        va="center",
        size=9,
        color="#333333",
    )
    figure.savefig(ROOT / "docs" / "architecture.png")


if __name__ == "__main__":
    main()
