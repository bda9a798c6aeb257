"""What a render shows besides the crowd: lamps, glowing and solid objects.

Scenery is cached for each view layer that is played. `note_frame` gets the changes of the
depsgraph. It updates the cache where only places and shapes changed, and drops it otherwise.
Renders read everything anew. So does a session that has frame handlers of other add-ons.
"""

from collections.abc import Iterator

import bpy
import numpy as np

from . import scene_cache
from .callbacks import handler
from .materials import casts, emits
from .ownership import OWNED, is_ours
from .references import reached_blocks

SOLID = {
    "MESH",
    "CURVE",
    "SURFACE",
    "META",
    "FONT",
    "CURVES",
    "POINTCLOUD",
    "VOLUME",
    "GREASEPENCIL",
}

# A thing in a render: the object, and the collection instances it is in, outermost first.
Placed = tuple[bpy.types.Object, tuple[bpy.types.Object, ...]]


class Scenery:
    """What a render of `scene` shows, as `depsgraph` has evaluated it, if given.

    In the depsgraph, animated values are those of the frame. The file's own data has them only in
    the viewport's frames.

    things: all objects shown, without Crowd LOD's own, which still hold an earlier frame.
    lights, solid: the lamps among them, and the objects of types in SOLID.
    bounded: whether the objects' own bounding boxes hold everything: not if nodes or particles make
        instances.
    instanced: lights that objects of `shining` make, as lights.py read them; None if outdated.
    occluding: (objects that hide nobody, what else may hide agents, as blender/occluders.py read
        it); None if outdated.
    """

    def __init__(self, scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None):
        visible_things = list(_visible_things(scene, depsgraph))
        self._hides = {
            item.session_uid: _evaluated(item, depsgraph).hide_render
            for item in {item for item, _ in visible_things}
        }
        self.things = [
            placed
            for placed in visible_things
            if not self._hides[placed[0].session_uid] and not placed[0].get(OWNED)
        ]
        self.lights = [placed for placed in self.things if placed[0].type == "LIGHT"]
        self.solid = [placed for placed in self.things if placed[0].type in SOLID]
        self._makers = [placed for placed in self.things if _makes_instances(placed[0])]
        self.bounded = not self._makers
        # the lights that `shining` makes, which scene/lights.py reads; None when they are outdated
        self.instanced = None
        self.occluding = None
        self._reached: set[int] | None = None  # session_uids of what these lights depend on
        # objects that `depsgraph` does not hold have the values of the file's own data, which other
        # scenes and layers may change
        members = {
            item
            for item, _ in visible_things
            if depsgraph is not None and not item.evaluated_get(depsgraph).is_evaluated
        }
        self._elsewhere = [(item, item.hide_render) for item in members]
        homes = {block.instance_collection for _, inside in self.things for block in inside}
        self._offsets = {home.session_uid: tuple(home.instance_offset) for home in homes}
        # session_uid of an object -> the rows of `solid` that it is, or instances
        self._rows: dict[int, list[int]] = {}
        # solid objects of other view layers alone: this one's depsgraph reports none of their edits
        self._unwatched = set()
        for row, (item, inside) in enumerate(self.solid):
            for block in (item, *inside):
                self._rows.setdefault(block.session_uid, []).append(row)
                if depsgraph is not None and not block.evaluated_get(depsgraph).is_evaluated:
                    self._unwatched.add(row)
        self._moved = set(range(len(self.solid)))
        self._glowing = None
        self._ends = np.empty((len(self.solid), 2, 3))
        self._matrices = np.empty((len(self.solid), 4, 4))

    def lamps(self, depsgraph: bpy.types.Depsgraph | None) -> list[Placed]:
        """Return what casts shadows: lamps that are on, and glowing objects.

        Values are those that `depsgraph` has evaluated.
        """
        if self._glowing is None or self._unwatched:
            worn = [[slot.material for slot in item.material_slots] for item, _ in self.solid]
            materials = {each for materials_of_item in worn for each in materials_of_item} - {None}
            glowing = {
                material
                for material in materials
                if emits(_evaluated(material, depsgraph).node_tree)
            }
            self._glowing = [
                placed
                for placed, materials_of_item in zip(self.solid, worn, strict=True)
                if not glowing.isdisjoint(materials_of_item)
            ]
        return [
            placed for placed in self.lights if casts(_evaluated(placed[0], depsgraph).data)
        ] + self._glowing

    def shining(self, depsgraph: bpy.types.Depsgraph | None) -> set[bpy.types.Object]:
        """Return objects whose nodes, particles or instancing may make lights elsewhere.

        The children that they instance are included.
        """
        items = set()
        self._reached = set()
        for item, inside in self._makers:
            blocks = {item, *inside, *reached_blocks(item)}
            self._reached |= {block.session_uid for block in blocks}
            lamps = any(
                isinstance(block, bpy.types.Object) and block.type == "LIGHT" for block in blocks
            )
            materials = (block for block in blocks if isinstance(block, bpy.types.Material))
            if lamps or any(
                emits(_evaluated(material, depsgraph).node_tree) for material in materials
            ):
                items |= {
                    inside[0] if inside else item,
                    *(block for block in blocks if getattr(block, "parent", None) in blocks),
                }
        return items

    def within(self, collection: bpy.types.Collection | None) -> list[Placed]:
        """Return the things whose object is in the `collection`."""
        homes = () if collection is None else (collection, *collection.children_recursive)
        inside = {item for home in homes for item in home.objects}
        return [placed for placed in self.things if placed[0] in inside] if inside else []

    def box(self, depsgraph: bpy.types.Depsgraph) -> np.ndarray | None:
        """Return the bounding box (2, 3) of the solid things, world meters.

        None if not `bounded`. An empty box has least at inf and most at -inf.
        """
        if not self.bounded:
            return None
        if not self.solid:
            return np.array([np.full(3, np.inf), np.full(3, -np.inf)])
        for row in self._unwatched | self._moved:
            placed = self.solid[row]
            least, *_, most, _ = placed[0].evaluated_get(depsgraph).bound_box
            self._ends[row] = (tuple(least), tuple(most))
            self._matrices[row] = matrix_of(placed, depsgraph)
        self._moved = set()
        turn = self._matrices[:, :3, :3]
        ends = self._ends
        middle = np.einsum("nij,nj->ni", turn, ends.mean(axis=1)) + self._matrices[:, :3, 3]
        half = np.einsum("nij,nj->ni", np.abs(turn), (ends[:, 1] - ends[:, 0]) / 2)
        return np.array([(middle - half).min(axis=0), (middle + half).max(axis=0)])

    def holds(self) -> bool:
        """Return whether objects of other view layers exist and are shown as before.

        The depsgraph of this view layer does not report changes of these.
        """
        try:
            return all(item.hide_render == hides for item, hides in self._elsewhere)
        except ReferenceError:
            return False

    def notice(self, update: bpy.types.DepsgraphUpdate) -> bool:
        """Take over one `update` of the depsgraph; return whether that was possible.

        It is not if more than places and shapes changed. Then the Scenery must be made anew.
        """
        item = update.id
        kind = item.id_type  # several times as quick as isinstance
        if kind == "OBJECT":
            uid = item.original.session_uid
            if uid in self._rows:
                self.occluding = None
            if uid in self._hides and self._hides[uid] != item.hide_render:
                return False
            self._moved.update(self._rows.get(uid, ()))
            if self._reached is None or uid in self._reached:
                self.instanced = None
        else:
            self.occluding = None
        if kind == "COLLECTION":
            uid = item.original.session_uid
            offset = tuple(item.original.instance_offset)
            self.instanced = None
            if self._offsets.get(uid, offset) != offset:
                return False
        elif kind in ("MATERIAL", "NODETREE"):
            self._glowing = self.instanced = None
        elif kind in ("LIGHT", "PARTICLE"):
            self.instanced = None
        # an object that is added, removed or replaced changes its collection, too
        return kind != "SCENE"


def _evaluated(block: bpy.types.ID, depsgraph: bpy.types.Depsgraph | None) -> bpy.types.ID:
    return block if depsgraph is None else block.evaluated_get(depsgraph)


def _visible_things(
    scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None
) -> Iterator[Placed]:
    """Yield every object that a render of `scene` shows, once each.

    Objects in instanced collections come once for each instance. Objects hidden by themselves are
    included, those hidden by their collections are not.
    """
    items = {}
    for layer in scene.view_layers:
        if layer.use:
            items |= dict.fromkeys(_in_layer(layer.layer_collection))
    for item in items:
        yield from _with_instances(item, (), depsgraph)


def _in_layer(layer: bpy.types.LayerCollection) -> Iterator[bpy.types.Object]:
    if layer.collection.hide_render:
        return
    if not layer.exclude:
        yield from layer.collection.objects
    for child in layer.children:
        yield from _in_layer(child)


def _with_instances(
    item: bpy.types.Object, inside: tuple[bpy.types.Object, ...], depsgraph
) -> Iterator[Placed]:
    yield item, inside
    if item.instance_type != "COLLECTION" or item.instance_collection is None or item in inside:
        return
    if not _evaluated(item, depsgraph).hide_render:
        for part in dict.fromkeys(_in_collection(item.instance_collection)):
            yield from _with_instances(part, (*inside, item), depsgraph)


def _in_collection(collection: bpy.types.Collection) -> Iterator[bpy.types.Object]:
    """Yield what an instance of the `collection` shows.

    It does not use all_objects: Blender caches those, and after an undo some are gone.
    """
    if not collection.hide_render:
        yield from collection.objects
        for child in collection.children:
            yield from _in_collection(child)


def matrix_of(placed: Placed, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    """Return the evaluated world matrix (4, 4) float64 of `placed`."""
    item, inside = placed
    local = np.array([tuple(row) for row in item.evaluated_get(depsgraph).matrix_world])
    if not inside:
        return local
    matrix = np.eye(4)
    for instancer in inside:
        matrix = matrix @ np.array(instancer.evaluated_get(depsgraph).matrix_world, np.float64)
        matrix[:3, 3] -= matrix[:3, :3] @ np.array(instancer.instance_collection.instance_offset)
    return matrix @ local


def _makes_instances(item: bpy.types.Object) -> bool:
    """Return whether `item` may make instances outside its own bounding box.

    Instances of a collection do not count.
    """
    return item.instance_type not in ("NONE", "COLLECTION") or any(
        m.type in ("NODES", "PARTICLE_SYSTEM") for m in item.modifiers
    )


# What was last seen in each view layer that is played, by scene and name.
_kept = scene_cache.Bounded(8)


def scenery_of(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None) -> Scenery:
    """Return the Scenery of `scene`.

    It is the one of the frame before if `depsgraph` reports all changes since, as in the viewport.
    """
    if depsgraph is None or depsgraph.mode != "VIEWPORT" or depsgraph.scene != scene:
        return Scenery(scene, depsgraph)
    if (
        not _alone(note_frame, "frame_change_post")
        or note_edit not in bpy.app.handlers.depsgraph_update_post
    ):
        forget()
    note_frame(scene, depsgraph)  # what was changed since its last update, too
    key = scene.session_uid, depsgraph.view_layer_eval.name
    if key not in _kept or not _kept[key].holds():
        _kept[key] = Scenery(scene, depsgraph)
    return _kept[key]


def _alone(handler_of_ours, event: str) -> bool:
    """Return whether `handler_of_ours` handles the `event` and all its other handlers are ours.

    What handlers of others change in such an event, Blender evaluates without reporting it.
    """
    handlers = getattr(bpy.app.handlers, event)
    return handler_of_ours in handlers and all(map(is_ours, handlers))


@handler
def note_frame(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Handle frame_change_post: update the cached Scenery, or drop it."""
    key = scene.session_uid, depsgraph.view_layer_eval.name
    scenery = _kept.get(key)
    if (
        scenery is not None
        and depsgraph.mode == "VIEWPORT"
        and not all(map(scenery.notice, depsgraph.updates))
    ):
        _kept.pop(key, None)


@handler
def note_edit(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Handle depsgraph_update_post: update the cached Scenery, or drop the caches."""
    if _alone(note_edit, "depsgraph_update_post"):
        note_frame(scene, depsgraph)
    else:
        forget()


@handler
def forget(*_) -> None:
    """undo_pre, redo_pre: what is kept names objects that will be gone."""
    _kept.clear()
