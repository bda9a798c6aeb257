"""Candidates for the LODs of one character: made, measured, and recognized later.

They are reused as long as nothing that they depend on changes.
"""

from collections.abc import Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import bpy
import numpy as np
from idprop.types import IDPropertyGroup

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.crowd.bounding_spheres import cover_sizes
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.levels.lengths import (
    DARKER,
    MOST_LENGTHS,
    NEAR_ENOUGH,
    allowed_lengths,
    in_gaps,
    read_curve,
)
from ...crowd_lod.levels.selection import View
from ...crowd_lod.progress import share, standing
from ..blender import stored_values
from ..blender.material_colors import Looks
from ..blender.ownership import OWNED
from ..blender.performance import digest as digest_of
from ..blender.provenance import text_digest
from ..characters.character_extent import displaced
from ..characters.given_lods import GivenLod
from ..machine.scene_world import actions_named
from . import source_mesh as sources
from .deviation import Measure, compare
from .given_objects import copy_given, read_given
from .level_objects import AS_MADE, WAY, WHY, discard, hash_made, make_object, share_object
from .pose_deformation import skin_of
from .search import Search

# Custom properties of a LOD's collection of one character group: the hash of what it was made from,
# which candidate it is, and how many objects it has; of the finest, what was measured of those that
# were made.
DIGEST = "crowd_lod_digest"
CANDIDATE = "crowd_lod_candidate"
SIZE = "crowd_lod_size"
MEASURED = "crowd_lod_measured"
# Of Group, a value a LOD
COLUMNS = {
    "vertices": int,
    "triangles": int,
    "deviations": float,
    "bounds": float,
    "rms": float,
    "worst": float,
}
# of what was measured: where the group stands, by how much materials displace it, its lowest point,
# center, radius
REACH = "reach"
# Modifiers whose settings say all that they do; of others, such as physics, groups are measured
# again.
PLAIN = {
    "ARMATURE",
    "BEVEL",
    "DECIMATE",
    "EDGE_SPLIT",
    "MIRROR",
    "SOLIDIFY",
    "SUBSURF",
    "TRIANGULATE",
    "WEIGHTED_NORMAL",
    "WELD",
}
# see Ladder.lost: less than most LODs do, for what is guessed to deviate too much is never tried
USUALLY_LOST = 4.0
OFTEN_LOST = 12.0  # the same in the middle
MOST_GOALS = 100  # that measurements are kept of
LEAST_TRIANGLES = 300  # of a character: one of fewer needs no LOD, and is not worth a search
FOLLOWING = 0.5  # of a given LOD's triangles, by ratio: what the LOD after it has at most
DIGITS = 12  # of a hash, which a goal can hold
VERSION = 26  # of the code that makes LOD meshes: another one makes them anew


def _untouched(home: bpy.types.Collection) -> bool:
    """Return whether `home` still has all objects that were made in it, unedited."""
    objects = [item for item in home.objects if item.get(OWNED)]
    return len(objects) == home[SIZE] and all(
        item.get(AS_MADE) == hash_made(item) for item in objects
    )


class Ladder:
    """The candidates for the LODs of one character group, one for each of `goals`.

    A goal is the part of the triangles that a candidate keeps; by tolerance the length in meters by
    which it may deviate, 0 of the character itself. That of a LOD that was given is negative, and
    changes with the LOD.

    Order of calls:
    read() reads the source meshes and sets `digest`, a hash of everything that candidates depend
        on.
    recall() takes over measurements from an earlier run with the same digest.
    aim() sets the goals by tolerance.
    measure() makes one candidate and measures it.
    find() takes over collections of an earlier run, except those `taken` by another group.
    make() makes a candidate that is measured but not found.
    settle() keeps only the chosen collections, and removes the rest and the source meshes.

    read(), make() and measure() yield their progress.

    place: four numbers given: the origin x, y, z in world meters, and 1 if the group stands on its
        lowest point, else 0. Kept with the displacement of each object added.
    rows: measurements by goal, a value for each of `kinds`.
    reach: the group's lowest point, center and radius in meters, or None.
    found: collections by goal; made: those of them that are new.
    given: LODs that artists made, by goal; counts: their vertices and triangles.
    """

    def __init__(
        self,
        name: str,
        objects: list[bpy.types.Object],
        ratios: list[float],
        settings,
        place: Sequence[float],
        given: Sequence[GivenLod] = (),
    ):
        actions = actions_named(settings.id_data, name)
        self.name = name
        self.objects = objects
        self.method = settings.method
        self.searched = settings.choice == "BY_TOLERANCE"
        self.goals = [0.0] if self.searched else ratios
        self.looks = Looks() if self.searched and settings.shading_counts else None
        self.kinds = dict(COLUMNS) | ({"shaded": float} if self.looks else {})
        self.place = [*place, *map(displaced, objects)]
        self.reach: tuple[float, float, float] | None = None
        self.sources: list[sources.Source] = []
        self.rows: dict[float, tuple] = {}
        self.found: dict[float, bpy.types.Collection] = {}
        self.made: dict[float, bpy.types.Collection] = {}
        self.by = Measure(name, objects, actions, settings.hidden_surface_counts)
        self.artists = given
        self.given: dict[float, GivenLod] = {}
        self.counts: dict[float, tuple[int, int]] = {}
        self.diagonal = 0.0
        self.search: Search | None = None

    def read(self) -> Iterator[float]:
        digests = []
        for number, item in enumerate(self.objects):
            source = sources.read_source(item)
            self.sources.append(source)
            digests.append(sources.object_digest(item, source))
            yield (number + 1) / len(self.objects)
        if not any(source.mesh for source in self.sources):
            raise CrowdError(
                f"The character group {self.name} has no faces, modifiers applied: give it a "
                f"mesh, or take it out."
            )
        named = digest_of(self.by.performance.parts)
        self.digest = text_digest(
            digests,
            self.goals,
            self.method,
            VERSION,
            *["shading"] * bool(self.looks),
            *named,
            self.by.hidden_counts,
        )
        shown = [source for source in self.sources if source.mesh]
        triangles = [len(source.mesh.loops) - 2 * len(source.mesh.polygons) for source in shown]
        for source, own in zip(shown, triangles, strict=True):
            source.share = own / sum(triangles)
        self._read_given(sum(triangles))

    def _read_given(self, whole: int) -> None:
        """Read the LODs that were given. By ratio they come first.

        whole: triangles of the character. The ratios of others are lowered to follow them.
        """
        if len(self.artists) > MOST_LENGTHS:
            raise CrowdError(
                f"The character group {self.name} has {len(self.artists)} LODs of its own: use at "
                f"most {MOST_LENGTHS}."
            )
        for lod in self.artists:
            made_of, counts = read_given(lod)
            goal = -float(1 + int(text_digest([made_of])[:DIGITS], 16))
            self.given[goal] = lod
            self.counts[goal] = counts
        if self.searched:
            self.goals += self.given
            return
        for k, goal in enumerate(self.goals[1:], start=1):
            if k <= len(self.given):
                self.goals[k] = list(self.given)[k - 1]
                part = self.counts[self.goals[k]][1] / whole
            elif self.given:
                part = min(goal, FOLLOWING * part)
                self.goals[k] = part

    def recall(self, earlier: bpy.types.Collection | None) -> None:
        for home in self._homes(earlier):
            if isinstance(home.get(MEASURED), IDPropertyGroup):
                with suppress(CrowdError):  # what is spoilt is made and measured anew
                    self._remember(home[MEASURED])

    def aim(self, group: Group, views: Sequence[View], tolerance: float, higher: bool) -> None:
        """Set as goals the lengths that the agents seen in `views` allow.

        tolerance: pixels. higher: whether also those that a higher tolerance allows. A goal of
        before that fits about as well stands for a length.
        """
        size = group.scale[1]
        finest = self.diagonal / self._value(0.0, "triangles")
        few = self._value(0.0, "triangles") < LEAST_TRIANGLES
        lengths = (
            []
            if few
            else allowed_lengths(
                views,
                cover_sizes(group).radius,
                tolerance / size,
                finest,
                higher,
                DARKER if self.looks else 1.0,
            )
        )
        deviates = {goal: self._value(goal, "bounds") for goal in self.given}
        gaps = in_gaps(lengths, list(deviates.values()))
        goals = [*(self._known_goal(length) for length in gaps), *self.given]
        self.goals = [0.0, *sorted(goals, key=lambda goal: deviates.get(goal, goal))]

    def _known_goal(self, length: float) -> float:
        """Return the goal of a measured LOD that deviates by about `length`, but no more; `length`
        if there is none.
        """
        near = [
            goal
            for goal in self._made_goals()
            if NEAR_ENOUGH * length <= self._value(goal, "bounds") <= length
        ]
        return (
            length
            if length in self.rows or not near
            else min(near, key=lambda goal: self._value(goal, "triangles"))
        )

    def _made_goals(self) -> list[float]:
        """Return the goals of all that was measured but for LODs that were given."""
        return [goal for goal in self.rows if goal >= 0]

    def _value(self, goal: float, kind: str) -> float:
        return self.rows[goal][list(self.kinds).index(kind)]

    def find(self, earlier: bpy.types.Collection | None, taken: set[bpy.types.Collection]) -> None:
        for home in self._homes(earlier) if self.rows else ():
            with suppress(CrowdError):
                goal = stored_values.read(home, CANDIDATE, float, "")
                if goal not in self.found and home not in taken and _untouched(home):
                    self.found[goal] = home

    def held(self, earlier: bpy.types.Collection | None, goals: Sequence[float]) -> bool:
        """Return whether `earlier` has a collection of one of the `goals`."""
        return any(home.get(CANDIDATE) in goals for home in self._homes(earlier))

    def _homes(self, earlier: bpy.types.Collection | None) -> list[bpy.types.Collection]:
        levels = earlier.children if earlier is not None else ()
        return [
            home for level in levels for home in level.children if home.get(DIGEST) == self.digest
        ]

    def _remember(self, found: IDPropertyGroup) -> None:
        goals = stored_values.read(found, CANDIDATE, float, "", range(1, MOST_GOALS + 1))
        columns = [
            stored_values.read(found, *column, "", (len(goals),)) for column in self.kinds.items()
        ]
        self.diagonal = stored_values.read(found, "diagonal", float, "")
        self.rows = (
            dict(zip(goals, zip(*columns, strict=True), strict=True))
            if self.goals[0] in goals
            else {}
        )
        reach = stored_values.read(found, REACH, float, "", (len(self.place) + 3,))
        plain = all(
            item.type == "MESH" and PLAIN.issuperset(m.type for m in item.modifiers)
            for item in self.objects
        )
        self.reach = tuple(reach[-3:]) if plain and reach[:-3] == self.place else None

    def make(self, goal: float) -> Iterator[float]:
        """Make the LOD for `goal`; by tolerance also measure it."""
        if self.searched and goal > 0:
            yield from self.measure(goal)
        else:
            yield from self._make(goal)

    def measure(self, goal: float) -> Iterator[float]:
        if self.searched and goal > 0:
            yield from self._seek(goal)
        elif goal in self.given:
            yield from self._measure_given(goal)
        else:
            counts = yield from share(self._make(goal), 0.0, 0.7)
            k = self.goals.index(goal)
            steps = self.by.level(list(self.found[goal].objects), k)
            if self._is_whole(goal) and all(source.item.type == "MESH" for source in self.sources):
                steps = self.by.whole()
            measured = yield from share(steps, 0.7, 1.0)
            self._note(goal, counts, measured)

    def _measure_given(self, goal: float) -> Iterator[float]:
        """Measure a LOD that was given, by tolerance in further frames as well."""
        counts = yield from self._make(goal)
        level = list(self.found[goal].objects)
        measured = yield from share(self.by.level(level, self.goals.index(goal)), 0.0, 0.7)
        if self.searched:
            (measured,) = yield from share(self.by.look_between([level], [measured]), 0.7, 1.0)
        self._note(goal, counts, measured)

    def _make(self, goal: float) -> Generator[float, None, tuple[int, int]]:
        """Make the LOD that keeps the part `goal` of the triangles, or the copy of one that was
        given; return its (vertices, triangles).
        """
        if goal in self.given:
            lod = self.given[goal]
            self._keep(goal, lod.objects, copy_given(self.name, lod, self.objects))
            return self.counts[goal]
        yield from self._read_skins()
        whole = self._is_whole(goal)
        made = []
        for number, source in enumerate(self.sources):
            if whole and source.item.type == "MESH":
                made.append(share_object(source))
            else:
                made.append(
                    (
                        yield from standing(
                            make_object(source, goal or 1.0, self.method),
                            number / len(self.sources),
                        )
                    )
                )
        self._keep(goal, self.objects, [item for item, _, _ in made])
        return sum(each[1] for each in made), sum(each[2] for each in made)

    def _is_whole(self, goal: float) -> bool:
        """Return whether the candidate is the character itself."""
        return goal == self.goals[0] and goal in (0.0, 1.0)

    def _read_skins(self) -> Iterator[float]:
        if self.made.keys() <= self.given.keys():
            for source in self.sources:
                yield from standing(skin_of(source, self.by.own_frames), 0.0)

    def _seek(self, length: float) -> Iterator[float]:
        """Search for the LOD that deviates by `length` at most."""
        if self.search is None:
            yield from self._read_skins()
            self.search = Search(self.sources, self.method, make_object, self.by)
        whole = self._value(0.0, "triangles")
        tries, measured = yield from self.search.find(
            length, self._guess_triangles([length], OFTEN_LOST)[0] / whole
        )
        for attempt, source in zip(tries, self.sources, strict=True):
            if WHY in attempt.item and 0.0 < attempt.ratio < 1.0:
                name = "Pose-Aware" if attempt.method == "POSE_AWARE" else "Decimate Modifier"
                reason = (
                    f"{name}: the fewest triangles of those tried that deviate no more than "
                    f"agents allow."
                )
                attempt.item[WHY] = " ".join([reason, *source.notes])
        self._keep(length, self.objects, [attempt.item for attempt in tries])
        self._note(
            length,
            (
                sum(attempt.vertices for attempt in tries),
                sum(attempt.triangles for attempt in tries),
            ),
            measured,
        )

    def _keep(
        self,
        goal: float,
        originals: Sequence[bpy.types.Object],
        items: Sequence[bpy.types.Object],
    ) -> None:
        """Put a LOD's objects, made of the `originals`, into a collection of their own."""
        k = self.goals.index(goal)
        home = bpy.data.collections.new(f"{self.name} LOD {k}")
        for original, item in zip(originals, items, strict=True):
            home.objects.link(item)
            item.name = f"{original.name} LOD {k}"
            if WAY in item:
                item.data.name = item.name
        home[DIGEST] = self.digest
        home[CANDIDATE] = goal
        home[SIZE] = len(items)
        self.found[goal] = self.made[goal] = home

    def _note(
        self, goal: float, counts: tuple[int, int], measured: tuple[float, float, float, float]
    ) -> None:
        """Note what was measured of the LOD for `goal`."""
        self.diagonal = self.by.diagonal
        self.rows[goal] = *counts, *measured
        if self.looks:
            at = (self.by.performance, measured[-1])
            level = list(self.found[goal].objects)
            self.rows[goal] += (
                compare(self.objects, level, at, self.diagonal, self.looks) if goal else 0.0,
            )

    def look_between(self, goals: Sequence[float]) -> Iterator[float]:
        """Look at LODs that were made anew in further frames, which may raise their bounds.

        A search has done so.
        """
        if self.searched:
            return
        new = [goal for goal in goals if goal in self.made]
        levels = [list(self.found[goal].objects) for goal in new]
        measured = yield from self.by.look_between(levels, [self.rows[goal][2:6] for goal in new])
        for goal, row in zip(new, measured, strict=True):
            self.rows[goal] = *self.rows[goal][:2], *row, *self.rows[goal][6:]

    def columns(self, goals: Sequence[float]) -> dict:
        """Return the values of a Group for the candidates of `goals`, by name of the field."""
        return dict(
            zip(self.kinds, zip(*(self.rows[goal] for goal in goals), strict=True), strict=True)
        ) | {"diagonal": self.diagonal}

    def lost(self) -> list[float]:
        """Return triangles x bound / diagonal of measured candidates but the first.

        Candidates without deviation are left out.
        """
        pairs = [
            (self._value(goal, "triangles"), self._value(goal, "bounds"))
            for goal in self._made_goals()
        ]
        return [triangles * bound / self.diagonal for triangles, bound in pairs if bound > 0]

    def guess(self, group: Group, usual: Sequence[float]) -> Group:
        """Return the group with measured or guessed values of all candidates.

        usual: values of `lost` of all characters, used where this character has no measurement.
        """
        rows = [self.rows.get(goal, (0,) * len(self.kinds)) for goal in self.goals]
        values = dict(zip(self.kinds, map(list, zip(*rows, strict=True)), strict=True))
        # by ratio all are made, whatever they deviate by
        missing = [
            k for k, goal in enumerate(self.goals) if goal not in self.rows and self.searched
        ]
        lengths = [self.goals[k] for k in missing]
        guessed = {
            "bounds": lengths,
            "triangles": missing
            and self._guess_triangles(lengths, min(usual, default=USUALLY_LOST)),
        }
        if self.looks:
            known = [
                (self._value(goal, "bounds"), self._value(goal, "shaded"))
                for goal in self._made_goals()
            ]
            known = [
                (bound, shaded) for bound, shaded in known if 0 < shaded < np.inf and bound > 0
            ]
            guessed["shaded"] = (
                read_curve(lengths, known, 1.0).tolist() if known else [0.0] * len(lengths)
            )
        for name, own in guessed.items():
            for k, value in zip(missing, own, strict=True):
                values[name][k] = value
        return replace(
            group,
            diagonal=self.diagonal,
            **{name: tuple(column) for name, column in values.items()},
        )

    def _guess_triangles(self, lengths: Sequence[float], usual: float) -> list[int]:
        """Return about how many triangles a LOD has that deviates by each of `lengths`."""
        whole = int(self._value(0.0, "triangles"))
        known = [
            (self._value(goal, "bounds"), self._value(goal, "triangles"))
            for goal in self._made_goals()
        ]
        known = [pair for pair in known if pair[0] > 0] or [(usual * self.diagonal / whole, whole)]
        return read_curve(lengths, known, -1.0).round().astype(int).clip(1, whole).tolist()

    def settle(self, chosen: list[bpy.types.Collection]) -> None:
        goals = (
            list(self.rows)[-MOST_GOALS:]
            if len(self.rows) <= MOST_GOALS
            else [self.goals[0], *list(self.rows)[1 - MOST_GOALS :]]
        )
        chosen[0][MEASURED] = {
            CANDIDATE: goals,
            REACH: [*self.place, *self.reach],
            **self.columns(goals),
        }
        bpy.data.batch_remove([source.mesh for source in self.sources if source.mesh])
        doomed = [home for home in self.made.values() if home not in chosen]
        discard([item for home in doomed for item in home.objects])
        bpy.data.batch_remove(doomed)
        for item in (
            item for home in self.made.values() if home in chosen for item in home.objects
        ):
            item[AS_MADE] = hash_made(item)
