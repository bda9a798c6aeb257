"""Variants of character groups: the same character with some of its props, without others."""

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
        return np.array([choices[0][0] for choices in self.variants], np.uint8)

    def draw_variants(self, group: np.ndarray, key: np.ndarray) -> np.ndarray:
        """Return the variant of each agent, (n,) uint8.

        group: (n,) uint8, the first variant of the agent's group; others stay.
        key: (n,) uint64, the agents' first keys. The answer depends on nothing else.
        """
        variant = group.copy()
        for choices in self.variants:
            if len(choices) > 1:
                indices, chances = zip(*choices, strict=True)
                agents = group == indices[0]
                until = np.cumsum(chances)
                draw = random_streams.uniform(key[agents], random_streams.PROPS)
                slot = np.searchsorted(until[:-1] / until[-1], draw, side="right")
                variant[agents] = np.array(indices, np.uint8)[slot]
        return variant
