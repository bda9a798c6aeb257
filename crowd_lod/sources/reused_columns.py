"""Columns that are made of other columns."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np


class ReusedColumns:
    """The latest columns of a crowd by name, each with the arrays that it was made of.

    A column is the same array while those arrays are the same: who looks at a crowd then sees at
    once that nothing has changed.
    """

    def __init__(self) -> None:
        self._columns: dict[str, tuple[Sequence[Any], np.ndarray]] = {}

    def of(self, name: str, parts: Sequence[Any], make: Callable[..., np.ndarray]) -> np.ndarray:
        """Return what `make` makes of the `parts`."""
        latest = self._columns.get(name)
        if latest is not None and all(a is b for a, b in zip(latest[0], parts, strict=True)):
            return latest[1]
        column = make(*parts)
        self._columns[name] = parts, column
        return column
