"""From a file, whatever its format, to tracks."""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ..errors import CrowdError
from ..format import printable
from . import jupedsim, npz, text
from .making import tracks_of
from .rows import Rows, check_rows
from .tracks import Tracks

ZIP = b"PK\x03\x04"
HEADS = 1.0, 2.3  # meters, where the heads of people are


def read_rows(path: Path, tell: Callable[[float], None] = lambda _: None) -> Rows:
    """Return the rows of the file `path`, checked, in the file's own unit.

    tell: called with the progress, 0 to 1.
    CrowdError if it cannot be read, or a value cannot be used.
    """
    where = printable(path)
    try:
        with path.open("rb") as file:
            head = file.read(len(jupedsim.MAGIC))
        if not head:
            raise CrowdError(f"The file {where} is empty: choose a file of trajectories.")
        if head.startswith(ZIP):
            rows = npz.read(path)
        elif head == jupedsim.MAGIC:
            rows = jupedsim.read_jupedsim(path, tell)
        else:
            rows = text.read_text(path, tell)
    except OSError as error:
        reason = error.strerror or error
        raise CrowdError(f"The file of trajectories {where} cannot be read ({reason}): choose another.") from None
    return check_rows(rows, path)


def read_tracks(
    path: Path, unit: str = "", rate: float = 0.0, usual: float = 0.0, tell: Callable[[float], None] = lambda _: None
) -> Tracks:
    """Return the tracks of the file `path`.

    unit: one of rows.UNITS, whatever the file tells; "" for the file's own, or else meters.
    rate: frames of the file a second, whatever it tells; 0 for its own.
    usual: the rate if neither tells one, such as the scene's.
    tell: called with the progress, 0 to 1.
    CrowdError if it cannot be read or used.
    """
    rows = read_rows(path, lambda part: tell(0.6 * part)).in_meters(unit)
    notes = rows.notes
    if not rate and not rows.rate:
        if not usual:
            raise CrowdError(f"The file {printable(path)} tells no frame rate: set Frame Rate to its frames a second.")
        notes += ("It tells no frame rate: each of its frames is one of the scene's.",)
    rows = replace(rows, rate=rate or rows.rate or usual, notes=notes)
    tell(0.6)
    return tracks_of(_standing(rows), printable(path))


def _standing(rows: Rows) -> Rows:
    """Return `rows` with heights of feet.

    Those that PeTrack gives are of heads, and many files give zeros.
    """
    if rows.z is None or not rows.z.any():
        return replace(rows, z=None)
    low, high = float(rows.z.min()), float(rows.z.max())
    if rows.heading is None and not rows.feet and HEADS[0] <= low and high <= HEADS[1]:
        told = f"Its z of {low:.3g} to {high:.3g} m is taken for the height of heads: agents stand at the height of Center."
        return replace(rows, z=None, notes=(*rows.notes, told))
    return rows


def content_of(path: Path) -> bytes:
    """Return the digest of the file's content. OSError if it cannot be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()
