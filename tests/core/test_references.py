"""What docstrings, comments and pages name is there: files, functions of modules, identifiers."""

import ast
import builtins
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

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
ENDINGS = set("py md json csv npz blend html png webp toml txt usdc usda".split())
EXAMPLES = {"tests/core/test_tiny_agents.py", "crowd_lod/culling/tiny_agents.py"}  # CONTRIBUTING


@cache
def trees() -> dict[Path, ast.Module]:
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES}


def names_in(tree: ast.Module) -> set[str]:
    """All that a module defines or uses by name."""
    names = set()
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef() | ast.ClassDef():
                names.add(node.name)
            case ast.Name():
                names.add(node.id)
            case ast.Attribute():
                names.add(node.attr)
            case ast.arg() | ast.keyword():
                names.add(node.arg)
            case ast.alias():
                names.add((node.asname or node.name).rpartition(".")[2])
    return names


def words_in(tree: ast.Module) -> set[str]:
    """The words of texts without a space: columns, keys, identifiers of Blender."""
    texts = (node.value for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return {
        word
        for text in texts
        if isinstance(text, str) and " " not in text
        for word in re.findall(r"\w+", text)
    }


def comments(path: Path, tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield (line, text) of docstrings and comments."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef):
            yield getattr(node, "lineno", 1), ast.get_docstring(node) or ""
    source = io.StringIO(path.read_text(encoding="utf-8"))
    for token in tokenize.generate_tokens(source.readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


@cache
def told() -> list[tuple[Path, int, str]]:
    """Return (file, line, text) of all that is written about the code."""
    texts = [
        (path.relative_to(ROOT), line, text)
        for path, tree in trees().items()
        for line, text in comments(path, tree)
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
    for path, tree in trees().items():
        members.setdefault(path.stem, set()).update(names_in(tree))
    lost = [
        (str(path), line, f"{module}.{name}")
        for path, line, text in told()
        for module, name in MEMBER.findall(text)
        if module in members and name not in members[module] | ENDINGS
    ]
    assert lost == []


def test_identifiers_that_docstrings_quote_exist():
    known = set(dir(builtins)) | {part for path in SOURCES for part in path.with_suffix("").parts}
    for tree in trees().values():
        known |= names_in(tree) | words_in(tree)
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
