"""A frame of a small crowd."""

from . import shots
from .crowds import walker

GROUPS = walker(), walker(sizes=(500, 50, 5))


def shot(groups=GROUPS):
    return shots.shot(*shots.chapter(shots.AREA), groups, 3000, 2)
