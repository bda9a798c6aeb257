"""LOD meshes: decimated copies of every character, in collections that the user can see and edit."""

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import bpy
from idprop.types import IDPropertyGroup

from ..crowd_lod.agents import Group
from ..crowd_lod.errors import CrowdError
from ..crowd_lod.steps import standing
from . import chain, stored, transfer, ways
from . import scene as io
from . import source as sources
from .deviation import compare, measure, poses
from .movers import armatures_of, stance
from .operator import Stepwise
from .populate import GROUP, characters_of, measuring_groups, store_groups
from .skin import skin_of
from .source import OWNED

# LOD 0 red, 1 green, 2 blue, as in the chapter's figure 1.5; then colours that stay apart for colour-blind eyes
# (Okabe and Ito), and white. Linear RGB.
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
# Custom properties of a LOD's collection of one character group: the hash of what it was made from, which candidate it is,
# and how many objects it has; of the finest, what was measured of all candidates. Of its objects: the hash of what was
# made; how, why so, and the milliseconds it took.
DIGEST, CANDIDATE, SIZE, MEASURED = "crowd_lod_digest", "crowd_lod_candidate", "crowd_lod_size", "crowd_lod_measured"
AS_MADE, WAY, WHY, MILLISECONDS = "crowd_lod_as_made", "crowd_lod_way", "crowd_lod_why", "crowd_lod_ms"
COLUMNS = ("vertices", "triangles", "deviations", "bounds", "rms", "worst")  # of Group, a value a LOD
VERSION = 16  # of the code that makes LOD meshes: another one makes them anew


@dataclass(frozen=True)
class Outcome:
    """What make_levels did: names of the character groups whose LOD meshes it `made`, and of those that it `kept` as they
    were; `edited`: groups made anew only because their LOD meshes had been edited or deleted."""

    made: tuple[str, ...]
    kept: tuple[str, ...]
    edited: tuple[str, ...]

    @property
    def sentence(self) -> str:
        parts = [f"LOD meshes made: {', '.join(self.made) or 'none'}."]
        if self.kept:
            parts.append(f"As they were, for nothing they depend on changed: {', '.join(self.kept)}.")
        if self.edited:
            parts.append(f"Edited or deleted by hand, and so made anew: {', '.join(self.edited)}.")
        return " ".join(parts)


def make_levels(scene: bpy.types.Scene) -> Iterator[float]:
    """Make the LOD collections of `scene`; yields the progress, 0 to 1, and returns the Outcome.

    "Crowd LOD" holds a collection a LOD, which holds one a character group, named so that their natural order is the
    groups'. LOD 0 shares the characters' own meshes; the others are decimated from the character as modified, at rest,
    follow its armature, and are measured over its action. By tolerance a ladder of candidates is made, of which those that
    pay are kept; a group with fewer than others repeats its last. Groups whose LODs were made from just what there is now,
    and were not edited since, are kept. Nothing of the user's is changed. If it fails or is closed early, the LODs that
    were there stay.
    """
    io.check_own(scene)
    settings = scene.crowd_lod
    characters = characters_of(scene)
    ratios = chain.ratios_of(settings)
    copied = io.shared(scene, "levels")  # a linked copy begins with the LODs of the other scene, which stay that one's
    earlier = None if copied else settings.levels
    before = set(bpy.data.user_map())
    done = False
    try:
        groups = yield from standing(measuring_groups(scene), 0.0)
        if settings.choice == "BY_TOLERANCE":
            chain.check(scene, groups)
        ladders, share = [], 0.9 / len(characters)
        for g, ((name, objects, _), group) in enumerate(zip(characters, groups, strict=True)):
            ladder = _Ladder(name, objects, ratios, settings.way, settings.choice == "BY_TOLERANCE" and settings.shading_counts)
            for part in ladder.read():
                yield (g + 0.2 * part) * share
            ladder.recall(earlier, group)
            if ladder.group is None:
                for part in ladder.make():
                    yield (g + 0.2 + 0.5 * part) * share
                yield from ladder.measure(group, ((g + 0.7) * share, (g + 1) * share))
            ladders.append(ladder)
        chosen = chain.Chosen([list(range(len(ratios)))] * len(ladders))
        if settings.choice == "BY_TOLERANCE":
            chosen = yield from chain.chosen(scene, [ladder.group for ladder in ladders], 0.9)
        homes, edited, taken = [], [], set()
        for g, (ladder, kept) in enumerate(zip(ladders, chosen.keep, strict=True)):
            old = None if ladder.homes else _earlier(earlier, ladder.digest, kept, taken)
            taken.update(old or ())
            if not ladder.homes and not old:
                if ladder.digest not in [each.digest for each in ladders[:g]]:
                    edited.append(ladder.name)
                for part in ladder.make():
                    yield 0.9 + 0.09 * (g + part) / len(ladders)
            homes.append(old or [ladder.homes[k] for k in kept])
        done = True
    except ReferenceError as error:  # by a script or another add-on, between two steps
        raise CrowdError("Something that LODs are made from was deleted meanwhile: press Make LOD Meshes again.") from error
    finally:
        if not done:
            bpy.data.batch_remove([block for block in bpy.data.user_map() if block not in before])
    for ladder, own in zip(ladders, homes, strict=True):
        ladder.forget(own)
    top, levels = bpy.data.collections.new("Crowd LOD"), []
    for k in range(max(map(len, homes))):
        levels.append(bpy.data.collections.new(f"Crowd LOD {k}"))
        top.children.link(levels[k])
    outcome = Outcome(
        tuple(ladder.name for ladder in ladders if ladder.homes),
        tuple(ladder.name for ladder in ladders if not ladder.homes),
        tuple(edited),
    )
    for (_, _, origin), group, own in zip(characters, groups, homes, strict=True):
        for k, level in enumerate(levels):
            home = own[min(k, len(own) - 1)]
            home.instance_offset = (*origin[:2], origin[2] + group.feet)
            for other in earlier.children if earlier is not None and home in before else ():
                if home.name in other.children:
                    other.children.unlink(home)
            level.children.link(home)
    if earlier is not None:
        remove_owned(earlier, levels)
    for block in bpy.data.user_map():
        if block not in before:
            block[OWNED] = True
            # free again, now that the earlier LODs are gone; never at the cost of what else has the name
            block.rename(re.sub(r"\.\d+$", "", block.name), mode="NEVER")
    for g, ((name, _, _), own) in enumerate(zip(characters, homes, strict=True)):
        for k, home in enumerate(own):
            home.rename(f"{g:03d} {name} LOD {k}", mode="NEVER")
            home[GROUP] = name
            for item in home.objects:
                if item.get(OWNED):
                    item.rename(re.sub(r" LOD \d+(\.\d+)?$", f" LOD {k}", item.name), mode="NEVER")
                    item.color = (*TINTS[k], 1.0)
    if copied:
        io.let_go(scene, "levels")
    scene.collection.children.link(top)
    top.hide_render = True  # in a view layer that the user adds later, too
    for view_layer in scene.view_layers:
        view_layer.update()  # a scene that was never evaluated has no layer collections yet
        view_layer.layer_collection.children[top.name].exclude = True
    settings.levels, settings.dropped, settings.memory_tolerance = top, "\n".join(chosen.dropped), chosen.tolerance
    store_groups(settings, tuple(_of(ladder.group, kept, len(levels)) for ladder, kept in zip(ladders, chosen.keep, strict=True)))
    for entry, finest in zip(settings.groups, chosen.finest or [0] * len(ladders), strict=True):
        entry.finest = finest
    yield 1.0
    return outcome


def _of(group: Group, kept: list[int], count: int) -> Group:
    """The group with the candidates `kept`, the last repeated up to `count`."""
    own = [*kept, *[kept[-1]] * (count - len(kept))]
    return replace(group, **{name: tuple(getattr(group, name)[k] for k in own) for name in (*COLUMNS, *_shaded(group))})


def _shaded(group: Group) -> tuple[str, ...]:
    """The column of what shaded pictures say, where they were compared."""
    return ("shaded",) if group.shaded else ()


def remove_owned(top: bpy.types.Collection, heirs: Sequence[bpy.types.Collection] = ()) -> None:
    """Remove the collection `top` and all that Crowd LOD made in it; what the user put there moves up into the scene.
    Whatever refers to a child of `top`, such as a build, then refers to the heir in its place."""
    inside, left = {top}, [top]
    while left:
        ours = {child for child in left.pop().children if child.get(OWNED)} - inside
        inside |= ours
        left += ours
    others = [*bpy.data.collections, *(scene.collection for scene in bpy.data.scenes)]
    kept = {child for other in others if other not in inside for child in other.children}
    scenes = [scene for scene in bpy.data.scenes if top in scene.collection.children_recursive]
    for child in {child for home in inside for child in home.children} - kept - inside:
        for scene in scenes:
            scene.collection.children.link(child)
    for item in list(top.all_objects):
        if not item.get(OWNED) and set(item.users_collection).issubset(inside):
            for scene in item.users_scene:
                scene.collection.objects.link(item)
    objects = [o for o in top.all_objects if o.get(OWNED)]
    data = {o.data for o in objects if o.data is not None and o.data.get(OWNED)}
    users = bpy.data.user_map(subset=data)
    data = [block for block in data if users[block].issubset(objects)]  # the user may have taken one
    doomed = [*objects, *data, *inside]
    for child, heir in zip(list(top.children), heirs, strict=False):
        child.user_remap(heir)
    bpy.data.batch_remove(doomed)
    for kind in (bpy.data.actions, bpy.data.materials, bpy.data.node_groups, bpy.data.images):  # each may hold the next
        while unused := [block for block in kind if block.get(OWNED) and not block.users]:
            bpy.data.batch_remove(unused)


def _earlier(
    top: bpy.types.Collection | None, digest: str, candidates: list[int], taken: set[bpy.types.Collection]
) -> list[bpy.types.Collection] | None:
    """The collections in `top` of these candidates that were made from what has this digest, but for those `taken` by another
    group of the same objects, if all are there, untouched."""
    levels, found = top.children if top is not None else (), {}
    for home in (home for level in levels for home in level.children):
        if home.get(DIGEST) == digest and home not in taken:
            found.setdefault(home[CANDIDATE], home)
    homes = [found.get(k) for k in candidates]
    return homes if all(home is not None and _untouched(home) for home in homes) else None


def _untouched(home: bpy.types.Collection) -> bool:
    """Whether all that was made in `home` is there, and as it was made."""
    objects = [item for item in home.objects if item.get(OWNED)]
    return len(objects) == home[SIZE] and all(item.get(AS_MADE) == _as_made(item) for item in objects)


def _as_made(item: bpy.types.Object) -> str:
    """A hash of what the user may edit in a LOD's object; its own mesh where that was made for it."""
    looks = [modifier.type for modifier in item.modifiers], item.data.name_full if WAY not in item else ""
    if WAY not in item:
        return repr(looks)
    item.update_from_editmode()
    return sources.digest(item.data, looks, item.vertex_groups.keys())


class _Ladder:
    """The LODs of one character group, or the candidates for them.

    read() gives the `digest` of what they are made from; recall() the `group` with what was measured of such before, or
    None; make() their collections, `homes`; measure() the `group`. All but recall() yield their progress. forget()
    removes what they were made from, and all but the collections chosen, of which the finest keeps what was measured.
    """

    def __init__(self, name: str, objects: list[bpy.types.Object], ratios: list[float], way: str, shading: bool):
        self.name, self.objects, self.ratios, self.way, self.shading = name, objects, ratios, way, shading
        self.sources: list[sources.Source] = []
        self.homes: list[bpy.types.Collection] = []
        self.group: Group | None = None

    def read(self) -> Iterator[float]:
        digests = []
        for number, item in enumerate(self.objects):
            source = sources.read_source(item)
            self.sources.append(source)
            digests.append(_object_digest(item, source))
            yield (number + 1) / len(self.objects)
        if not any(source.mesh for source in self.sources):
            raise CrowdError(f"The character group {self.name} has no faces, modifiers applied: give it a mesh, or take it out.")
        self.digest = sources.text_digest(digests, self.ratios, self.way, VERSION, *["shading"] * self.shading)
        shown = [source for source in self.sources if source.mesh]
        triangles = [len(source.mesh.loops) - 2 * len(source.mesh.polygons) for source in shown]
        for source, own in zip(shown, triangles, strict=True):
            source.share = own / sum(triangles)

    def recall(self, earlier: bpy.types.Collection | None, group: Group) -> None:
        finest = earlier.children[0].children if earlier is not None and earlier.children else ()
        for home in finest:
            found = home.get(MEASURED) if home.get(DIGEST) == self.digest else None
            if not isinstance(found, IDPropertyGroup):
                continue
            with suppress(CrowdError):  # what is spoilt is made and measured anew
                kinds = dict(zip(COLUMNS, [int, int, float, float, float, float], strict=True))
                if self.shading:
                    kinds["shaded"] = float
                columns = {name: tuple(stored.read(found, name, kind, "", (len(self.ratios),))) for name, kind in kinds.items()}
                self.group = replace(group, diagonal=stored.read(found, "diagonal", float, ""), **{"shaded": (), **columns})

    def make(self) -> Iterator[float]:
        steps = len(self.ratios) * len(self.sources)
        vertices, triangles = [], []
        for source in self.sources:
            for _ in skin_of(source, poses(self.objects)):
                yield 0.0
        for k, ratio in enumerate(self.ratios):
            home = bpy.data.collections.new(f"{self.name} LOD {k}")
            sizes = []
            for number, source in enumerate(self.sources):
                sizes.append((yield from _level_object(source, home, k, ratio, self.way, (k * len(self.sources) + number) / steps)))
                yield (k * len(self.sources) + number + 1) / steps
            home[DIGEST], home[CANDIDATE], home[SIZE] = self.digest, k, len(sizes)
            vertices.append(sum(v for v, _ in sizes))
            triangles.append(sum(t for _, t in sizes))
            self.homes.append(home)
        self.sizes = {"vertices": tuple(vertices), "triangles": tuple(triangles)}

    def measure(self, group: Group, progress: tuple[float, float]) -> Iterator[float]:
        meshes = [list(home.objects) for home in self.homes]
        self.group = yield from measure(replace(group, **self.sizes), self.objects, meshes, progress)
        if self.shading:
            self.group = yield from compare(self.group, self.objects, meshes, progress[1])

    def forget(self, chosen: list[bpy.types.Collection]) -> None:
        columns = {name: list(getattr(self.group, name)) for name in (*COLUMNS, *_shaded(self.group))}
        chosen[0][MEASURED] = {"diagonal": self.group.diagonal, **columns}
        bpy.data.batch_remove([source.mesh for source in self.sources if source.mesh])
        doomed = [home for home in self.homes if home not in chosen]
        objects = [item for home in doomed for item in home.objects]
        data = {item.data for item in objects if WAY in item}
        bpy.data.batch_remove([*objects, *doomed, *data])


def _object_digest(item: bpy.types.Object, source: sources.Source) -> str:
    """A hash of all that LODs take from the object."""
    blocks = source.keys and item.data.shape_keys.key_blocks
    looks = (
        [getattr(item, name) for name in io.SHOWN if name not in ("hide_render", "hide_viewport", "color")],
        [slot.material and slot.material.name_full for slot in item.material_slots],
        [(name, blocks[name].slider_min, blocks[name].slider_max) for name in source.keys],
    )
    if source.mesh is None:
        return sources.text_digest(stance(item), looks)
    active = [layer.active_render for layer in source.mesh.uv_layers], source.mesh.attributes.default_color_name
    return sources.digest(source.mesh, stance(item), looks, active, source.groups)


def _level_object(source, home: bpy.types.Collection, level: int, ratio: float, way: str, progress: float):
    """Put the LOD `level` of the source into `home`; yields `progress` and returns (vertices, triangles) of its mesh."""
    item, name = source.item, f"{source.item.name} LOD {level}"
    if source.mesh is None or (level == 0 and ratio == 1 and item.type == "MESH"):
        # the character's own data; the counts are of what is drawn, modifiers applied
        copy = _copy(item)
        _place(copy, name, home, level)
        copy[AS_MADE] = _as_made(copy)
        mesh = source.mesh
        return (len(mesh.vertices), len(mesh.loops) - 2 * len(mesh.polygons)) if mesh else (0, 0)
    made = yield from standing(ways.make(source, ratio, way, name), progress)
    copy = _copy(item) if item.type == "MESH" else _stand_in(item, made.mesh)
    for modifier in list(copy.modifiers):
        if modifier.type not in sources.FOLLOWED:
            copy.modifiers.remove(modifier)
    copy.data = made.mesh
    for slot in copy.material_slots:
        slot.link = "DATA"
    transfer.set_weights(copy, source.groups, _rigs(item, source.groups), made.weights)
    transfer.set_normals(made.mesh)
    transfer.set_keys(copy, source)
    transfer.mark_active(made.mesh, source.mesh)
    _place(copy, name, home, level)
    copy[WAY], copy[WHY], copy[MILLISECONDS] = made.way, " ".join([made.why, *source.notes]), made.milliseconds
    copy[AS_MADE] = _as_made(copy)
    return len(made.mesh.vertices), len(made.mesh.loops) - 2 * len(made.mesh.polygons)


def _rigs(item: bpy.types.Object, groups: list[str]) -> list[set[str]]:
    """Those of the vertex groups that armatures of `item` follow, by armature; of armatures with a bone of one name together."""
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
    for collection in copy.users_collection:  # Blender puts a copy of a rigid body into the simulation
        collection.objects.unlink(copy)
    return copy


def _stand_in(item: bpy.types.Object, mesh: bpy.types.Mesh) -> bpy.types.Object:
    """A mesh object in place of `item`, which is of another kind: it goes where that goes, and follows its armature."""
    copy = io.mesh_like(item, mesh)
    copy.constraints.new("COPY_TRANSFORMS").target = item
    for armature in armatures_of([item]):
        copy.modifiers.new(armature.name, "ARMATURE").object = armature
    return copy


class CROWDLOD_OT_make_levels(Stepwise, bpy.types.Operator):
    """Make the LOD meshes of every character by decimation; the characters stay as they are"""

    bl_idname = "crowd_lod.make_levels"
    bl_label = "Make LOD Meshes"

    def steps(self, context):
        outcome = yield from make_levels(context.scene)
        return outcome.sentence


CLASSES = (CROWDLOD_OT_make_levels,)
