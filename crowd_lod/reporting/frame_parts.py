"""The frames of a run that are whole, each with a record that was written after its pictures.

With them a killed run goes on, processes share a run, and chunks are assembled
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
CLAIM = ".claim"  # the ending of a frame's mark that a process makes it


@dataclass(frozen=True)
class FrameParts:
    """The whole frames of a run in a folder.

    folder: holds the pictures.
    state: of all that the frames follow from; frames of another state do not count.
    """

    folder: Path
    state: str

    def get(self, number: int) -> dict[str, Any] | None:
        """Return what was told of the frame `number`; None if it is not whole."""
        record = _read_record(self._record(number))
        if record is None or record["state"] != self.state:
            return None
        with suppress(OSError):  # a picture that is gone
            if all(_sum(self.folder / name) == value for name, value in record["files"].items()):
                return record["told"]
        return None

    def put(self, number: int, told: dict[str, Any], pictures: Sequence[Path]) -> dict[str, Any]:
        """Declare the frame `number` whole; return what `get` will return.

        told: of the frame, for JSON.
        pictures: its files, in this folder. CrowdError if one was not written to its end.
        """
        for picture in pictures:
            file_checks.check(picture)
            file_checks.sync(picture)
        record = self._record(number)
        record.parent.mkdir(exist_ok=True)
        part = record.with_suffix(f".{os.getpid()}")
        sums = {picture.name: _sum(picture) for picture in pictures}
        text = json.dumps({"state": self.state, "told": told, "files": sums})
        part.write_text(json.dumps([_digest(text), text]), encoding="utf-8")
        file_checks.sync(part)
        part.replace(record)
        return json.loads(text)["told"]

    def claim(self, number: int) -> bool:
        """Take the frame `number` on for this process; return False if a process has done so
        before.
        """
        record = self._record(number)
        record.parent.mkdir(exist_ok=True)
        try:
            os.close(os.open(record.with_suffix(CLAIM), os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            return False
        record.unlink(missing_ok=True)  # of another state
        return True

    def release(self) -> None:
        """Give up the claims of all processes."""
        for claim in (self.folder / RECORDS).glob(f"*{CLAIM}"):
            claim.unlink(missing_ok=True)

    def _record(self, number: int) -> Path:
        return self.folder / RECORDS / f"{number:04d}.json"


def whole_frames(folder: Path) -> list[int]:
    """Return the numbers of the frames that have a record in `folder`, of whichever state,
    increasing.
    """
    found = []
    for record in (folder / RECORDS).glob("*.json"):
        with suppress(ValueError):
            found.append(int(record.stem))
    return sorted(found)


def keep_whole(folder: Path) -> None:
    """Remove the files in `folder` that no record names: parts of frames that were not finished."""
    named: set[str] = set()
    for record in (folder / RECORDS).glob("*.json"):
        found = _read_record(record)
        named.update(found["files"] if found else ())
    for path in folder.glob("[!.]*"):
        if path.is_file() and path.name not in named:
            path.unlink()


def take(source: Path, folder: Path) -> None:
    """Take all records and their pictures over from the folder `source`, whose files stay."""
    (folder / RECORDS).mkdir(exist_ok=True)
    for path in [*source.glob("[!.]*.png"), *(source / RECORDS).glob("*.json")]:
        target = folder / path.relative_to(source)
        try:
            os.link(path, target)
        except OSError:  # another disk, or one without links
            shutil.copyfile(path, target)


def _read_record(path: Path) -> dict[str, Any] | None:
    """Return what the record says; None if there is none, or it was not written to its end."""
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
