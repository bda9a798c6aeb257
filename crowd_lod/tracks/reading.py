"""From a file, whatever its format, to tracks.

NumPy's NPZ is the format that Crowd LOD writes itself. Arrays of one length: `id` (whole numbers),
`frame`, `x`, `y` and `z` (meters); optional `heading` (radians), `phase` (cycles), `group` (whole
numbers or names). Single values: `fps`, frames a second, and optional `unit`, one of m, cm, mm and
ft, and `until`, the frame up to which the file tells who is there.
"""

import gzip
import hashlib
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..crowd import random_streams
from ..errors import CrowdError
from ..format import printable
from ..npz_file import MOST_BYTES, read_arrays
from ..progress import check_cancelled
from . import jupedsim, layout, text
from .rows import COLUMNS, GREATEST, UNITS, Rows, check_rows, tracks_of
from .tracks import Tracks


def write_npz(path: Path, rows: Rows) -> None:
    """Write `rows`, in meters, to the file `path`, which need not end in .npz.

    The caller puts the file in its place (output/files.py). OSError if it cannot be written.
    """
    numbers = {"fps": np.float64(rows.rate)}
    if np.isfinite(rows.until):
        numbers["until"] = np.float64(rows.until)
    with path.open("wb") as file:
        np.savez(file, **numbers, **rows.columns)  # type: ignore[arg-type]


def read_npz(path: Path) -> Rows:
    """Return the rows of the file `path`, as they are: check_rows has not seen them.

    CrowdError if it is no NPZ, or lacks an array. OSError if it cannot be read.
    """
    where = printable(path)
    columns: dict[str, Any] = dict(
        read_arrays(path, ("id", "frame", "x", "y"), (*COLUMNS, "fps", "unit", "until"))
    )
    rate = columns.pop("fps", np.zeros(()))
    until = columns.pop("until", np.full((), -np.inf))
    unit = str(columns.pop("unit", "m"))
    for name, values in (("fps", rate), ("until", until)):
        if values.shape not in ((), (1,)) or values.dtype.kind not in "iuf":
            told = {"fps": "its frames a second", "until": "its last frame"}[name]
            raise CrowdError(
                f"The file {where} has {values.size} values of {name}: give one number, {told}."
            )
    if unit not in UNITS:
        raise CrowdError(
            f"The file {where} has the unit {unit[:40]}: use one of {', '.join(UNITS)}."
        )
    last = float(until.reshape(()))
    if not last <= GREATEST["frame"]:
        raise CrowdError(f"The file {where} has until {last}: give the number of its last frame.")
    return Rows(**columns, rate=float(rate.reshape(())), unit=unit, feet=True, until=last)


def groups_of_agents(
    tracks: Tracks, names: Sequence[str], choices: np.ndarray, seed: int
) -> np.ndarray:
    """Return (n,) uint8, the index of each agent's character group.

    Groups that the file names as the scene does are these. Any others, and whole numbers, take the
    crowd's groups in turn. Without groups in the file they are drawn.

    names: of all character groups of the scene.
    choices: (k,) uint8, the groups that the crowd's agents are drawn from.
    seed: of the draw.
    """
    if tracks.group is None:
        return drawn_groups(tracks.ids, choices, seed)
    values, value_of_agent = np.unique(tracks.group, return_inverse=True)
    if tracks.group.dtype.kind == "U":
        numbers = {name.casefold(): g for g, name in enumerate(names)}
        groups = [
            numbers.get(str(value).strip().casefold(), choices[k % len(choices)])
            for k, value in enumerate(values)
        ]
    else:
        groups = [choices[int(value) % len(choices)] for value in values]
    return np.array(groups, np.uint8)[value_of_agent]


def drawn_groups(ids: np.ndarray, choices: np.ndarray, seed: int) -> np.ndarray:
    """Return the group that each of the agents `ids` (n,) draws of `choices` (k,), (n,) uint8."""
    draw = random_streams.uniform(random_streams.keys_of(seed, ids), random_streams.THEN)
    return choices[np.minimum((draw * len(choices)).astype(np.intp), len(choices) - 1)]


ZIP = b"PK"
GZIP = b"\x1f\x8b"
UTF_16 = (b"\xff\xfe", b"\xfe\xff")
UTF_8 = b"\xef\xbb\xbf"
# how files begin that are known and not read: what they are, and what to do
OTHERS = {
    b"\x89HDF\r\n\x1a\n": (
        "HDF5",
        "write its table as CSV, by pandas.read_hdf(file).to_csv(other), say",
    ),
    b"<": ("XML", "write it as CSV with columns id, time, x and y, as SUMO's xml2csv.py does"),
    b"{": ("JSON", "write it as CSV with columns id, frame, x and y, by pandas, say"),
    b"[": ("JSON", "write it as CSV with columns id, frame, x and y, by pandas, say"),
}
LOOK = 2**16  # bytes in which a zero tells that it is no text
CHUNK = (
    2**22
    # bytes that are read between two looks at whether anybody still waits; more than
    # layout.LONGEST_LINE
)
READ = 0.6  # part of the time of making tracks that their rows take to be read
HEADS = 1.0, 2.3  # meters, where the heads of people are


def read_rows(
    path: Path, columns: str = "", tell: Callable[[float], None] = lambda _: None
) -> Rows:
    """Return the rows of the file `path`, checked, in the file's own unit.

    The format goes by the content.
    columns: titles of a table's columns, such as frame,id,x,y, whatever it tells; "" for its own.
    tell: called with the progress, 0 to 1.
    CrowdError if it cannot be read, or a value cannot be used.
    """
    where = printable(path)
    try:
        _refuse_folder(path)
        with path.open("rb") as file:
            head = file.read(len(jupedsim.MAGIC))
        if head.startswith(ZIP):
            rows = read_npz(path)
        elif head == jupedsim.MAGIC:
            rows = jupedsim.read_jupedsim(path, tell)
        else:
            data = _text_of(path, head.startswith(GZIP))
            rows = text.read_text(data, where, columns, tell)
    except OSError as error:
        reason = error.strerror or error
        raise CrowdError(
            f"The file of trajectories {where} cannot be read ({reason}): choose another."
        ) from None
    return check_rows(rows, path)


def _refuse_folder(path: Path) -> None:
    """Raise CrowdError if `path` is a folder, in which some programs keep a file for each agent."""
    if not path.is_dir():
        return
    names = sorted(file.name for file in path.iterdir() if file.is_file())
    holds = f" of {len(names):,} files, such as {names[0]}" if names else ""
    raise CrowdError(
        f"{printable(path)} is a folder{holds}: choose one file of all agents; join tables of one "
        f"agent each, with a column id, "
        "by pandas.concat(tables, keys=ids, names=['id']), say."
    )


def _text_of(path: Path, is_packed: bool) -> bytearray:
    """Return the text of the file in UTF-8. CrowdError if it is no text, too long or damaged."""
    where = printable(path)
    data = bytearray()
    try:
        with gzip.open(path) if is_packed else path.open("rb") as file:
            while part := file.read(CHUNK):
                data += part
                check_cancelled()
                if len(part) == CHUNK and b"\n" not in part and b"\r" not in part:
                    raise layout.long_line(where)
                if len(data) > MOST_BYTES:
                    raise CrowdError(
                        f"The file {where} has more than the {MOST_BYTES / 2**30:.1f} GiB that "
                        f"are read at once: "
                        "give fewer agents or frames, or write it as NPZ."
                    )
                if len(data) == len(part):
                    _check_kind(part, where)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise CrowdError(f"The file {where} cannot be unpacked ({error}): copy it again.") from None
    if not data:
        raise CrowdError(f"The file {where} is empty: choose a file of trajectories.")
    if data.startswith(UTF_16):
        try:
            return bytearray(data.decode("utf-16").encode())
        except UnicodeError as error:
            raise CrowdError(
                f"The file {where} is not the UTF-16 that its head tells ({error}): save it as "
                f"UTF-8."
            ) from None
    if data.startswith(UTF_8):
        del data[: len(UTF_8)]
    return data


def _check_kind(data: bytes, where: str) -> None:
    """Raise CrowdError if `data`, which begins a file, is of a known format that is not read."""
    head = data.removeprefix(UTF_8).lstrip()
    for magic, (kind, remedy) in OTHERS.items():
        if head.startswith(magic):
            raise CrowdError(f"The file {where} is {kind}, which is not read: {remedy}.")
    if not data.startswith(UTF_16) and b"\0" in data[:LOOK]:
        raise CrowdError(
            f"The file {where} is neither text nor NPZ nor a database: choose a file of "
            f"trajectories."
        )


def read_tracks(  # noqa: PLR0913 - what the reader of a file is told
    path: Path,
    unit: str = "",
    rate: float = 0.0,
    usual: float = 0.0,
    up: str = "Z",
    columns: str = "",
    tell: Callable[[float], None] = lambda _: None,
) -> Tracks:
    """Return the tracks of the file `path`.

    unit: one of rows.UNITS, whatever the file tells; "" for the file's own, or else meters.
    rate: frames of the file a second, whatever it tells; 0 for its own.
    usual: the rate if neither tells one, such as the scene's.
    up: the file's axes, as in Rows.with_z_up.
    columns: as in read_rows.
    tell: called with the progress, 0 to 1.
    CrowdError if it cannot be read or used.
    """
    rows = read_rows(path, columns, lambda part: tell(READ * part)).in_meters(unit)
    if up != "Z" and rows.z is None:
        raise CrowdError(
            f"The file {printable(path)} has no z, and y is up: set Up to Z, or give it columns "
            f"x, y and z."
        )
    rows = rows.with_z_up(up)
    notes = rows.notes
    if not rate and not rows.rate:
        if not usual:
            raise CrowdError(
                f"The file {printable(path)} tells no frame rate: set Frame Rate to its frames a "
                f"second."
            )
        notes += ("It tells no frame rate: each of its frames is one of the scene's.",)
    rows = replace(rows, rate=rate or rows.rate or usual, notes=notes)
    tell(READ)
    return tracks_of(_set_on_feet(rows), printable(path))


def _set_on_feet(rows: Rows) -> Rows:
    """Return `rows` with heights of feet.

    Those that PeTrack gives are of heads, and many files give zeros.
    """
    if rows.z is None or not rows.z.any():
        return replace(rows, z=None)
    low = float(rows.z.min())
    high = float(rows.z.max())
    if rows.heading is None and not rows.feet and HEADS[0] <= low and high <= HEADS[1]:
        note = (
            f"Its z of {low:.3g} to {high:.3g} m is taken for the height of heads: agents "
            f"stand at the height of Center."
        )
        return replace(rows, z=None, notes=(*rows.notes, note))
    return rows


def content_of(path: Path) -> bytes:
    """Return the digest of the file's content. OSError if it cannot be read, CrowdError if it is a
    folder.
    """
    _refuse_folder(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()
