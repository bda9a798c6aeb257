"""Checks that a file is complete, and PNG pictures.

On a full disk Blender reports no error, and leaves a part of the file there.
"""

import mmap
import os
import struct
import zlib
from pathlib import Path

import numpy as np

from ..errors import CrowdError
from ..format import printable

PNG_BEGINS = b"\x89PNG\r\n\x1a\n"
PNG_ENDS = b"\0\0\0\0IEND\xae\x42\x60\x82"
# of a compressed .blend file: a frame's first bytes, and the last of the table of frames
ZSTD_BEGINS = b"\x28\xb5\x2f\xfd"
ZSTD_ENDS = b"\xb1\xea\x92\x8f"


def check(path: Path) -> None:
    """Raise CrowdError if the file is missing, empty or cut short.

    The end is checked of .png, .exr and .blend files. OSError if the file cannot be read.
    """
    if not path.exists():
        raise CrowdError(
            f"Blender did not write {printable(path.name)}: see its own message above."
        )
    look = LOOKS.get(path.suffix, len)
    size = path.stat().st_size
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            whole = look(data)
    # it ends in the middle of what it says of itself
    except (LookupError, ValueError, struct.error):
        whole = False
    if not whole:
        raise CrowdError(
            f"The file {printable(path.name)} was not written to its end ({size:,} bytes are "
            f"there): free space on the "
            "disk, lift the limit on the size of files, or choose another folder."
        )


def _png(data: mmap.mmap) -> bool:
    return data[: len(PNG_BEGINS)] == PNG_BEGINS and data[-len(PNG_ENDS) :] == PNG_ENDS


def _exr(data: mmap.mmap) -> bool:
    """Return whether the offset table is filled and each block is there.

    For files of one part in blocks of rows, as Blender writes them.
    """
    file = bytes(data)
    at = 8
    while file[at]:  # an attribute: name, 0, type, 0, size, content
        at = file.index(0, file.index(0, at) + 1) + 1
        at += 4 + struct.unpack_from("<I", file, at)[0]
    (first,) = struct.unpack_from("<Q", file, at + 1)
    offsets = struct.unpack_from(f"<{(first - at - 1) // 8}Q", file, at + 1) if first > at else (0,)
    ends = [offset + 8 + struct.unpack_from("<I", file, offset + 4)[0] for offset in offsets]
    return min(offsets) > 0 and max(ends) == len(file)


def _blend(data: mmap.mmap) -> bool:
    """Return whether the end block, or the table of compressed frames, is there."""
    if data[: len(ZSTD_BEGINS)] == ZSTD_BEGINS:
        return data[-len(ZSTD_ENDS) :] == ZSTD_ENDS
    # bytes of a block's head, since Blender 5 and before
    block = 32 if data[7:9].isdigit() else 24
    return data[:7] == b"BLENDER" and data[-block:].startswith(b"ENDB")


LOOKS = {".png": _png, ".exr": _exr, ".blend": _blend}


def sync(path: Path) -> None:
    """Flush the file to the disk. OSError if the disk fails."""
    opened = os.open(path, os.O_RDWR)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


COLOR_TYPES = {3: 2, 4: 6}  # by the number of channels: RGB, RGBA


def png_of(pixels: np.ndarray) -> bytes:
    """Return a PNG with exactly these values, which are sRGB.

    pixels: (rows, columns, 3 or 4) uint8, bottom row first.
    """
    rows, columns, channels = pixels.shape
    lines = np.zeros((rows, 1 + channels * columns), np.uint8)  # each begins with its filter: none
    lines[:, 1:] = pixels[::-1].reshape(rows, -1)
    head = struct.pack(">IIBBBBB", columns, rows, 8, COLOR_TYPES[channels], 0, 0, 0)
    parts = (b"IHDR", head), (b"IDAT", zlib.compress(lines)), (b"IEND", b"")
    chunks = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )
    return PNG_BEGINS + chunks


def save_png(path: Path, pixels: np.ndarray) -> None:
    """Write `png_of` the pixels, and check the file; OSError if there is no room for it."""
    path.write_bytes(png_of(pixels))
    check(path)
