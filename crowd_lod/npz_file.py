"""Reads arrays from NumPy's NPZ files, which may be spoilt in any way."""

import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .errors import CrowdError
from .format import printable

MOST_BYTES = 2 << 30  # of all arrays that are read at once, decompressed


def read_arrays(
    path: Path,
    required: Sequence[str],
    optional: Sequence[str] = (),
    subject: str = "The file",
    remedy: str = "write it again with numpy.savez, without objects",
    most_bytes: int = MOST_BYTES,
) -> dict[str, np.ndarray]:
    """Return arrays of the NPZ file `path` by name, of any shape and dtype but objects.

    required, optional: names of the arrays to read.
    subject, remedy: the beginning and the end of the sentence that tells what is wrong.
    most_bytes: that all these arrays may have together.

    CrowdError if the file is no NPZ, is damaged, lacks a required array, or holds more bytes.
    OSError if it cannot be opened.
    """
    where = f"{subject} {printable(path)}"
    with path.open("rb") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
                present = [
                    name for name in dict.fromkeys((*required, *optional)) if name in members
                ]
                size = sum(members[name].file_size for name in present)
                lacking = [name for name in required if name not in members]
                if not lacking and size <= most_bytes:
                    return {name: _read_array(archive, members[name]) for name in present}
        # zlib, lzma, bz2, zipfile and NumPy's header each raise what they like for a damaged file
        except Exception as error:
            reason = str(error) or type(error).__name__
            raise CrowdError(f"{where} cannot be read ({reason}): {remedy}.") from None
    if lacking:
        raise CrowdError(f"{where} lacks {', '.join(lacking)}: {remedy}.")
    raise CrowdError(
        f"{where} unpacks to {size / 2**30:.1f} GiB, more than the {most_bytes / 2**30:.1f} GiB "
        f"that are read at once: {remedy}."
    )


def read_checksums(path: Path) -> dict[str, int]:
    """Return the checksum of each array of the NPZ file `path` by name, as its directory has them.

    They are of the arrays alone, whenever the file was written. What is no zip file has none.

    OSError if it cannot be opened.
    """
    with path.open("rb") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                return {info.filename.removesuffix(".npy"): info.CRC for info in archive.infolist()}
        except Exception:  # a damaged directory raises whatever it likes
            return {}


def _read_array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(info) as member:
        array = np.lib.format.read_array(member, allow_pickle=False)
        if member.read(1):  # the last read also compares the checksum
            raise ValueError(f"{info.filename} has more bytes than its array")
    return array
