"""Work in steps: generators that yield their progress, from 0 to 1, between the steps, and return what they made."""

from collections.abc import Generator, Iterator
from typing import Any


def finished(steps: Generator) -> Any:
    """What the generator returns, all its steps done at once."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def share(steps: Generator, begin: float, end: float) -> Iterator[float]:
    """The generator's progress as the part from `begin` to `end` of the whole; returns what it returns."""
    while True:
        try:
            progress = next(steps)
        except StopIteration as stop:
            return stop.value
        yield begin + (end - begin) * progress


def standing(steps: Generator, progress: float) -> Iterator[float]:
    """Yields `progress` at each of the generator's steps, whatever it yields; returns what it returns."""
    while True:
        try:
            next(steps)
        except StopIteration as stop:
            return stop.value
        yield progress
