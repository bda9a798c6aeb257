"""How figures read in sentences and tables."""

import os


def number(value: float | None) -> str:
    """Three figures, and all of those before the point; "-" for None."""
    return "-" if value is None else f"{value:,.0f}" if abs(value) >= 999.5 else f"{value:.3g}"


def printable(path: str | os.PathLike) -> str:
    """The path as text for files and messages: a byte that the system's encoding does not know is written as \\udce9."""
    return os.fspath(path).encode("utf-8", "backslashreplace").decode()
