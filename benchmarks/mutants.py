"""Small changes of one file, and whether its nearest tests notice each.

    .venv-3.13/bin/python benchmarks/mutants.py crowd_lod/culling/radar.py tests/core/test_culling.py

A change doubles or halves a number, turns a sign or a comparison, or skips a statement. Of all that
the file has as many are tried as --most says, drawn by --seed. Each is made in a copy of the
checkout, and a process of its own runs the tests there until one fails. Survivors are listed: a
test lacks, or the change makes no difference.

Linux and macOS only: a process is started for each change by fork, with NumPy and pytest loaded.
"""

import argparse
import ast
import os
import random
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = "crowd_lod_extension"
PARTS = "crowd_lod", "operators", "sample_scenes", "shaders", "tests", "docs"
COMPARISONS = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
}
SIGNS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}


def changes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield other nodes in place of this one."""
    match node:
        case ast.Constant(value=int() | float()) if node.value and not isinstance(node.value, bool):
            half = node.value // 2 if isinstance(node.value, int) else node.value / 2
            yield from (ast.Constant(value) for value in (2 * node.value, half))
        case ast.UnaryOp(op=ast.USub()):
            yield node.operand
        case ast.BinOp() if type(node.op) in SIGNS:
            yield ast.BinOp(node.left, SIGNS[type(node.op)](), node.right)
        case ast.Compare(ops=[one]) if type(one) in COMPARISONS:
            yield ast.Compare(node.left, [COMPARISONS[type(one)]()], node.comparators)
        case ast.AugAssign() | ast.Expr(value=ast.Call()):
            yield ast.Pass()


def places(tree: ast.AST) -> Iterator[tuple[ast.AST, str, int | None]]:
    """Yield (parent, field, index) of each node that a change may replace."""
    for parent in ast.walk(tree):
        if isinstance(parent, ast.JoinedStr | ast.Raise):
            continue
        for field, value in ast.iter_fields(parent):
            if field in ("annotation", "returns", "decorator_list"):
                continue
            for index, child in enumerate(value if isinstance(value, list) else [value]):
                if isinstance(child, ast.AST):
                    yield parent, field, index if isinstance(value, list) else None


def mutants(text: str) -> Iterator[tuple[int, str, str]]:
    """Yield (line, what is changed, the changed text) of each change of a module."""
    tree = ast.parse(text)
    for number, (parent, field, index) in enumerate(places(tree)):
        value = getattr(parent, field)
        node = value if index is None else value[index]
        for other in changes(node):
            copy = deepcopy(tree)
            home, *_ = list(places(copy))[number]
            if index is None:
                setattr(home, field, other)
            else:
                getattr(home, field)[index] = other
            change = f"{ast.unparse(node)} -> {ast.unparse(other)}"
            yield node.lineno, change, ast.unparse(ast.fix_missing_locations(copy))


def passes(folder: Path, tests: list[str], seconds: float) -> tuple[bool, float]:
    """Return (whether the tests pass in `folder`, the seconds of a processor that they took).

    seconds: that they may take, else they fail.
    """
    import pytest

    child = os.fork()
    if not child:
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 2))
        sys.path.insert(0, str(folder.parent))
        os.chdir(folder)
        os._exit(pytest.main(["-x", "-q", "-p", "no:cacheprovider", *tests]))
    _, status, used = os.wait4(child, 0)
    return os.waitstatus_to_exitcode(status) == 0, used.ru_utime + used.ru_stime


def copied(folder: Path) -> Path:
    """Copy the checkout's package and tests into `folder`."""
    home = folder / PACKAGE
    home.mkdir()
    for name in PARTS:
        shutil.copytree(ROOT / name, home / name, ignore=shutil.ignore_patterns("__pycache__"))
    for path in (*ROOT.glob("*.py"), *ROOT.glob("*.toml"), *ROOT.glob("*.md")):
        shutil.copy(path, home)
    return home


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path, help="of the checkout, by its path in it")
    parser.add_argument("tests", nargs="+", help="what pytest is given")
    parser.add_argument("--most", type=int, default=40, help="changes (default: 40)")
    parser.add_argument("--seed", type=int, default=0, help="draws others (default: 0)")
    args = parser.parse_args()
    import numpy  # noqa: F401 - once, for all the processes
    import pytest  # noqa: F401

    sys.dont_write_bytecode = True
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)
    every = list(mutants((ROOT / args.file).read_text(encoding="utf-8")))
    chosen = sorted(random.Random(args.seed).sample(range(len(every)), min(args.most, len(every))))
    with tempfile.TemporaryDirectory() as temporary:
        home = copied(Path(temporary))
        pass_unchanged, seconds = passes(home, args.tests, 600)
        assert pass_unchanged, "the tests fail without any change"
        survivors = 0
        for number in chosen:
            line, change, text = every[number]
            (home / args.file).write_text(text, encoding="utf-8")
            if passes(home, args.tests, 4 * seconds + 5)[0]:
                survivors += 1
                print(f"{args.file}:{line} survives: {change}", flush=True)
    print(f"{args.file}: {len(chosen)} of {len(every)} changes, {survivors} survive")


if __name__ == "__main__":
    main()
