"""Build the extension's zips, one for each platform: `./crowd-lod package`.

Fetches the wheels that blender_manifest.toml lists, then validates and builds with Blender's own
tool: the one of the Blender that the environment variable BLENDER names, or else the copy that
ships inside the bpy module. README and docs become web pages in the zips. Prints
one path a line, with its size.
"""

import argparse
import hashlib
import os
import posixpath
import re
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Collection
from html import escape
from importlib.util import find_spec
from pathlib import Path

from crowd_lod_extension.crowd_lod import interrupt
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.output.files import staged
from crowd_lod_extension.crowd_lod.output.html_report import STYLE, document
from markdown import Markdown

ROOT = Path(__file__).resolve().parent
WHEELS = ROOT / "wheels"
HASHES = ROOT / "wheels.sha256"
PAGE_STYLE = """
body { max-width: 56rem } table { display: block; overflow-x: auto; margin: 1rem 0 }
th, td { text-align: left; vertical-align: top } p, li { color: var(--ink) }
pre { background: var(--card); border: 1px solid var(--line); padding: .8rem; overflow-x: auto }
"""
LINK = re.compile(r'(?<=<a href=")(?!\w+:)[^"#]+')  # to a file, without the heading


class Failure(Exception):
    """What the user has to know, in one sentence."""


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="crowd-lod package",
        description="Build the extension's zips for Blender, one for each platform.",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=ROOT / "dist",
        metavar="DIR",
        help="the zips' folder (%(default)s)",
    )
    out = parser.parse_args().out.resolve()

    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    names = [Path(wheel).name for wheel in manifest["wheels"]]
    if set(names) != pinned().keys():
        raise Failure(
            f"{HASHES.name} and blender_manifest.toml list other wheels: write the hashes anew "
            f"with sha256sum, in {WHEELS.name}"
        )
    fetch(names)
    extension_tool("validate", ROOT)
    with tempfile.TemporaryDirectory() as folder, staged(out) as stage:
        extension_tool("build", "--split-platforms", "--source-dir", ROOT, "--output-dir", folder)
        lines = []
        for built in sorted(Path(folder).glob("*.zip")):
            archive = stage / built.name
            write_web_pages(built, archive, manifest["website"])
            extension_tool("validate", archive)
            size = archive.stat().st_size / 1e6
            lines.append(f"{out / archive.name}  {size:.1f} MB\n")
    # at once, and in any encoding: a full stdout is an error here, not at exit
    os.write(1, os.fsencode("".join(lines)))


def write_web_pages(built: Path, archive: Path, website: str) -> None:
    """Copy the zip `built` to `archive`, with web pages in place of its Markdown pages.

    website: of the repository, where links lead whose files are not in the zip.
    """
    with zipfile.ZipFile(built) as source, zipfile.ZipFile(archive, "w") as target:
        names = source.namelist()
        for entry in source.infolist():
            content = source.read(entry)
            if entry.filename.endswith(".md"):
                content = web_page(content.decode(), entry.filename, names, website).encode()
                entry.filename = entry.filename.removesuffix(".md") + ".html"
            target.writestr(entry, content)


def web_page(text: str, name: str, names: Collection[str], website: str) -> str:
    """Return the Markdown `text` as a web page.

    name: of its file in the zip. names: of all files there.
    """

    def address_of(link: re.Match) -> str:
        path = posixpath.normpath(posixpath.join(posixpath.dirname(name), link[0]))
        if not any(each == path or each.startswith(f"{path}/") for each in names):
            return f"{website}/blob/main/{path}"
        return re.sub(r"\.md$", ".html", link[0])

    markdown = Markdown(extensions=["fenced_code", "tables", "toc"], output_format="html")
    content = LINK.sub(address_of, markdown.convert(text))
    return document(escape(markdown.toc_tokens[0]["name"]), STYLE + PAGE_STYLE, [content])


def fetch(names: list[str]) -> None:
    """Make the folder of wheels hold these files and no others."""
    missing = [name for name in names if not whole(WHEELS / name)]  # a spoilt one is fetched anew
    if missing:
        with staged(WHEELS) as stage:
            download(missing, stage)
    for stale in WHEELS.glob("*.whl"):
        if stale.name not in names:
            stale.unlink()


def download(names: list[str], folder: Path) -> None:
    for name in names:
        package, version, python, abi, platforms = name.removesuffix(".whl").split("-")
        target = [f"--platform={platform}" for platform in platforms.split(".")]
        if abi != "none":  # a compiled wheel; a pure one fits every Python
            target += [f"--python-version={python[2]}.{python[3:]}", f"--abi={abi}"]
        run(
            f"could not fetch {name}; is the network there?",
            *(
                sys.executable,
                "-m",
                "pip",
                "download",
                "--quiet",
                "--no-deps",
                "--only-binary=:all:",
            ),
            *(*target, f"--dest={folder}", f"{package}=={version}"),
        )
        if not (folder / name).exists():
            raise Failure(
                f"blender_manifest.toml lists {name}, and pip fetched another file of {package} "
                f"{version}"
            )
        if not whole(folder / name):
            raise Failure(
                f"{name}, as pip fetched it, is not the file whose SHA-256 {HASHES.name} has; "
                f"empty pip's cache (pip cache purge) and try again"
            )


def whole(wheel: Path) -> bool:
    """Whether the wheel is there, and is the one whose SHA-256 wheels.sha256 has."""
    try:
        with wheel.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest() == pinned()[wheel.name]
    except OSError:
        return False


def pinned() -> dict[str, str]:
    """Return the SHA-256 of each wheel by name, as sha256sum writes them."""
    lines = HASHES.read_text(encoding="utf-8").splitlines()
    return {name: digest for digest, name in map(str.split, lines)}


def extension_tool(action: str, *arguments: str | Path) -> None:
    if blender := os.environ.get("BLENDER"):
        tool = [blender, "--factory-startup", "--command", "extension"]
    else:
        tool = [sys.executable, str(bundled_tool())]
    run(f"Blender's extension tool refused to {action}:", *tool, action, *map(str, arguments))


def bundled_tool() -> Path:
    """The script behind `blender --command extension`, which needs no Blender."""
    bpy = find_spec("bpy")
    found = Path(bpy.origin).parent.rglob("bl_pkg/cli/blender_ext.py") if bpy else iter(())
    if script := next(found, None):
        return script
    raise Failure("the bpy module has no extension tool here; set BLENDER to Blender's executable")


def run(failure: str, *command: str) -> None:
    try:
        result = subprocess.run(
            command,
            check=False,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            cwd=ROOT,
        )
    except OSError as error:
        raise Failure(f"could not start {command[0]} ({error.strerror})") from error
    if result.returncode:
        words = (result.stderr + result.stdout).strip().splitlines() or [
            f"exit status {result.returncode}"
        ]
        raise Failure(f"{failure} {words[-1]}")


if __name__ == "__main__":
    try:
        main()
    except OSError as error:
        sys.exit(
            f"crowd-lod package: {error.strerror}"
            + (f": {error.filename}" if error.filename else "")
        )
    except (Failure, CrowdError) as failure:
        sys.exit(f"crowd-lod package: {failure}")
    except KeyboardInterrupt:
        sys.exit(interrupt.stopped())
