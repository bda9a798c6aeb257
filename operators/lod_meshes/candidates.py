"""Candidates for the LODs of one character: made, measured, and recognized later.

They are reused as long as nothing that they depend on changes.
"""

from collections.abc import Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import bpy
from idprop.types import IDPropertyGroup

from ...crowd_lod.crowd.agents import Group
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.levels.selection import guessed
from ...crowd_lod.progress import share, standing
from ..blender import mesh_data, stored_values
from ..blender.material_colors import Looks
from ..blender.ownership import OWNED
from ..blender.performance import digest as digest_of
from ..blender.provenance import text_digest
from ..blender.rig_dependencies import armatures_of, stance
from ..crowd.character_extent import displaced
from ..crowd.scene_world import actions_named
from . import attribute_transfer, methods
from . import source_mesh as sources
from .deviation import Measure, compare, poses
from .pose_deformation import skin_of

# LOD 0 red, 1 green, 2 blue, as in the chapter's figure 1.5; then colors that stay apart for
# color-blind eyes (Okabe and Ito), and white. Linear RGB.
TINTS = (
    (0.80, 0.03, 0.03),
    (0.04, 0.60, 0.06),
    (0.05, 0.12, 0.85),
    (0.78, 0.35, 0.00),
    (0.09, 0.46, 0.81),
    (0.87, 0.78, 0.05),
    (0.60, 0.19, 0.38),
    (0.85, 0.85, 0.85),
)
# Custom properties of a LOD's collection of one character group: the hash of what it was made from,
# which candidate it is, and how many objects it has; of the finest, what was measured of those that
# were made. Of its objects: the hash of what was made; how, why so, and the milliseconds it took.
DIGEST, CANDIDATE, SIZE, MEASURED = "crowd_lod_digest", "crowd_lod_candidate", "crowd_lod_size", "crowd_lod_measured"
AS_MADE, WAY, WHY, MILLISECONDS = "crowd_lod_as_made", "crowd_lod_method", "crowd_lod_why", "crowd_lod_ms"
# Of Group, a value a LOD
COLUMNS = {"vertices": int, "triangles": int, "deviations": float, "bounds": float, "rms": float, "worst": float}
# of what was measured: where the group stands, by how much materials displace it, its lowest point,
# center, radius
REACH = "reach"
# Modifiers whose settings say all that they do; of others, such as physics, groups are measured
# again.
PLAIN = {"ARMATURE", "BEVEL", "DECIMATE", "EDGE_SPLIT", "MIRROR", "SOLIDIFY", "SUBSURF", "TRIANGULATE", "WEIGHTED_NORMAL", "WELD"}
# see Ladder.lost: less than most LODs do, for what is guessed to deviate too much is never tried
USUALLY_LOST = 4.0
VERSION = 21  # of the code that makes LOD meshes: another one makes them anew


def _untouched(home: bpy.types.Collection) -> bool:
    """Return whether `home` still has all objects that were made in it, unedited."""
    objects = [item for item in home.objects if item.get(OWNED)]
    return len(objects) == home[SIZE] and all(item.get(AS_MADE) == _as_made(item) for item in objects)


def _as_made(item: bpy.types.Object) -> str:
    """Return a hash of everything that the user may edit in a LOD's object.

    The mesh is included only if it was made for this object.
    """
    looks = [modifier.type for modifier in item.modifiers], item.data.name_full if WAY not in item else ""
    if WAY not in item:
        return repr(looks)
    item.update_from_editmode()
    return sources.digest(item.data, looks, item.vertex_groups.keys())


class Ladder:
    """The candidates for the LODs of one character group, one for each of `ratios`.

    Order of calls:
    read() reads the source meshes and sets `digest`, a hash of everything that candidates depend
        on.
    recall() takes over measurements from an earlier run with the same digest.
    measure() makes one candidate and measures it; make() only makes it.
    find() takes over collections of an earlier run, except those `taken` by another group.
    settle() keeps only the chosen collections, and removes the rest and the source meshes.

    read(), make() and measure() yield their progress.

    place: four numbers given: the origin x, y, z in world meters, and 1 if the group stands on its
        lowest point, else 0. Kept with the displacement of each object added.
    rows: measurements by candidate, a value for each of `kinds`.
    reach: the group's lowest point, center and radius in meters, or None.
    found: collections by candidate; made: those of them that are new.
    """

    def __init__(self, name: str, objects: list[bpy.types.Object], ratios: list[float], settings, place: Sequence[float]):
        actions = actions_named(settings.id_data, name)
        self.name, self.objects, self.ratios, self.method = name, objects, ratios, settings.method
        self.looks = Looks() if settings.choice == "BY_TOLERANCE" and settings.shading_counts else None
        self.kinds = dict(COLUMNS) | ({"shaded": float} if self.looks else {})
        self.place = [*place, *map(displaced, objects)]
        self.reach: tuple[float, float, float] | None = None
        self.sources: list[sources.Source] = []
        self.rows: dict[int, tuple] = {}
        self.found: dict[int, bpy.types.Collection] = {}
        self.made: dict[int, bpy.types.Collection] = {}
        self.sizes: dict[int, tuple[int, int]] = {}
        self.by, self.diagonal = Measure(name, objects, actions, settings.hidden_surface_counts), 0.0

    def read(self) -> Iterator[float]:
        digests = []
        for number, item in enumerate(self.objects):
            source = sources.read_source(item)
            self.sources.append(source)
            digests.append(_object_digest(item, source))
            yield (number + 1) / len(self.objects)
        if not any(source.mesh for source in self.sources):
            raise CrowdError(f"The character group {self.name} has no faces, modifiers applied: give it a mesh, or take it out.")
        named = digest_of(self.by.performance.parts)
        self.digest = text_digest(
            digests, self.ratios, self.method, VERSION, *["shading"] * bool(self.looks), *named, self.by.hidden_counts
        )
        shown = [source for source in self.sources if source.mesh]
        triangles = [len(source.mesh.loops) - 2 * len(source.mesh.polygons) for source in shown]
        for source, own in zip(shown, triangles, strict=True):
            source.share = own / sum(triangles)

    def recall(self, earlier: bpy.types.Collection | None) -> None:
        for home in self._homes(earlier):
            if isinstance(home.get(MEASURED), IDPropertyGroup):
                with suppress(CrowdError):  # what is spoilt is made and measured anew
                    self._remember(home[MEASURED])

    def find(self, earlier: bpy.types.Collection | None, taken: set[bpy.types.Collection]) -> None:
        for home in self._homes(earlier) if self.rows else ():
            with suppress(CrowdError):
                k = stored_values.read(home, CANDIDATE, int, "")
                if k not in self.found and home not in taken and _untouched(home):
                    self.found[k] = home

    def held(self, earlier: bpy.types.Collection | None, some: Sequence[int]) -> bool:
        """Return whether `earlier` has a collection of one of the candidates `some`."""
        return any(home.get(CANDIDATE) in some for home in self._homes(earlier))

    def _homes(self, earlier: bpy.types.Collection | None) -> list[bpy.types.Collection]:
        levels = earlier.children if earlier is not None else ()
        return [home for level in levels for home in level.children if home.get(DIGEST) == self.digest]

    def _remember(self, found: IDPropertyGroup) -> None:
        some = stored_values.read(found, CANDIDATE, int, "", range(1, len(self.ratios) + 1), (0, len(self.ratios) - 1))
        columns = [stored_values.read(found, *column, "", (len(some),)) for column in self.kinds.items()]
        self.diagonal = stored_values.read(found, "diagonal", float, "")
        self.rows = dict(zip(some, zip(*columns, strict=True), strict=True)) if 0 in some else {}
        reach = stored_values.read(found, REACH, float, "", (len(self.place) + 3,))
        plain = all(item.type == "MESH" and PLAIN.issuperset(m.type for m in item.modifiers) for item in self.objects)
        self.reach = tuple(reach[-3:]) if plain and reach[:-3] == self.place else None

    def make(self, k: int) -> Iterator[float]:
        if not self.made:
            for source in self.sources:
                yield from standing(skin_of(source, poses(self.objects)), 0.0)
        home, sizes = bpy.data.collections.new(f"{self.name} LOD {k}"), []
        for number, source in enumerate(self.sources):
            progress = number / len(self.sources)
            sizes.append((yield from _level_object(source, home, k, self.ratios[k], self.method, progress)))
        home[DIGEST], home[CANDIDATE], home[SIZE] = self.digest, k, len(sizes)
        self.found[k] = self.made[k] = home
        self.sizes[k] = tuple(map(sum, zip(*sizes, strict=True)))

    def measure(self, k: int) -> Iterator[float]:
        yield from share(self.make(k), 0.0, 0.7)
        found = yield from share(self.by.level(list(self.found[k].objects), k), 0.7, 1.0)
        self.rows[k], self.diagonal = (*self.sizes[k], *found), self.by.diagonal
        if self.looks:
            at = self.by.performance, found[-1]
            self.rows[k] += (compare(self.objects, list(self.found[k].objects), at, self.diagonal, self.looks) if k else 0.0,)

    def columns(self, some: Sequence[int]) -> dict:
        """Return the values of a Group for the candidates `some`, by name of the field."""
        return dict(zip(self.kinds, zip(*(self.rows[k] for k in some), strict=True), strict=True)) | {"diagonal": self.diagonal}

    def lost(self) -> list[float]:
        """Return triangles x deviation / diagonal of measured candidates but the first.

        The deviation is its upper bound. Candidates without deviation are left out.
        """
        triangles, bounds = (list(self.kinds).index(name) for name in ("triangles", "bounds"))
        return [row[triangles] * row[bounds] / self.diagonal for k, row in self.rows.items() if k and row[bounds] > 0]

    def guess(self, group: Group, usual: Sequence[float]) -> Group:
        """Return the group with measured or guessed values of all candidates.

        usual: values of `lost` of all characters, used where this character has no measurement.
        """
        whole = self.rows[0][list(self.kinds).index("triangles")]
        own = {
            name: [self.rows[k][at] if k in self.rows else 0 for k in range(len(self.ratios))] for at, name in enumerate(self.kinds)
        }
        for name in ("bounds", *self.kinds.keys() & {"shaded"}):
            known = {k: own[name][k] for k in self.rows}
            own[name] = guessed(self.ratios, known, min(usual, default=USUALLY_LOST) * self.diagonal / whole)
        own["triangles"] = [own["triangles"][k] or max(1, round(ratio * whole)) for k, ratio in enumerate(self.ratios)]
        return replace(group, diagonal=self.diagonal, **{name: tuple(values) for name, values in own.items()})

    def settle(self, chosen: list[bpy.types.Collection]) -> None:
        some = sorted(self.rows)
        chosen[0][MEASURED] = {CANDIDATE: some, REACH: [*self.place, *self.reach], **self.columns(some)}
        bpy.data.batch_remove([source.mesh for source in self.sources if source.mesh])
        doomed = [home for home in self.made.values() if home not in chosen]
        objects = [item for home in doomed for item in home.objects]
        data = {item.data for item in objects if WAY in item}
        bpy.data.batch_remove([*objects, *doomed, *data])


def _object_digest(item: bpy.types.Object, source: sources.Source) -> str:
    """Return a hash of everything that LODs take from the object."""
    blocks = source.keys and item.data.shape_keys.key_blocks
    looks = (
        [getattr(item, name) for name in mesh_data.SHOWN if name not in ("hide_render", "hide_viewport", "color")],
        [slot.material and slot.material.name_full for slot in item.material_slots],
        [(name, blocks[name].slider_min, blocks[name].slider_max) for name in source.keys],
    )
    if source.mesh is None:
        return text_digest(stance(item), looks)
    active = [layer.active_render for layer in source.mesh.uv_layers], source.mesh.attributes.default_color_name
    return sources.digest(source.mesh, stance(item), looks, active, source.groups)


def _level_object(
    source, home: bpy.types.Collection, level: int, ratio: float, method: str, progress: float
) -> Generator[float, None, tuple[int, int]]:
    """Put LOD `level` of `source` into `home`; return its (vertices, triangles).

    Yields `progress` between its steps. LOD 0 of a mesh shares the character's data; its counts are
    of the mesh with modifiers applied.
    """
    item, name = source.item, f"{source.item.name} LOD {level}"
    if source.mesh is None or (level == 0 and ratio == 1 and item.type == "MESH"):
        # the character's own data; the counts are of what is drawn, modifiers applied
        copy = _copy(item)
        _place(copy, name, home, level)
        copy[AS_MADE] = _as_made(copy)
        mesh = source.mesh
        return (len(mesh.vertices), len(mesh.loops) - 2 * len(mesh.polygons)) if mesh else (0, 0)
    made = yield from standing(methods.make(source, ratio, method, name), progress)
    copy = _copy(item) if item.type == "MESH" else _stand_in(item, made.mesh)
    for modifier in list(copy.modifiers):
        if modifier.type not in sources.FOLLOWED:
            copy.modifiers.remove(modifier)
    copy.data = made.mesh
    for slot in copy.material_slots:
        slot.link = "DATA"
    attribute_transfer.set_weights(copy, source.groups, _rigs(item, source.groups), made.weights)
    attribute_transfer.set_normals(made.mesh)
    attribute_transfer.set_keys(copy, source)
    attribute_transfer.mark_active(made.mesh, source.mesh)
    _place(copy, name, home, level)
    copy[WAY], copy[WHY], copy[MILLISECONDS] = made.method, " ".join([made.why, *source.notes]), made.milliseconds
    copy[AS_MADE] = _as_made(copy)
    return len(made.mesh.vertices), len(made.mesh.loops) - 2 * len(made.mesh.polygons)


def _rigs(item: bpy.types.Object, groups: list[str]) -> list[set[str]]:
    """Return for each armature of `item` the vertex groups that it deforms.

    Armatures that share the name of a bone are merged.
    """
    rigs: list[set[str]] = []
    for armature in armatures_of([item]):
        bones = {bone.name for bone in armature.data.bones if bone.use_deform}.intersection(groups)
        apart = [other for other in rigs if not other & bones]
        rigs = [*apart, bones.union(*(other for other in rigs if other & bones))]
    return rigs


def _place(copy: bpy.types.Object, name: str, home: bpy.types.Collection, level: int) -> None:
    home.objects.link(copy)
    copy.name = name
    copy.color = (*TINTS[level], 1.0)
    copy.hide_render = copy.hide_viewport = False


def _copy(item: bpy.types.Object) -> bpy.types.Object:
    copy = item.copy()
    if copy.override_library:
        copy.make_local()
    for name in (OWNED, AS_MADE, WAY, WHY, MILLISECONDS):  # of a LOD that became a character
        copy.pop(name, None)
    # Blender puts a copy of a rigid body into the simulation
    for collection in copy.users_collection:
        collection.objects.unlink(copy)
    return copy


def _stand_in(item: bpy.types.Object, mesh: bpy.types.Mesh) -> bpy.types.Object:
    """Return a mesh object in place of `item`, which has no mesh data of its own.

    It copies the transforms of `item` and follows the same armatures.
    """
    copy = mesh_data.mesh_like(item, mesh)
    copy.constraints.new("COPY_TRANSFORMS").target = item
    for armature in armatures_of([item]):
        copy.modifiers.new(armature.name, "ARMATURE").object = armature
    return copy
