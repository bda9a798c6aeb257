"""Writes PNG pictures."""

import struct
import zlib
from pathlib import Path

import numpy as np

from . import file_checks

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
    return file_checks.PNG_BEGINS + chunks


def save_png(path: Path, pixels: np.ndarray) -> None:
    """Write `png_of` the pixels, and check the file; OSError if there is no room for it."""
    path.write_bytes(png_of(pixels))
    file_checks.check(path)
