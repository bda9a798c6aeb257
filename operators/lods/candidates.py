"""Candidates for the LODs of one character: made, measured, and recognized later.

They are reused as long as nothing that they depend on changes.
"""

from collections.abc import Generator, Iterator, Sequence
from contextlib import suppress

import bpy
from idprop.types import IDPropertyGroup

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.crowd.bounds import cover_sizes
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.levels.selection import MOST_LENGTHS, View, allowed_lengths, in_gaps
from ...crowd_lod.progress import Workload
from ..blender import removal, stored_values
from ..blender.colors import Looks
from ..blender.mesh_data import count_triangles
from ..blender.ownership import OWNED
from ..blender.performance import digest as digest_of
from ..blender.provenance import text_digest
from ..scene.characters.character_extent import displaced
from ..scene.characters.given_lods import GivenLod
from ..scene.machine.scene_world import actions_named
from . import source_mesh as sources
from .costs import LodCosts
from .deviation import Measure, compare
from .level_objects import (
    AS_MADE,
    MILLISECONDS,
    UNMEASURED_LEAST,
    WAY,
    WHY,
    copy_given,
    discard,
    hash_made,
    make_object,
    read_given,
    share_object,
)
from .measurements import COLUMNS, OFTEN_LOST, FoundLods, FoundObject, Measurements
from .poses import skin_of
from .search import Search
from .shaded_pictures import is_painted

# Custom properties of the collection of one character group in a LOD: the hash of what it was made
# from, which candidate it is, and how many objects it has. That of the finest LOD also has what was
# measured of all candidates that were made.
DIGEST = "crowd_lod_digest"
CANDIDATE = "crowd_lod_candidate"
SIZE = "crowd_lod_size"
MEASURED = "crowd_lod_measured"
# Key of the measurements: where the group stands, by how much materials displace it, its lowest
# point, center, radius.
REACH = "reach"
# Modifiers that do nothing but what their settings say. Groups with others, such as physics, are
# measured again.
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
MOST_GOALS = 100  # whose measurements are kept
LEAST_TRIANGLES = 300  # a character of fewer needs no LOD, and is not worth a search
FOLLOWING = 0.5  # by distance, the LOD after a given one has at most this part of its triangles
# times its length that a LOD may deviate between the poses: it begins a little farther away then
BEYOND = 1.15
DIGITS = 12  # of a hash: as many as a goal can hold
VERSION = 35  # of the code that makes LOD meshes: with another one they are made anew


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
    recall() takes over measurements from an earlier run with the same digest; take_over() those of
        a search of the same in another process.
    aim() sets the goals by tolerance.
    measure() makes one candidate and measures it.
    find() takes over collections of an earlier run, except those `used` by another group.
    make() makes a candidate that is measured but not found.
    settle() keeps only the chosen collections, and removes the rest and the source meshes.

    read(), make() and measure() yield their progress.

    place: four numbers given: the origin x, y, z in world meters, and 1 if the group stands on its
        lowest point, else 0. Kept with the displacement of each object added.
    measured: what is known of the candidates, by goal.
    reach: the group's lowest point, center, radius and girth in meters, or None.
    homes: goal -> the collection of that candidate's objects; new_homes: those of them that were
        made now.
    given: LODs that artists made, by goal; counts: their vertices and triangles.
    found: what was searched for, by goal.
    looked: goals of LODs that were looked at between the poses; again: those then sought anew.
    costs: of the work on it.
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
        self.searched = settings.choice == "BY_TOLERANCE"
        self.goals = [0.0] if self.searched else ratios
        self.looks = Looks() if self.searched and is_painted(objects) else None
        self.measured = Measurements()
        self.place = [*place, *map(displaced, objects)]
        self.reach: tuple[float, float, float, float] | None = None
        self.sources: list[sources.Source] = []
        self.homes: dict[float, bpy.types.Collection] = {}
        self.new_homes: dict[float, bpy.types.Collection] = {}
        self.judge = Measure(name, objects, actions)
        self.artists = given
        self.given: dict[float, GivenLod] = {}
        self.counts: dict[float, tuple[int, int]] = {}
        self.found: dict[float, list[FoundObject]] = {}
        self.looked: set[float] = set()
        self.again: set[float] = set()
        self.is_skinned = False  # whether skins were read
        self.search: Search | None = None
        self.costs = LodCosts()

    def read(self) -> Iterator[float]:
        digests = []
        work = Workload(2 * len(self.objects))
        for item in self.objects:
            source = sources.read_source(item)
            self.sources.append(source)
            yield work.did(1)
            if source.mesh:
                source.weights = yield from work.take(sources.reading_weights(source.mesh))
            digests.append(sources.object_digest(item, source))
            yield work.did(1)
        if not any(source.mesh for source in self.sources):
            raise CrowdError(
                f"The character group {self.name} has no faces, modifiers applied: give it a "
                f"mesh, or take it out."
            )
        actions = digest_of(self.judge.performance.parts)
        self.digest = text_digest(digests, self.goals, VERSION, *actions)
        meshes = [source for source in self.sources if source.mesh]
        triangles = [count_triangles(source.mesh) for source in meshes]
        for source, count in zip(meshes, triangles, strict=True):
            source.share = count / sum(triangles)
        self.costs = LodCosts(sum(triangles), self.searched, len(self.goals))
        self._read_given(sum(triangles))

    def _read_given(self, triangles: int) -> None:
        """Read the LODs that were given. By distance they come first.

        triangles: of the character. The ratios of others are lowered to follow them.
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
                part = self.counts[self.goals[k]][1] / triangles
            elif self.given:
                part = min(goal, FOLLOWING * part)
                self.goals[k] = part

    def recall(self, earlier: bpy.types.Collection | None) -> None:
        for home in self._earlier_homes(earlier):
            if isinstance(home.get(MEASURED), IDPropertyGroup):
                with suppress(CrowdError):  # spoilt measurements are made anew
                    self._remember(home[MEASURED])

    def take_over(self, lods: FoundLods) -> None:
        """Take over what another process has found, unless it is of another character by now."""
        if lods.digest == self.digest:
            self.measured = lods.measured
            self.found = lods.found

    def aim(self, group: Group, views: Sequence[View], tolerance: float, higher: bool) -> None:
        """Set as goals the lengths that the agents seen in `views` allow.

        tolerance: pixels. higher: whether also those that a higher tolerance allows. The goal of an
        earlier candidate that fits about as well takes the place of a length.
        """
        size = group.scale[1]
        triangles = self.measured.value(0.0, "triangles")
        finest = self.measured.diagonal / triangles
        lengths = []
        if triangles >= LEAST_TRIANGLES:
            lengths = allowed_lengths(
                views,
                cover_sizes(group).radius,
                tolerance / size,
                finest,
                higher,
            )
        bounds = {goal: self.measured.value(goal, "bounds") for goal in self.given}
        gaps = in_gaps(lengths, list(bounds.values()))
        goals = [*(self.measured.goal_near(length) for length in gaps), *self.given]
        self.goals = [0.0, *sorted(goals, key=lambda goal: bounds.get(goal, goal))]

    def find(
        self, earlier: bpy.types.Collection | None, others_homes: set[bpy.types.Collection]
    ) -> None:
        for home in self._earlier_homes(earlier) if self.measured.rows else ():
            with suppress(CrowdError):
                goal = stored_values.read(home, CANDIDATE, float, "")
                if goal not in self.homes and home not in others_homes and _untouched(home):
                    self.homes[goal] = home

    def has_earlier(self, earlier: bpy.types.Collection | None, goals: Sequence[float]) -> bool:
        """Return whether `earlier` has a collection of one of the `goals`, edited or not."""
        return any(home.get(CANDIDATE) in goals for home in self._earlier_homes(earlier))

    def _earlier_homes(self, earlier: bpy.types.Collection | None) -> list[bpy.types.Collection]:
        levels = earlier.children if earlier is not None else ()
        return [
            home for level in levels for home in level.children if home.get(DIGEST) == self.digest
        ]

    def _remember(self, stored: IDPropertyGroup) -> None:
        """Take over the measurements that `settle` has stored. CrowdError if they are spoilt."""
        goals = stored_values.read(stored, CANDIDATE, float, "", range(1, MOST_GOALS + 1))
        columns = [
            stored_values.read(stored, name, kind, "", (len(goals),))
            for name, kind in COLUMNS.items()
        ]
        self.measured.diagonal = stored_values.read(stored, "diagonal", float, "")
        self.measured.rows = {}
        if self.goals[0] in goals:
            self.measured.rows = dict(zip(goals, zip(*columns, strict=True), strict=True))
        reach = stored_values.read(stored, REACH, float, "", (len(self.place) + 4,))
        plain = all(
            item.type == "MESH" and PLAIN.issuperset(m.type for m in item.modifiers)
            for item in self.objects
        )
        self.reach = tuple(reach[-4:]) if plain and reach[:-4] == self.place else None

    def serving(self, goal: float) -> float:
        """Return the goal of the LOD that serves `goal`.

        That is another's where the search found none that is worth it.
        """
        return min((other for other in self._alike(goal) if 0 <= other <= goal), default=goal)

    def _alike(self, goal: float) -> list[float]:
        """Return the goals that the LOD of `goal` serves, itself too; none if unmeasured."""
        rows = self.measured.rows
        return [other for other in rows if rows[other] == rows.get(goal)]

    def make(self, goal: float) -> Iterator[float]:
        """Make the LOD for `goal`; by tolerance also measure it, unless it was found before."""
        if goal in self.found:
            yield from self._make_found(goal)
        elif self.searched and goal > 0:
            yield from self.measure(goal)
        else:
            yield from self._make(goal)

    def measure(self, goal: float) -> Iterator[float]:
        if self.searched and goal > 0:
            yield from self._seek(goal)
        elif goal in self.given:
            yield from self._measure_given(goal)
        else:
            work = Workload(10)
            counts = yield from work.take(self._make(goal), 4)
            k = self.goals.index(goal)
            steps = self.judge.level(list(self.homes[goal].objects), k)
            if self._is_whole(goal) and all(source.item.type == "MESH" for source in self.sources):
                steps = self.judge.whole()
            deviation = yield from work.take(steps, 6)
            yield from work.take(self._note(goal, counts, deviation))

    def _measure_given(self, goal: float) -> Iterator[float]:
        """Measure a LOD that was given."""
        work = Workload(1)
        counts = yield from work.take(self._make(goal))
        level = list(self.homes[goal].objects)
        deviation = yield from work.take(self.judge.level(level, self.goals.index(goal)), 1)
        yield from work.take(self._note(goal, counts, deviation))

    def _make(self, goal: float) -> Generator[float, None, tuple[int, int]]:
        """Make the LOD that keeps the part `goal` of the triangles, or copy the given one.

        Returns its (vertices, triangles).
        """
        if goal in self.given:
            lod = self.given[goal]
            self._keep(goal, lod.objects, copy_given(self.name, lod, self.objects))
            return self.counts[goal]
        work = Workload(len(self.sources))
        is_whole = self._is_whole(goal)
        if not is_whole:
            yield from work.take(self._read_skins())
        parts = []
        for source in self.sources:
            if is_whole and source.item.type == "MESH":
                parts.append(share_object(source))
            else:
                steps = make_object(source, goal or 1.0, UNMEASURED_LEAST)
                parts.append((yield from work.take(steps)))
            yield work.did(1)
        self._keep(goal, self.objects, [part.item for part in parts])
        return sum(part.vertices for part in parts), sum(part.triangles for part in parts)

    def _is_whole(self, goal: float) -> bool:
        """Return whether the candidate is the character itself."""
        return goal == self.goals[0] and goal in (0.0, 1.0)

    def _read_skins(self) -> Iterator[None]:
        if not self.is_skinned:
            self.is_skinned = True
            yield from self.judge.choose_frames()
            for source in self.sources:
                yield from skin_of(source, self.judge.own_frames)

    def _seek(self, length: float) -> Iterator[float]:
        """Search for the LOD that deviates by `length` at most."""
        work = Workload(1)
        if self.search is None:
            yield from work.take(self._read_skins())
            self.search = Search(self.sources, make_object, self.judge)
        triangles = self.measured.guess_triangles([length], OFTEN_LOST)[0]
        ratio = triangles / self.measured.value(0.0, "triangles")
        rows = self.measured.rows
        fitting = [goal for goal, row in rows.items() if 0 <= goal < length and row[3] <= length]
        serving = rows[min(fitting, key=lambda goal: rows[goal][1])]
        alike = self._alike(length)
        found = yield from work.take(self.search.find(length, ratio, int(serving[1])), 1)
        if found is None:
            rows.update(dict.fromkeys([length, *alike], serving))
            return
        tries, deviation = found
        self.found[length] = [
            FoundObject(attempt.ratio, attempt.shape, attempt.item.get(MILLISECONDS, 0.0))
            for attempt in tries
        ]
        self._keep_found(length, [attempt.item for attempt in tries])
        vertices = sum(attempt.vertices for attempt in tries)
        triangles = sum(attempt.triangles for attempt in tries)
        yield from work.take(self._note(length, (vertices, triangles), deviation))
        rows.update(dict.fromkeys(alike, rows[length]))

    def _make_found(self, length: float) -> Iterator[float]:
        """Make the LOD that was found for the length."""
        work = Workload(len(self.sources))
        items = []
        for source, known in zip(self.sources, self.found[length], strict=True):
            made = yield from work.take(make_object(source, known.ratio, shape=known.shape))
            items.append(made.item)
            yield work.did(1)
        self._keep_found(length, items)

    def _keep_found(self, length: float, items: Sequence[bpy.types.Object]) -> None:
        """Keep the objects of the LOD that was found for the length, and say so in them."""
        for item, known, source in zip(items, self.found[length], self.sources, strict=True):
            if WHY in item and 0.0 < known.ratio < 1.0:
                reason = (
                    "The fewest triangles of those tried that deviate no more than agents allow."
                )
                item[WHY] = " ".join([reason, *source.notes])
                item[MILLISECONDS] = known.milliseconds
        self._keep(length, self.objects, items)

    def _keep(
        self,
        goal: float,
        originals: Sequence[bpy.types.Object],
        items: Sequence[bpy.types.Object],
    ) -> None:
        """Put a LOD's objects, made of the `originals`, into a collection of their own."""
        k = len(self.homes)
        home = bpy.data.collections.new(f"{self.name} LOD {k}")
        for original, item in zip(originals, items, strict=True):
            home.objects.link(item)
            item.name = f"{original.name} LOD {k}"
            if WAY in item:
                item.data.name = item.name
        home[DIGEST] = self.digest
        home[CANDIDATE] = goal
        home[SIZE] = len(items)
        self.homes[goal] = self.new_homes[goal] = home

    def _note(
        self, goal: float, counts: tuple[int, int], deviation: tuple[float, float, float, float]
    ) -> Iterator[float]:
        """Note the (vertices, triangles) of the LOD for `goal`, and what was measured of it.

        Yields between the steps.
        """
        self.measured.diagonal = self.judge.diagonal
        shaded = 0.0
        if self.looks and goal:
            worst = (self.judge.performance, deviation[-1])
            level = list(self.homes[goal].objects)
            diagonal = self.judge.diagonal
            shaded = yield from compare(self.objects, level, worst, diagonal, self.looks)
        self.measured.rows[goal] = (*counts, *deviation, shaded)

    def look_between(self, goals: Sequence[float]) -> Generator[float, None, bool]:
        """Look at LODs that were made anew in frames between the poses, unless that is done.

        Yields the progress. Returns whether that has raised a bound. A LOD that is far beyond its
        length there is sought anew, once: the frame is one of the poses from now on.
        """
        rows = self.measured.rows
        new = [goal for goal in goals if goal in self.new_homes and goal not in self.looked]
        levels = [list(self.homes[goal].objects) for goal in new]
        before = [rows[goal][2:6] for goal in new]
        deviations = yield from self.judge.look_between(levels, before)
        for goal, row, deviation in zip(new, before, deviations, strict=True):
            if row[1] <= goal < deviation[1] / BEYOND and goal not in self.again:
                self.again.add(goal)
                self._forget(goal)
            else:
                self.looked.add(goal)
                seen = (*rows[goal][:2], *deviation, *rows[goal][6:])
                rows.update(dict.fromkeys(self._alike(goal), seen))
        return deviations != before

    def _forget(self, goal: float) -> None:
        """Remove a LOD that was made now, and what was measured of the goals that it serves."""
        for other in self._alike(goal):
            del self.measured.rows[other]
        del self.new_homes[goal], self.found[goal]
        home = self.homes.pop(goal)
        discard(list(home.objects))
        removal.remove([home])

    def guess(self, group: Group) -> Group:
        """Return the group with measured or guessed values of all candidates."""
        # by distance all are made, whatever they deviate by
        return self.measured.complete(group, self.goals, guesses=self.searched)

    def mark_as_made(self, kept_homes: list[bpy.types.Collection]) -> Iterator[None]:
        """Note what the objects of the chosen collections are like; yield between them."""
        for home in kept_homes:
            if home in self.new_homes.values():
                for item in home.objects:
                    item[AS_MADE] = hash_made(item)
                    yield

    def settle(self, kept_homes: list[bpy.types.Collection]) -> None:
        goals = list(self.measured.rows)
        if len(goals) > MOST_GOALS:
            goals = [self.goals[0], *goals[1 - MOST_GOALS :]]
        kept_homes[0][MEASURED] = {
            CANDIDATE: goals,
            REACH: [*self.place, *self.reach],
            **self.measured.columns(goals),
        }
        removal.remove([source.mesh for source in self.sources if source.mesh])
        doomed = [home for home in self.new_homes.values() if home not in kept_homes]
        discard([item for home in doomed for item in home.objects])
        removal.remove(doomed)
