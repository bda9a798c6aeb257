"""What was measured of the candidates for one character's LODs, and what is guessed from that."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.levels.selection import NEAR_ENOUGH, read_curve
from ...crowd_lod.simplification.decimate import LodMesh

# Of Group, a value a LOD
COLUMNS = {
    "vertices": int,
    "triangles": int,
    "deviations": float,
    "bounds": float,
    "rms": float,
    "worst": float,
    "shaded": float,
}
# Triangles x bound / diagonal, about the same for all LODs of a character (half the triangles,
# twice the bound), to guess by. The first is below most LODs': a candidate whose guess is too
# coarse would never be tried. The second is the middle.
USUALLY_LOST = 4.0
OFTEN_LOST = 12.0


class Measurements:
    """Values of a character's candidates, by their goals (see candidates.Ladder).

    Guesses come from those that were made here, whose goals are not negative.

    rows: goal -> a value for each of COLUMNS.
    diagonal: of the character, meters.
    """

    def __init__(self) -> None:
        self.rows: dict[float, tuple] = {}
        self.diagonal = 0.0

    def value(self, goal: float, kind: str) -> float:
        return self.rows[goal][list(COLUMNS).index(kind)]

    def columns(self, goals: Sequence[float]) -> dict:
        """Return the values of a Group for the candidates of `goals`, by name of the field."""
        rows = [self.rows[goal] for goal in goals]
        columns = dict(zip(COLUMNS, zip(*rows, strict=True), strict=True))
        return columns | {"diagonal": self.diagonal}

    def goal_near(self, length: float) -> float:
        """Return the goal of a candidate that deviates by about `length`, but no more.

        Of several the one with the fewest triangles; `length` itself if there is none.
        """
        if length in self.rows:
            return length
        near = [
            goal
            for goal in self.rows
            if goal >= 0 and NEAR_ENOUGH * length <= self.value(goal, "bounds") <= length
        ]
        return min(near, key=lambda goal: self.value(goal, "triangles"), default=length)

    def _deviating(self) -> list[float]:
        """Return the goals of the LODs made here that deviate, with fewer triangles than LOD 0."""
        made_here = [goal for goal in self.rows if goal >= 0 and self.value(goal, "bounds") > 0]
        most = max((self.value(goal, "triangles") for goal in self.rows if goal >= 0), default=0)
        return [goal for goal in made_here if self.value(goal, "triangles") < most]

    def _by_bound(self, kind: str) -> list[tuple[float, float]]:
        """Return the bound, and the value of `kind`, of each LOD that deviates."""
        return [(self.value(goal, "bounds"), self.value(goal, kind)) for goal in self._deviating()]

    def guess_triangles(self, lengths: Sequence[float], usual: float) -> list[int]:
        """Return about how many triangles a LOD has that deviates by each of `lengths`.

        usual: triangles x bound / diagonal, where no candidate was searched for.
        """
        most = int(self.value(0.0, "triangles"))
        # lengths too small for any LOD; where finer ones have one, the search itself has failed
        shortest = min(self._deviating(), default=np.inf)
        whole = [(goal, most) for goal in self.rows if 0 < goal < shortest]
        pairs = whole + self._by_bound("triangles") or [(usual * self.diagonal / most, most)]
        return read_curve(lengths, pairs, -1.0).round().astype(int).clip(1, most).tolist()

    def complete(self, group: Group, goals: Sequence[float], guesses: bool) -> Group:
        """Return the group with values of the candidates of `goals`.

        guesses: whether the values of those that were not measured are guessed, whose goals are
            lengths; else they are 0.
        """
        rows = [self.rows.get(goal, (0,) * len(COLUMNS)) for goal in goals]
        values = dict(zip(COLUMNS, map(list, zip(*rows, strict=True)), strict=True))
        missing = [k for k, goal in enumerate(goals) if goal not in self.rows]
        if guesses and missing:
            for name, column in self._guess([goals[k] for k in missing]).items():
                for k, value in zip(missing, column, strict=True):
                    values[name][k] = value
        columns = {name: tuple(column) for name, column in values.items()}
        return replace(group, diagonal=self.diagonal, **columns)

    def _guess(self, lengths: Sequence[float]) -> dict[str, Sequence]:
        """Guessed columns of LODs that deviate by `lengths`."""
        triangles = self.guess_triangles(lengths, USUALLY_LOST)
        corners = self.value(0.0, "vertices") / max(self.value(0.0, "triangles"), 1)
        guesses: dict[str, Sequence] = {
            "bounds": lengths,
            "triangles": triangles,
            "vertices": [round(corners * count) for count in triangles],
        }
        pairs = [pair for pair in self._by_bound("shaded") if 0 < pair[1] < np.inf]
        if pairs:
            guesses["shaded"] = read_curve(lengths, pairs, 1.0).tolist()
        return guesses


@dataclass(frozen=True)
class FoundObject:
    """An object of a LOD that a search has found, to be made again.

    ratio, shape: as make_object takes them; milliseconds: that decimation took.
    """

    ratio: float
    shape: LodMesh | None
    milliseconds: float


@dataclass(frozen=True)
class FoundLods:
    """What the search for a character's LODs has found: what a Ladder has under these names."""

    digest: str
    measured: Measurements
    found: dict[float, list[FoundObject]]
