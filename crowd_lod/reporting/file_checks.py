"""Checks that a file is complete: on a full disk Blender reports no error.

It leaves a part of the file there.
"""

import mmap
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from ..errors import CrowdError
from ..format import printable

PNG = b"\x89PNG\r\n\x1a\n"
# a frame's first bytes; the last four of a file that can be sought in
ZSTD = b"\x28\xb5\x2f\xfd"
SEEK_TABLE = 0x8F92EAB1
MOST_KNOWN = 10_000  # files
_whole: set[tuple[int, int, int, int]] = set()  # device, inode, time and size of whole files
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # of a PNG's color types


def check(path: Path) -> None:
    """Raise CrowdError if the file is missing, empty or cut short.

    The end is checked of .png, .exr and .blend files, which takes 8 ms for a picture of 960 x 540
    pixels. So one that was whole, and was moved at most since, is not read again. OSError if the
    file cannot be read.
    """
    if not path.exists():
        raise CrowdError(
            f"Blender did not write {printable(path.name)}: see its own message above."
        )
    look = LOOKS.get(path.suffix, len)
    about = path.stat()
    stamp = about.st_dev, about.st_ino, about.st_mtime_ns, about.st_size
    if stamp in _whole:
        return
    size = about.st_size
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            whole = look(data)
    # it ends in the middle of what it says of itself
    except (LookupError, ValueError, struct.error, zlib.error):
        whole = False
    if not whole:
        raise CrowdError(
            f"The file {printable(path.name)} was not written to its end ({size:,} bytes are "
            f"there): free space on the "
            "disk, lift the limit on the size of files, or choose another folder."
        )
    if len(_whole) >= MOST_KNOWN:
        _whole.clear()
    _whole.add(stamp)


def _png(data: mmap.mmap) -> bool:
    chunks = list(_png_chunks(data))
    width, height, depth, color, _, _, interlaced = struct.unpack(">IIBBBBB", chunks[0][1])
    pixels = zlib.decompressobj()
    size = sum(len(pixels.decompress(body)) for kind, body in chunks if kind == b"IDAT")
    row = 1 + -(-width * depth * CHANNELS[color] // 8)  # a byte says how it is filtered
    return chunks[-1][0] == b"IEND" and pixels.eof and bool(interlaced or size == height * row)


def _png_chunks(data: mmap.mmap) -> Iterator[tuple[bytes, bytes]]:
    """Yield (kind, content) of each chunk; ValueError or struct.error if damaged."""
    at = len(PNG) if data[: len(PNG)] == PNG else len(data) + 1
    while at != len(data):
        (size,) = struct.unpack_from(">I", data, at)
        (code,) = struct.unpack_from(">I", data, at + 8 + size)
        if zlib.crc32(data[at + 4 : at + 8 + size]) != code:
            raise ValueError("The chunk is not what it was.")
        yield data[at + 4 : at + 8], data[at + 8 : at + 8 + size]
        at += 12 + size


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
    """Return whether the end block, or each compressed frame in the table, is there."""
    if data[: len(ZSTD)] != ZSTD:
        # bytes of a block's head, since Blender 5 and before
        block = 32 if data[7:9].isdigit() else 24
        return data[:7] == b"BLENDER" and data[-block:].startswith(b"ENDB")
    count, flags, magic = struct.unpack("<IBI", data[-9:])
    entry = 12 if flags & 0x80 else 8  # with a check sum or without
    if magic != SEEK_TABLE:
        return False
    sizes = [
        struct.unpack_from("<I", data, len(data) - 9 - entry * (count - k))[0] for k in range(count)
    ]
    return sum(sizes) + 8 + entry * count + 9 == len(data)


LOOKS = {".png": _png, ".exr": _exr, ".blend": _blend}


def sync(path: Path) -> None:
    """Flush the file to the disk. OSError if the disk fails."""
    opened = os.open(path, os.O_RDWR)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)
