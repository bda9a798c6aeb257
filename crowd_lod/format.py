"""Numbers and paths as text, for sentences and tables."""

import os
from collections.abc import Sequence


def number(value: float | None) -> str:
    """Return `value` with three significant digits; "-" for None.

    From 1000 on, all digits before the decimal point are written, with thousands separators.
    """
    if value is None:
        return "-"
    if abs(value) >= 999.5:
        return f"{value:,.0f}"
    return f"{value:.3g}"


def byte_size(size: float) -> str:
    """Return the number of bytes as text of three digits: "724 kB", "12.9 MB", "1.2 GB"."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6)):
        if size >= 0.9995 * factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size / 1e3:.3g} kB"


def counted(count: int, singular: str, plural: str = "") -> str:
    """Return the count with what is counted: "1 frame is", "2,000 frames are".

    singular, plural: words for one and for several; if `plural` is empty, `singular` with an s.
    """
    return f"{count:,} {singular if count == 1 else plural or singular + 's'}"


def printable(path: str | os.PathLike) -> str:
    """Return the path as text for files and messages.

    A byte that the system's encoding does not know is written as \\udce9.
    """
    return os.fspath(path).encode("utf-8", "backslashreplace").decode()


def aligned(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return a table's lines, spaces between columns: the first column is set left, all others
    right.
    """
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    lines = []
    for first, *rest in (head, *rows):
        cells = [
            first.ljust(widths[0]),
            *(cell.rjust(width) for cell, width in zip(rest, widths[1:], strict=True)),
        ]
        lines.append("  ".join(cells).rstrip())
    return lines
