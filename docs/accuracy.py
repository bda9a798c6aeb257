"""Writes docs/accuracy.md and its plots: error against run time, as `report error` measures it.

    .venv-3.13/bin/python docs/accuracy.py chapter plaza station Soldier.blend

Each name is a sample or a .blend file. With --quick it takes some minutes, else an hour.
"""

import argparse
import json
import shutil
import subprocess
import tempfile
import textwrap
from itertools import groupby
from pathlib import Path

DOCS = Path(__file__).parent
PLOTS = DOCS / "accuracy"
HEAD = """# Accuracy

Written by `docs/accuracy.py` from what `crowd-lod report error` and `crowd-lod report extremes`
measure. Both run on any scene and machine; the star in a plot is how the scene is set."""


def told(*words: str) -> dict:
    """What a command prints as JSON."""
    command = [str(DOCS.parent / "crowd-lod"), *words, "--json", "--quiet"]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(process.stdout)


def filled(text: str) -> str:
    return textwrap.fill(text, 100, break_long_words=False, break_on_hyphens=False)


def section(scene: str, options: list[str]) -> str:
    """The section on a scene; its plots are written to PLOTS."""
    name = Path(scene).stem
    with tempfile.TemporaryDirectory() as folder:
        result = told("report", "error", scene, *options, "--out", f"{folder}/out")
        for path in Path(folder, "out").glob("*.svg"):
            shutil.copyfile(path, PLOTS / f"{name}_{path.name}")
    parts = [f"## {name}", filled(f"On {result['machine']}.")]
    for part, verdict in result["verdicts"].items():
        parts.append(filled(verdict))
        if (PLOTS / f"{name}_{part}.svg").exists():
            parts.append(f"![{name}: {part}](accuracy/{name}_{part}.svg)")
            parts.append(filled(result["means"][part]))
    return "\n\n".join(parts)


def extremes() -> str:
    """The section on extreme cases."""
    result = told("report", "extremes")
    lines = ["| case | errors, each with its bound |", "| --- | --- |"]
    for case, rows in groupby(result["rows"], lambda row: row["case"]):
        errors = [f"{row['quantity']} {row['error']:.2g} ({row['bound']:g})" for row in rows]
        lines.append(f"| {case} | {', '.join(errors)} |")
    about = (
        "Plans and steps beside exact arithmetic. Agents are missed that can be seen, or drawn outside "
        "the view beyond what renderers round; a distance's error is given as a part of its bound; "
        "agents are broken that are at NaN, off the map, in a wall or behind it."
    )
    count = len({row["case"] for row in result["rows"]})
    verdict = f"{len(result['wrong'])} of {count} cases exceed a bound."
    return "\n\n".join(["## Extreme cases", filled(about), verdict, "\n".join(lines)])


def main() -> None:
    command = argparse.ArgumentParser(description=__doc__)
    command.add_argument("scenes", nargs="+", metavar="SCENE")
    command.add_argument("--quick", action="store_true")
    args = command.parse_args()
    PLOTS.mkdir(exist_ok=True)
    options = ["--quick"] * args.quick
    parts = [HEAD, *(section(scene, options) for scene in args.scenes), extremes()]
    (DOCS / "accuracy.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
