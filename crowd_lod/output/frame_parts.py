"""Whole frames of a run: each has a record, which is written after its pictures.

So a killed run can be resumed, processes can share a run, and chunks can be assembled
(docs/notes/files.md).
"""

import hashlib
import json
import os
import shutil
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from . import file_checks

RECORDS = ".frames"  # the folder of the records, beside the pictures


@dataclass(frozen=True)
class FrameParts:
    """The whole frames of a run in a folder.

    folder: holds the pictures.
    state: a digest of all input of the frames; frames of another state do not count.
    """

    folder: Path
    state: str

    def get(self, number: int) -> dict[str, Any] | None:
        """Return the facts stored of the frame `number`; None if it is not whole."""
        record = _read_record(self._record(number))
        if record is None or record["state"] != self.state:
            return None
        with suppress(OSError):  # a picture that is gone
            if all(_sum(self.folder / name) == value for name, value in record["files"].items()):
                return record["facts"]
        return None

    def store(self, number: int, facts: dict[str, Any], pictures: Sequence[Path]) -> dict[str, Any]:
        """Declare the frame `number` whole; return what `get` will return.

        facts: about the frame, plain data for JSON.
        pictures: its files, in this folder. CrowdError if one was not written to its end.
        """
        for picture in pictures:
            file_checks.check(picture)
            file_checks.sync(picture)
        record = self._record(number)
        record.parent.mkdir(exist_ok=True)
        part = record.with_suffix(f".{os.getpid()}")
        sums = {picture.name: _sum(picture) for picture in pictures}
        text = json.dumps({"state": self.state, "facts": facts, "files": sums})
        part.write_text(json.dumps([_digest(text), text]), encoding="utf-8")
        file_checks.sync(part)
        part.replace(record)
        return json.loads(text)["facts"]

    def _record(self, number: int) -> Path:
        return self.folder / RECORDS / f"{number:04d}.json"


def whole_frames(folder: Path) -> list[int]:
    """Return the numbers of the frames with a record in `folder`, of any state, increasing."""
    numbers = []
    for record in (folder / RECORDS).glob("*.json"):
        with suppress(ValueError):
            numbers.append(int(record.stem))
    return sorted(numbers)


def keep_whole(folder: Path) -> None:
    """Remove the files in `folder` that no record names: parts of unfinished frames."""
    names: set[str] = set()
    for record in (folder / RECORDS).glob("*.json"):
        content = _read_record(record)
        names.update(content["files"] if content else ())
    for path in folder.glob("[!.]*"):
        if path.is_file() and path.name not in names:
            path.unlink()


def take(source: Path, folder: Path) -> None:
    """Copy all records and their pictures from the folder `source`."""
    (folder / RECORDS).mkdir(exist_ok=True)
    for path in [*source.glob("[!.]*.png"), *(source / RECORDS).glob("*.json")]:
        target = folder / path.relative_to(source)
        try:
            os.link(path, target)
        except OSError:  # another disk, or one without links
            shutil.copyfile(path, target)


def _read_record(path: Path) -> dict[str, Any] | None:
    """Return the record's content; None if there is none, or it was not written to its end."""
    try:
        digest, text = json.loads(path.read_bytes())
        return json.loads(text) if digest == _digest(text) else None
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return None


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _sum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
