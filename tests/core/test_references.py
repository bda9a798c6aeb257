"""What docstrings, comments and pages name is there: files, functions of modules, identifiers."""

import ast
import builtins
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

pytestmark = pytest.mark.once  # about texts, the same on every Blender

ROOT = Path(__file__).parents[2]
FOLDERS = "crowd_lod", "operators", "sample_scenes", "tests", "benchmarks", "docs"
SOURCES = [
    *ROOT.glob("*.py"),
    *(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")),
]
PAGES = [
    *(path for path in ROOT.glob("*.md") if path.name != "CHANGELOG.md"),
    *(ROOT / "docs").rglob("*.md"),
]
FILE = re.compile(r"(?<![\w/<*.~-])((?:\w+/)*\w+\.py)\b")
MEMBER = re.compile(r"(?<![\w./])([a-z]\w+)\.([A-Za-z_]\w+)(?![\w/]|\.\w)")
OURS = re.compile(r"""(?:}|extension|")\.((?:crowd_lod|operators)(?:\.[a-z]\w*)+)""")
QUOTED = re.compile(r"(?<!`)`([A-Za-z_]\w+)(?:\(\))?`(?!`)")
COMMENT = re.compile(r"(?m)(?:^ *|  )# (.*)$")
ENDINGS = set("py md json csv npz blend html png webp toml txt usdc usda".split())
EXAMPLES = {"tests/core/test_tiny_agents.py", "crowd_lod/culling/tiny_agents.py"}  # CONTRIBUTING


class Module(NamedTuple):
    """names: all that it defines or uses by name. words: of texts without a space: columns, keys,
    identifiers of Blender. told: (line, text) of docstrings and comments.
    """

    names: set[str]
    words: set[str]
    told: list[tuple[int, str]]


@cache
def modules() -> dict[Path, Module]:
    return {path: module(path.read_text(encoding="utf-8")) for path in SOURCES}


def module(text: str) -> Module:
    names = set()
    texts = []
    told = [(text.count("\n", 0, each.start()) + 1, each[1]) for each in COMMENT.finditer(text)]
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Constant():
                if isinstance(node.value, str) and " " not in node.value:
                    texts.append(node.value)
            case ast.Name():
                names.add(node.id)
            case ast.Attribute():
                names.add(node.attr)
            case ast.arg() | ast.keyword():
                names.add(node.arg)
            case ast.alias():
                names.add((node.asname or node.name).rpartition(".")[2])
            case ast.FunctionDef() | ast.ClassDef():
                names.add(node.name)
                told.append((node.lineno, ast.get_docstring(node) or ""))
            case ast.Module():
                told.append((1, ast.get_docstring(node) or ""))
    return Module(names, set(re.findall(r"\w+", "\n".join(texts))), told)


@cache
def told() -> list[tuple[Path, int, str]]:
    """Return (file, line, text) of all that is written about the code."""
    texts = [
        (path.relative_to(ROOT), line, text)
        for path, own in modules().items()
        for line, text in own.told
    ]
    for path in PAGES:
        lines = path.read_text(encoding="utf-8").splitlines()
        texts += [(path.relative_to(ROOT), line, text) for line, text in enumerate(lines, 1)]
    return texts


def test_files_that_are_named_exist():
    files = {f"/{path.relative_to(ROOT).as_posix()}" for path in SOURCES}
    lost = [
        (str(path), line, name)
        for path, line, text in told()
        for name in FILE.findall(text)
        if name not in EXAMPLES and not any(file.endswith(f"/{name}") for file in files)
    ]
    assert lost == []


def test_members_of_modules_that_are_named_exist():
    members: dict[str, set[str]] = {}
    for path, own in modules().items():
        members.setdefault(path.stem, set()).update(own.names)
    lost = [
        (str(path), line, f"{module}.{name}")
        for path, line, text in told()
        for module, name in MEMBER.findall(text)
        if module in members and name not in members[module] | ENDINGS
    ]
    assert lost == []


def test_identifiers_that_docstrings_quote_exist():
    known = set(dir(builtins)) | {part for path in SOURCES for part in path.with_suffix("").parts}
    for own in modules().values():
        known |= own.names | own.words
    lost = [
        (str(path), line, name)
        for path, line, text in told()
        if path.suffix == ".py"
        for name in QUOTED.findall(text)
        if name not in known
    ]
    assert lost == []


def test_modules_that_texts_of_code_name_exist():
    """Such as `sys.modules[f"{MODULE}.operators.blender.steps"].at_work()`."""
    lost = []
    for path in SOURCES:
        for dotted in OURS.findall(path.read_text(encoding="utf-8")):
            place = ROOT.joinpath(*dotted.split("."))
            if not (place.is_dir() or place.with_suffix(".py").is_file()):
                # the last word may be a member of the module
                if not place.parent.with_suffix(".py").is_file():
                    lost.append((str(path.relative_to(ROOT)), dotted))
    assert lost == []
