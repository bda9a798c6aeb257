"""Writes the pages of reference from properties and parser, and the picture of a state machine.

    .venv-3.13/bin/python docs/reference.py

Both pages are the same from either Blender: argparse's own help is not.
"""

import argparse
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import bpy
import crowd_lod_extension
from crowd_lod_extension.operators import registration
from crowd_lod_extension.operators.cli.commands import parser
from crowd_lod_extension.operators.settings.crowd_settings import (
    CROWD_NAMES,
    CrowdLodArea,
    CrowdLodGoal,
)
from crowd_lod_extension.operators.settings.level_settings import HowItPlays
from crowd_lod_extension.operators.settings.properties import (
    STEPS,
    CrowdLodGroup,
    CrowdLodSettings,
    property_of,
)
from crowd_lod_extension.operators.settings.shot_settings import CrowdLodOverride

DOCS = Path(__file__).parent
WRITTEN = "Written by `docs/reference.py` from the code: change the code, and run it again."
FAR = 1e9  # of a limit: none
UNTOLD = argparse._HelpAction, argparse._VersionAction, argparse._SubParsersAction
HEAD = "| name | label | type | default | range | tells |\n| --- | --- | --- | --- | --- | --- |"


def description(kind):
    """What Blender shows for a class: its description, or its docstring."""
    return getattr(kind, "bl_description", "") or (kind.__doc__ or "").strip()


def number(value: float) -> str:
    """Return a number as a user types it; Blender keeps 0.05 as 0.05000000074505806."""
    return str(value) if isinstance(value, int) else f"{value:g}"


def default_of(prop: bpy.types.Property) -> str:
    if prop.type in ("POINTER", "COLLECTION"):
        return "none" if prop.type == "POINTER" else "empty"
    if prop.type in ("STRING", "ENUM"):
        return f"`{prop.default}`" if prop.default else "empty"
    if prop.type == "BOOLEAN":
        return "on" if prop.default else "off"
    return ", ".join(map(number, prop.default_array)) if prop.is_array else number(prop.default)


def range_of(prop: bpy.types.Property) -> str:
    if prop.type == "ENUM":
        return ", ".join(f"`{item.identifier}`" for item in prop.enum_items)
    if prop.type not in ("INT", "FLOAT"):
        return ""
    least = prop.hard_min
    most = prop.hard_max
    if least <= -FAR:
        return "" if most >= FAR else f"up to {number(most)}"
    return f"from {number(least)} on" if most >= FAR else f"{number(least)} to {number(most)}"


def type_of(prop: bpy.types.Property) -> str:
    if prop.type in ("POINTER", "COLLECTION"):
        name = prop.fixed_type.identifier
        return name if prop.type == "POINTER" else f"list of {name}"
    plain = prop.type.lower()
    unit = (
        ""
        if prop.unit == "NONE" or prop.type not in ("INT", "FLOAT")
        else f", {prop.unit.lower().replace('_absolute', '')}"
    )
    return (f"{prop.array_length} {plain}s" if getattr(prop, "is_array", False) else plain) + unit


def properties_of(kind: type, *bases: type) -> list[Any]:
    """Return Blender's properties of the class itself, and those that it has of its `bases`."""
    names = [name for each in (kind, *bases) for name in each.__annotations__]
    return [kind.bl_rna.properties[name] for name in names]


def rows(props: Iterable[Any]) -> Iterator[str]:
    """Yield a row of a table for each of Blender's properties."""
    for prop in props:
        description = prop.description
        if prop.type == "ENUM":
            description += "".join(
                f"<br>*{item.name}*: {item.description}"
                for item in prop.enum_items
                if item.description
            )
        yield (
            f"| `{prop.identifier}` | {prop.name} | {type_of(prop)} | {default_of(prop)} | "
            f"{range_of(prop)} | {description} |"
        )


def section(title: str, about: str, props: Iterable[Any]) -> str:
    about = textwrap.fill(about, 100)
    return f"## {title}\n\n{about}\n\n" + "\n".join([HEAD, *rows(props)]) + "\n"


def settings_page() -> str:
    """Return the page of the settings and of the operators, which must be registered."""
    parts = [f"# Settings and operators, for scripts\n\n{WRITTEN}\n"]
    parts += [
        "The settings are properties of `scene.crowd_lod`, in the order of the work.\n"
        f"Those from `{CROWD_NAMES[0]}` to `{CROWD_NAMES[-1]}` are of each crowd in its list\n"
        "`crowds`: `scene.crowd_lod.count` is that of the first one. Who sets or reads it in a scene\n"
        "without a crowd makes one. Drivers and keyframes take the path `crowd_lod.crowds[0].count`.\n"
        "A number of a length is in the scene's units.\n"
    ]
    for step, kinds in STEPS.items():
        about = " ".join(description(kind) for kind in kinds)
        names = [name for kind in kinds for name in kind.__annotations__]
        parts.append(section(step, about, map(property_of, names)))
    parts += [
        section(
            "What the steps made",
            "Read these; the buttons write them.",
            properties_of(CrowdLodSettings),
        ),
        section(
            "Each of groups",
            "What was measured of a character group.",
            properties_of(CrowdLodGroup, HowItPlays),
        ),
        f"## Each of crowds\n\nA crowd has a `name`, and the settings above from "
        f"`{CROWD_NAMES[0]}` to `{CROWD_NAMES[-1]}`.\n",
        section(
            "Each of areas",
            "A mesh or a collection that lays a label over the map.",
            properties_of(CrowdLodArea),
        ),
        section(
            "Each of goals",
            "Where people of a simulation walk to.",
            properties_of(CrowdLodGoal),
        ),
        section(
            "Each of overrides",
            "An override of the shot plan.",
            properties_of(CrowdLodOverride),
        ),
        operators(),
    ]
    return "\n".join(parts)


def operators() -> str:
    kinds = [kind for kind in registration.CLASSES if issubclass(kind, bpy.types.Operator)]
    lines = []
    for kind in kinds:
        own_type = getattr(bpy.ops.crowd_lod, kind.bl_idname.partition(".")[2]).get_rna_type()
        options = [
            f"`{prop.identifier}`: {range_of(prop) or prop.description}"
            for prop in own_type.properties[1:]  # but rna_type
            if not prop.is_hidden
        ]
        lines.append(
            f"| `{kind.bl_idname}` | {kind.bl_label} | {description(kind)} | "
            f"{'<br>'.join(options)} |"
        )
    head = "| operator | label | does | properties |\n| --- | --- | --- | --- |"
    about = (
        "Call them as `bpy.ops.crowd_lod.NAME()`. Where one cannot work, it raises a RuntimeError "
        "that says why."
    )
    return (
        f"## Operators\n\n{textwrap.fill(about, 100)}\n\n{head}\n" + "\n".join(sorted(lines)) + "\n"
    )


def value_of(action: argparse.Action) -> str:
    """Return how the option's or argument's value is written; "" for a switch."""
    if action.nargs == 0:
        return ""
    return str(action.metavar or "|".join(map(str, action.choices or ())) or action.dest.upper())


def called(action: argparse.Action) -> str:
    return " ".join(
        filter(None, (action.option_strings[-1] if action.option_strings else "", value_of(action)))
    )


def usage(command: argparse.ArgumentParser, actions: Sequence[argparse.Action]) -> str:
    arguments = [called(each) if each.required else f"[{called(each)}]" for each in actions]
    # a line breaks between two arguments, not amid one
    words = [word.replace(" ", "\0") for word in (command.prog.split()[-1], *arguments)]
    if command.prog.split()[1:-1]:
        words.insert(0, command.prog.split()[1])
    filled = textwrap.fill(
        " ".join(["crowd-lod", *words]), 100, subsequent_indent="    ", break_on_hyphens=False
    )
    return filled.replace("\0", " ")


def option(action: argparse.Action) -> str:
    """Return the row of an option or argument."""
    does, _, default = (action.help or "").partition(" (default: ")
    default = default.rstrip(")")
    if not default and action.nargs != 0 and action.default is not None:
        default = str(action.default)
    cells = f"`{called(action)}`", "required" if action.required else default, does
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def commands_of(group: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Yield the commands below a parser, those of groups of commands as well."""
    below = [action for action in group._actions if isinstance(action, argparse._SubParsersAction)]
    if not below:
        yield group
    for action in below:
        for command in action.choices.values():
            yield from commands_of(command)


def command_section(command: argparse.ArgumentParser) -> str:
    options = [
        action
        for action in command._actions
        if not isinstance(action, UNTOLD) and action.help != argparse.SUPPRESS
    ]
    actions = sorted(options, key=lambda action: bool(action.option_strings))
    title = command.prog.removeprefix("crowd-lod ")
    table = "\n".join(["| option | default | does |", "| --- | --- | --- |", *map(option, actions)])
    example = (command.epilog or "").removeprefix("example: ")
    return (
        f"## {title}\n\n{command.description}\n\n```sh\n{usage(command, actions)}\n\n# for "
        f"example\n{example}\n```\n\n{table}\n"
    )


def commands_page() -> str:
    about = (
        f"# Commands and their options\n\n{WRITTEN}\n\n"
        "[Commands](commands.md) tells what they write, exit codes and tables. `--help` "
        "after a\n"
        "command shows what stands here; `--version` shows the versions of Crowd LOD and Blender.\n"
    )
    return "\n".join([about, *map(command_section, commands_of(parser("crowd-lod")))])


PAGES = {
    "reference_settings.md": settings_page,
    "reference_commands.md": commands_page,
}


def main() -> None:
    crowd_lod_extension.register()
    for name, page in PAGES.items():
        (DOCS / name).write_text(page(), encoding="utf-8")
    crowd_lod_extension.unregister()


if __name__ == "__main__":
    main()
