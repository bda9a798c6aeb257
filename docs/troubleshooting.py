"""Writes docs/troubleshooting.md: each message with what to do, as the code says it.

    .venv-3.13/bin/python docs/troubleshooting.py

Sentences of Populate and Make LOD Meshes are made by message_words.py, of an example of each kind.
Refusals are read from the code that raises them, with "..." for what they name.
"""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from crowd_lod_extension.crowd_lod.message_words import lines_of
from crowd_lod_extension.crowd_lod.messages import Message
from crowd_lod_extension.crowd_lod.messages import MessageKind as Kind

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "troubleshooting.md"
HEAD = """# Troubleshooting

Written by `docs/troubleshooting.py` from the code: change the code, and run it again.

Search this page for a few words of the message. `...` stands for names and numbers of your scene.
All messages of the last steps are behind the button with the *i* on top of the sidebar.

## Buttons that are gray

| tooltip |
| --- |
{needs}

## Warnings of Populate

The crowd is there; something about it is probably not what you mean. The names are examples.

| message | what to do |
| --- | --- |
{warnings}

## LODs that were not made

Nothing is wrong: these would not help.

| message |
| --- |
{dropped}
"""
HEADING = "\n## {title}\n\n| message | what to do |\n| --- | --- |\n{rows}\n"
SECTIONS = {
    "The camera, frames and culling": (
        "crowd_lod/culling",
        "crowd_lod/frame",
        "operators/blender/cameras",
    ),
    "Characters and their actions": (
        *("operators/scene/characters", "operators/blender/character_objects"),
        *("operators/blender/named_actions", "crowd_lod/crowd/agents"),
    ),
    "State machines and label maps": (
        *("crowd_lod/crowd", "crowd_lod/behavior", "crowd_lod/world/maps", "crowd_lod/world/first"),
        *("operators/scene/machine/m", "operators/scene/walls", "operators/blender/image"),
    ),
    "Spawning, ground and points": (
        "crowd_lod/world",
        "operators/scene/machine",
        "operators/scene/sources",
    ),
    "Files of trajectories": ("crowd_lod/tracks", "crowd_lod/sources"),
    "LODs": (
        "crowd_lod/levels",
        "crowd_lod/simplification",
        "operators/lods",
        "operators/scene/scene_crowd",
    ),
    "Shot plans, budgets and overrides": (
        *(
            "crowd_lod/shot",
            "operators/plan",
            "operators/scene/shot",
            "operators/ui/agent_overrides",
        ),
    ),
    "Build and bake": ("operators/build",),
    "Preview, Verify, USD and farms": (
        "operators/deliver",
        "operators/viewport",
        "operators/cli/farm",
    ),
    "Commands": ("operators/cli",),
    "Files, folders and the rest": ("",),
}
WITCH = "Witch"
LOD = {"measured": True, "triangles": 450}
TABLE = {"column": 3, "row": 7}
PLACE = {"agents": 12, "there": 9, "cells": 2, "x": 3.5, "y": -2.0, **TABLE}
EXAMPLES: dict[Kind, tuple[str, dict[str, Any], str]] = {
    Kind.OFF_COLOR: ("", {"pixels": 40, "label": "ground", **TABLE}, ""),
    Kind.CHATTERS: ("", PLACE, ""),
    Kind.STUCK: ("", PLACE, ""),
    Kind.CHECKED_IN_PART: ("", {"checked": 200_000, "agents": 10**6, "seconds": 60.0}, ""),
    Kind.BESIDE_OFFSET: (WITCH, {"beside": 0.4}, ""),
    Kind.RAISED: (WITCH, {"rise": 0.08}, ""),
    Kind.OFF_ITS_SOLES: (WITCH, {"rise": 0.08}, ""),
    Kind.UNKNOWN_EXTENT: (WITCH, {"what": "displacement", "margin": 0.5}, ""),
    Kind.HEIGHT: (WITCH, {"height": 78.0}, ""),
    Kind.STILL_POSES: (
        WITCH,
        {"frames": 5.0, "seconds": 0.2, "poses": 32, "reason": "its shape keys are animated"},
        "",
    ),
    Kind.BY_TIME: (WITCH, {"movers": "Cloth"}, ""),
    Kind.HANGS_OUTSIDE: ("Hat", {"character": WITCH}, "crowd_lod.take_along"),
    Kind.WITHOUT_FACES: ("Sparks", {"what": "point cloud"}, ""),
    Kind.UNSAVED: ("Target", {}, ""),
    Kind.ROOT_MOTION: (WITCH, {"action": "walk", "way": 1.4}, ""),
    Kind.NO_STRIDE: (
        WITCH,
        {"action": "walk", "aside": "", "speeds": [1.25], "way": 9.0, "period": 1.1},
        "",
    ),
    Kind.FEET_SLIDE: (
        WITCH,
        {"state": "walk", "action": "walk", "slide": 0.2, "stride": False, "fits": 1.1},
        "",
    ),
    Kind.NO_WALK: (
        WITCH,
        {"action": "Death", "walk": "Walk", "by_name": True},
        "crowd_lod.take_action",
    ),
    Kind.GLIDES: (
        WITCH,
        {"walk": "Walk", "others": [], "refused": [], "movers": []},
        "crowd_lod.take_action",
    ),
    Kind.GLOWS: (WITCH, {"material": "Eyes", "stays": True}, ""),
    Kind.IMAGE_MISSING: (WITCH, {"paths": ["//skin.png"]}, ""),
    Kind.SPEED: ("", {"median": 14.0, "from_file": True}, ""),
    Kind.CLIMBS: ("", {"height": 30.0}, ""),
    Kind.OFF_THE_GROUND: ("", {"share": 0.9, "height": -0.4, "ground": "Street"}, ""),
    Kind.OBSTACLE: ("House", {}, "crowd_lod.walls_from_selection"),
    Kind.WITHIN_WALLS: ("", {"share": 0.02, "walls": ["House"], "from_file": False}, ""),
    Kind.NO_TERRAIN: ("", {"over": 20, "agents": 1000, "terrain": "Hill", "height": 0.0}, ""),
    Kind.TERRAIN_OF_CHARACTERS: ("Hill", {"collection": "Characters"}, ""),
    Kind.TERRAIN_MOVES: ("Ship", {}, ""),
    Kind.PLACES_OUTSIDE: (
        "",
        {"lost": 1708, "places": 2000, "size": (60, 60), "fits": (90, 80)},
        "",
    ),
    Kind.PLACES_ON_LABELS: ("", {"lost": 30, "places": 2000, "map": True}, ""),
    Kind.SAVES_LITTLE: (WITCH, {**LOD, "finer": 500}, ""),
    Kind.BESIDE_GIVEN: (WITCH, {**LOD, "given": 500}, ""),
    Kind.DEVIATES_AS_MUCH: (WITCH, {**LOD, "fewer": 400}, ""),
    Kind.NEVER_ALIKE: (WITCH, LOD, ""),
    Kind.TOO_COARSE: (WITCH, LOD, ""),
    Kind.TOO_FINE: (WITCH, LOD, ""),
    Kind.BEGINS_TOO_FAR: (WITCH, {**LOD, "begin": 90.0, "farthest": 60.0}, ""),
    Kind.ENDS_TOO_NEAR: (WITCH, {**LOD, "end": 4.0, "nearest": 20.0}, ""),
    Kind.TOO_FEW: (WITCH, {**LOD, "few": 3, "frames": 9}, ""),
    Kind.NOT_WORTH_IT: (WITCH, {**LOD, "engine": "Cycles"}, ""),
}


def example(kind: Kind) -> str:
    """Return the sentence of the kind's example."""
    subject, facts, remedy = EXAMPLES[kind]
    label = remedy.partition(".")[2].replace("_", " ").title().replace("From", "from")
    (line,) = lines_of([Message(kind, subject, facts, remedy)], lambda _: label)
    return line.sentence


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def constants_of(path: Path) -> dict[str, str]:
    """Return the texts and numbers that a module sets by name, as messages show them."""
    return {
        target.id: f"{node.value.value:,}"
        if isinstance(node.value.value, int)
        else node.value.value
        for node in tree_of(path).body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
        for target in node.targets
        if isinstance(target, ast.Name) and isinstance(node.value.value, int | str)
    }


def sentences_of(node: ast.expr, path: Path) -> list[str]:
    """Return the sentences that an expression may be, with "..." for what is not in the code."""
    match node:
        case ast.Constant(value=str(text)):
            return [text]
        case ast.JoinedStr(values=parts):
            return ["".join(shown(part, path) for part in parts)]
        case ast.IfExp(body=first, orelse=second):
            return [*sentences_of(first, path), *sentences_of(second, path)]
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)):
            return [
                sentence
                for function in ast.walk(tree_of(path))
                if isinstance(function, ast.FunctionDef) and function.name == name
                for found in ast.walk(function)
                if isinstance(found, ast.Return) and found.value is not None
                for sentence in sentences_of(found.value, path)
            ]
    return []


def shown(part: ast.expr, path: Path) -> str:
    if isinstance(part, ast.Constant):
        return part.value
    value = part.value
    return constants_of(path).get(value.id, "...") if isinstance(value, ast.Name) else "..."


def refusals() -> Iterator[tuple[str, str]]:
    """Yield (file, sentence) of all errors that users see."""
    for path in sorted(
        path for top in ("crowd_lod", "operators") for path in (ROOT / top).rglob("*.py")
    ):
        name = path.relative_to(ROOT).as_posix()
        for node in ast.walk(tree_of(path)):
            match node:
                case ast.Raise(exc=ast.Call(func=ast.Name(id="CrowdError"), args=[said])):
                    for sentence in sentences_of(said, path):
                        if sentence.count(" ") > 2:
                            yield name, sentence


def needs() -> list[str]:
    """Return what gray buttons say in their tooltips."""
    path = ROOT / "operators" / "settings" / "needs.py"
    found = [
        sentence
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.Return) and node.value is not None
        for sentence in sentences_of(node.value, path)
    ]
    return sorted({sentence for sentence in found if sentence})


def row(sentence: str) -> str:
    """Return the row of a message: what it says, and after its colon what to do.

    It is "" without words.
    """
    said = re.sub(r"(\.\.\.)+", "...", sentence)
    said = re.sub(r"(?<!\.)\.$|(?<=\.\.\.)\.$", "", said)
    said = said.replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;")
    what, colon, remedy = said.rpartition(": ")
    if not colon:
        what, colon, remedy = said.rpartition("; ")
    if len(re.findall(r"[a-z]{2,}", what or said)) < 2:
        return ""
    if not colon or not re.search("[a-z]", remedy):
        return f"| {said} | |"
    return f"| {what} | {remedy[0].upper()}{remedy[1:]} |"


def section_of(file: str) -> str:
    return next(title for title, starts in SECTIONS.items() if file.startswith(starts))


def page() -> str:
    """Return the page."""
    sections: dict[str, set[str]] = {title: set() for title in SECTIONS}
    for file, sentence in refusals():
        sections[section_of(file)].add(row(sentence))
    of_lods = list(Kind).index(Kind.SAVES_LITTLE)
    kinds = list(Kind)
    head = HEAD.format(
        needs="\n".join(f"| {sentence} |" for sentence in needs()),
        warnings="\n".join(row(example(kind)) for kind in kinds[:of_lods]),
        dropped="\n".join(f"| {example(kind)} |" for kind in kinds[of_lods:]),
    )
    return head + "".join(
        HEADING.format(title=title, rows="\n".join(sorted(rows - {""})))
        for title, rows in sections.items()
    )


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
