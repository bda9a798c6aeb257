"""Variants of character groups: the same character with some of its props and without the
others.
"""

from dataclasses import dataclass

import numpy as np

from . import random_streams


@dataclass(frozen=True)
class Draw:
    """How agents are drawn from character groups, and then from the variants of each.

    weights: of the groups, in proportion; or their number, if all are as likely.
    variants: of each group, (index, chance) of its variants. The first stands for the group.
    """

    weights: int | tuple[float, ...]
    variants: tuple[tuple[tuple[int, float], ...], ...]

    def __len__(self) -> int:
        return len(self.variants)

    @property
    def groups(self) -> np.ndarray:
        """The index of each group's first variant, (g,) uint8, increasing."""
        return np.array([own[0][0] for own in self.variants], np.uint8)

    def dressed(self, group: np.ndarray, key: np.ndarray) -> np.ndarray:
        """Return the variant of each agent, (n,) uint8.

        group: (n,) uint8, the first variant of the agent's group; others stay.
        key: (n,) uint64, the agents' first keys. The answer depends on nothing else.
        """
        found = group.copy()
        for own in self.variants:
            if len(own) > 1:
                who = group == own[0][0]
                indices, chances = zip(*own, strict=True)
                upto = np.cumsum(chances)
                drawn = random_streams.uniform(key[who], random_streams.PROPS)
                found[who] = np.array(indices, np.uint8)[
                    np.searchsorted(upto[:-1] / upto[-1], drawn, side="right")
                ]
        return found
