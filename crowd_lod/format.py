"""Numbers and paths as text, for sentences and tables."""

import os


def number(value: float | None) -> str:
    """Return `value` with three significant digits; "-" for None.

    From 1000 on, all digits before the decimal point are written, with thousands separators.
    """
    return "-" if value is None else f"{value:,.0f}" if abs(value) >= 999.5 else f"{value:.3g}"


def printable(path: str | os.PathLike) -> str:
    """Return the path as text for files and messages.

    A byte that the system's encoding does not know is written as \\udce9.
    """
    return os.fspath(path).encode("utf-8", "backslashreplace").decode()
