"""Reads the channels of an OpenEXR file that is not compressed."""

import struct
from pathlib import Path

import numpy as np

MANY_PARTS = 0x1000  # a flag of the version
TYPES = ("<u4", "<f2", "<f4")


def channels_of(path: Path) -> dict[str, np.ndarray]:
    """Its channels by name, each (height, width) float32, the top row first."""
    data = path.read_bytes()
    many = bool(struct.unpack_from("<I", data, 4)[0] & MANY_PARTS)
    at = 8
    parts = []
    while data[at]:
        part, at = _header(data, at)
        parts.append(part)
        if not many:
            break
    at += many  # the end of the headers
    at += 8 * sum(height for height, _ in parts)  # where the lines are
    pictures = {}
    for _ in range(sum(height for height, _ in parts)):
        number = 0
        if many:
            (number,) = struct.unpack_from("<i", data, at)
            at += 4
        y, size = struct.unpack_from("<ii", data, at)
        at += 8
        height, channels = parts[number]
        place = at
        for name, kind, width in channels:
            row = np.frombuffer(data, kind, width, place)
            pictures.setdefault(name, np.zeros((height, width), np.float32))[y] = row
            place += row.nbytes
        at += size
    return pictures


def _header(data: bytes, at: int) -> tuple[tuple[int, list[tuple[str, str, int]]], int]:
    """((lines, [(name, type, width) of each channel]), where the header ends)."""
    values = {}
    while data[at]:
        name, kind = _texts(data, at, 2)
        at += len(name) + len(kind) + 2
        (size,) = struct.unpack_from("<i", data, at)
        values[name] = data[at + 4 : at + 4 + size]
        at += 4 + size
    assert values[b"compression"] == b"\0"
    left, top, right, bottom = struct.unpack("<4i", values[b"dataWindow"])
    channels = []
    listed = values[b"channels"]
    place = 0
    while listed[place]:
        (name,) = _texts(listed, place, 1)
        place += len(name) + 1
        (kind,) = struct.unpack_from("<i", listed, place)
        place += 16
        channels.append((name.decode(), TYPES[kind], right - left + 1))
    return (bottom - top + 1, channels), at + 1


def _texts(data: bytes, at: int, count: int) -> list[bytes]:
    """As many texts, each of which a zero ends."""
    texts = []
    for _ in range(count):
        end = data.index(b"\0", at)
        texts.append(data[at:end])
        at = end + 1
    return texts
