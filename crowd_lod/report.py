"""What a run leaves on disk: tables, plans, contact sheets, put in place only when all is well."""

import csv
import io
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from . import interrupt
from .errors import CrowdError
from .frame import Frame

PLAN_VERSION = 1


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """A folder to write in, beside `folder`'s files; when the block ends well its files are renamed into `folder`, one
    replacing another of its name. After an error, Esc or Ctrl-C `folder` is as it was."""
    made = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    stage = None

    def clean():
        if stage is not None:
            gone = stage.with_name(f"{stage.name}-gone")  # under its own name, work that goes on would fill it meanwhile
            with suppress(OSError):
                stage.rename(gone)
            shutil.rmtree(gone, ignore_errors=True)
            shutil.rmtree(stage, ignore_errors=True)
        _remove_empty(made)

    with interrupt.unfinished(clean):
        try:
            with interrupt.held():
                folder.mkdir(parents=True, exist_ok=True)
                stage = Path(tempfile.mkdtemp(prefix=".crowd-lod-", dir=folder))
        except OSError as error:
            raise CrowdError(
                f"The output folder {folder} cannot be written ({error.strerror}): choose another with --out."
            ) from None
        try:
            yield stage
            with interrupt.held():
                for path in sorted(stage.iterdir()):
                    os.replace(path, folder / path.name)
                interrupt.too_late(f"the output in {folder} is complete")
        except OSError as error:
            raise CrowdError(
                f"Writing to {folder} failed ({error.strerror}): free space there, or choose another folder."
            ) from None


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return


def row(number: int, frame: Frame, more: dict[str, float]) -> dict[str, int | float]:
    """A row of frames.csv; `more` adds milliseconds of stages outside the core, by name."""
    shown = int(frame.visible.sum())
    counts = {f"lod{k}": int(n) for k, n in enumerate(frame.buckets.counts)}
    unseen = {name: len(b.order) for name, b in (("shadow", frame.shadow), ("mirrored", frame.mirrored)) if b is not None}
    stages = {f"{name}_ms": round(ms, 3) for name, ms in (frame.milliseconds | more).items()}
    return {
        "frame": number,
        "agents": len(frame.crowd),
        "visible": shown,
        "culled": len(frame.crowd) - shown,
        **counts,
        **unseen,
        "vertices": frame.vertices,
        "triangles": frame.triangles,
        "full_vertices": frame.full_vertices,
        "full_triangles": frame.full_triangles,
        **stages,
    }


def to_csv(rows: list[dict]) -> str:
    """The rows, which share their keys, as CSV with a header."""
    text = io.StringIO()
    writer = csv.DictWriter(text, rows[0].keys(), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def to_json(plan: dict) -> str:
    """The plan as JSON; floats as they are, NaN refused."""
    return json.dumps(plan, indent=2, allow_nan=False) + "\n"


def shrink(picture: np.ndarray, width: int) -> np.ndarray:
    """The picture (rows, columns, 4) uint8 made smaller by a whole factor, by averaging, to at least `width` columns."""
    factor = max(1, picture.shape[1] // width)
    rows, columns = (n // factor for n in picture.shape[:2])
    blocks = picture[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor, 4)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)


def contact_sheet(pictures: list[np.ndarray], columns: int, gap: int = 6) -> np.ndarray:
    """The pictures, each (rows, columns, 4) uint8 with the bottom row first, on one dark sheet, read from the top left."""
    height, width = (max(p.shape[axis] for p in pictures) for axis in (0, 1))
    rows = -(-len(pictures) // columns)
    sheet = np.zeros((rows * (height + gap) + gap, columns * (width + gap) + gap, 4), np.uint8)
    sheet[:] = (24, 24, 24, 255)
    for number, picture in enumerate(pictures):
        row, column = divmod(number, columns)
        bottom, left = (rows - 1 - row) * (height + gap) + gap, column * (width + gap) + gap
        sheet[bottom : bottom + picture.shape[0], left : left + picture.shape[1]] = picture
    return sheet
