"""Steps at work: what they rest on, the slices that they are taken in, and how they end.

While a step works the user looks and does not touch (see `looking`). What scripts and other
add-ons do meanwhile is looked for here, after each slice.
"""

from collections.abc import Callable, Generator
from typing import Any

import bpy

from ...crowd_lod.errors import CrowdError
from . import collection_caches, removal, sidebars
from .callbacks import handler


class Inputs:
    """What a step of `scene` rests on: the scene, its characters and their data."""

    def __init__(self, scene: bpy.types.Scene):
        self.scene = scene
        self.name = scene.name
        self.items = _items_of(scene)

    def change(self) -> str:
        """Return in words what has changed since; "" if all is as it was."""
        if not removal.is_there(self.scene):
            return f"the scene {self.name} was deleted"
        now = _items_of(self.scene)
        if now == self.items:
            return ""
        for uid, before in self.items.items():
            if uid not in now:
                return f"{before[0]} was deleted, or is no character any longer"
            if now[uid] != before:
                return f"{before[0]} was changed"
        return "characters were added"


def _items_of(scene: bpy.types.Scene) -> dict[int, tuple]:
    """Return of each character's object what steps take to stay, by its session_uid.

    That is its name, its mode, its data and how much is in it, and what it plays.
    """
    characters = scene.crowd_lod.characters
    items = () if characters is None else characters.all_objects
    return {item.session_uid: _marks(item) for item in items}


def _marks(item: bpy.types.Object) -> tuple:
    data = item.data
    animation = item.animation_data
    size: tuple[int, ...] = ()
    if item.type == "MESH":
        size = len(data.vertices), len(data.polygons)
    elif item.type == "ARMATURE":
        size = (len(data.bones),)
    action = animation and animation.action
    return (
        item.name,
        item.mode == "EDIT",
        data and data.session_uid,
        size,
        action and action.session_uid,
    )


def leave_edit_mode(scene: bpy.types.Scene) -> list[str]:
    """Leave the Edit Mode of the characters of `scene`; return the names of those that were in it.

    Their edits are then in their data. CrowdError if one of them stays in it.
    """
    characters = scene.crowd_lod.characters
    items = [] if characters is None else characters.all_objects
    edited = [item for item in items if item.mode == "EDIT"]
    for item in edited:
        if item.mode != "EDIT":  # it left together with one before it
            continue
        homes = [each for each in scene.view_layers if item.name in each.objects]
        for layer in homes:
            layer.objects.active = item
            with bpy.context.temp_override(
                scene=scene, view_layer=layer, object=item, active_object=item
            ):
                if bpy.ops.object.mode_set.poll():
                    bpy.ops.object.mode_set(mode="OBJECT")
        if item.mode == "EDIT":
            raise CrowdError(f"{item.name} is in Edit Mode: leave it (Tab), and press again.")
    return [item.name for item in edited]


class Slices:
    """A step, taken a slice at a time.

    scene: what it works for, whatever windows show meanwhile.
    """

    def __init__(self, label: str, scene: bpy.types.Scene, work: Callable[[bpy.types.Scene], Any]):
        self.label = label
        self.scene = scene
        self.progress = 0.0
        self.is_inside = False  # a slice is being taken now
        self._inputs = Inputs(scene)
        self._latest = removal.latest()
        self._steps: Generator[float, None, str] = work(scene)

    def take(self, is_over: Callable[[], bool] = lambda: True) -> None:
        """Take steps until `is_over()`, and note the progress.

        StopIteration with the step's message at its end. CrowdError if what it rests on was
        changed since the last slice; the step's own cleanup then leaves the scene as it was.
        """
        self.is_inside = True
        try:
            removal.note_others(self._latest)
            if change := self._inputs.change():
                self._steps.close()
                raise CrowdError(f"{self.label} was stopped, as {change}: press it again.")
            while True:
                self.progress = next(self._steps)
                if is_over():
                    break
            self._latest = removal.latest()
        except ReferenceError as error:
            raise CrowdError(
                f"{self.label} was stopped, as something that it reads was deleted: press it again."
            ) from error
        finally:
            self.is_inside = False

    def close(self) -> None:
        """End the step early, or after its end: its own cleanup leaves the scene as it was."""
        try:
            self._steps.close()
        except ReferenceError:  # its cleanup found something gone; the rest of it is done
            pass
        removal.forget_others()
        collection_caches.renew()  # the work removed data-blocks that collections may remember

    def __iter__(self) -> Generator[float, None, str]:
        """Yield the progress after each step, and return the step's message."""
        try:
            while True:
                try:
                    self.take()
                except StopIteration as end:
                    return end.value
                yield self.progress
        finally:
            self.close()


class Step:
    """The step at work in a window: how Blender shows it, and how to end it.

    name: the bl_idname of its operator. dropped: why it was ended early, in words; "" if it is not.
    renders: whether it renders; viewports then show the build alone, without the overlay.
    doing: the bl_idname of the operator whose work it does now: of Update All that of a step.
    """

    def __init__(self, name: str, slices: Slices, renders: bool, window: bpy.types.Window):
        self.name = self.doing = name
        self.slices = slices
        self.renders = renders
        self.dropped = ""
        self.status = ""
        self._workspace = window.workspace
        manager = bpy.context.window_manager
        self._timer = manager.event_timer_add(0.01, window=window)
        manager.progress_begin(0, 100)
        _at_work.append(self)
        self.show(f"{slices.label}: Esc cancels")

    def show(self, status: str) -> None:
        """Show the text in the status bar, and the progress everywhere, where it is another."""
        if status == self.status:
            return
        self.status = status
        bpy.context.window_manager.progress_update(100 * self.slices.progress)
        if removal.is_there(self._workspace):
            self._workspace.status_text_set(status)
        sidebars.redraw()

    def end(self, reason: str = "") -> None:
        """End the step, early for a reason in words such as "was canceled"; once."""
        if self not in _at_work:
            return
        _at_work.remove(self)
        self.dropped = reason
        self.slices.close()
        manager = bpy.context.window_manager
        manager.event_timer_remove(self._timer)
        manager.progress_end()
        if removal.is_there(self._workspace):
            self._workspace.status_text_set(None)
        sidebars.redraw()


_at_work: list[Step] = []  # one at most


def at_work() -> Step | None:
    """Return the step at work in a window, or None."""
    return _at_work[0] if _at_work else None


def note_doing(operator: str) -> None:
    """Note whose work the step at work does now, if one is."""
    for step in _at_work:
        step.doing = operator


def renders() -> bool:
    """Return whether the step at work renders: viewports then show the build alone."""
    return bool(_at_work) and _at_work[0].renders


def end_all(reason: str) -> None:
    """End the step that is at work, unless it is this step itself that asks, in a slice."""
    for step in _at_work[:]:
        if not step.slices.is_inside:
            step.end(reason)


@handler
def stop_for_undo(*_) -> None:
    """End the step before data changes under it (undo_pre, redo_pre handler)."""
    end_all("was stopped by the undo")


@handler
def stop_for_file(*_) -> None:
    """End the step before another file is opened (load_pre handler)."""
    end_all("was stopped, as another file was opened")


@handler
def stop_for_saving(*_) -> None:
    """End the step before the file is saved: it would hold what is half made (save_pre handler)."""
    end_all("was stopped, as the file was saved")
