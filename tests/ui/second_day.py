"""The second day of docs/tutorial.md's shot, after the director's change.

Another lens and path, fewer frames, a wall; one agent overridden, one deleted, a budget; then the
proof, and all that the panel Hand Over makes without OpenUSD. `perform` goes on where the tutorial ends, in its window.
"""

import sys
import time
from pathlib import Path

import bpy
import robot
from robot import scene, settings

HANDED_OVER = "bake", "write_farm_job"  # this Blender comes without OpenUSD
TICK = 0.01  # seconds between two looks whether the window answers
pressed = []
freezes = {}


class Watch:
    """Notes the longest time in which Blender answered nothing, but for renders.

    In processor seconds of Blender's own thread: neither other processes nor the threads of
    software OpenGL count.
    """

    def __init__(self):
        self._longest = 0.0
        self._stopped = False
        self._last = self._render = time.thread_time()
        bpy.app.handlers.render_init.append(self._begin_render)
        bpy.app.handlers.render_complete.append(self._end_render)
        bpy.app.timers.register(self._tick)

    def _begin_render(self, *_):
        self._render = time.thread_time()

    def _end_render(self, *_):
        self._last += time.thread_time() - self._render

    def _tick(self):
        now = time.thread_time()
        self._longest = max(self._longest, now - self._last)
        self._last = now
        return None if self._stopped else TICK

    def stop(self) -> float:
        self._stopped = True
        bpy.app.handlers.render_init.remove(self._begin_render)
        bpy.app.handlers.render_complete.remove(self._end_render)
        return round(self._longest, 3)


def press(button: str, **properties):
    watch = Watch()
    status = yield from robot.press(f"crowd_lod.{button}", **properties)
    yield from robot.drawn()
    print(f"--- {button} {time.process_time():.0f} s", flush=True)
    pressed.append(button)
    freezes[f"{len(pressed)} {button}"] = watch.stop()
    return status


def perform(folder: Path):
    """Yields the seconds to wait before going on; returns what the tests judge."""
    change_lens_and_path()
    scene().frame_end -= 1
    found_wall = yield from wall()
    yield from robot.picture("8_other_path")
    found = {"due": list(due()), "wall": found_wall, "changed": (yield from press("update_all"))}
    yield from robot.picture("9_updated")
    first, second = seen_agents()
    found["override"] = yield from override(first, "ALWAYS")
    found["delete"] = yield from override(second, "HIDE")
    yield from robot.picture("10_overridden")
    settings().budget_triangles = round(0.9 * most_triangles())
    yield from robot.picture("11_budget")
    found["again"] = yield from press("update_all")
    yield from robot.picture("12_updated_again")
    found["agents"] = built_agents()
    found["overridden"] = [first, second]
    found["triangles"] = most_triangles()
    found["budget"] = settings().budget_triangles
    found["nothing due"] = not due()
    found["proof"] = yield from press("verify")
    found["verdict"] = bpy.data.images["Crowd LOD Proof"].packed_file is not None and verdict()
    yield from robot.picture("13_proof")
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "shot.blend"))
    found["lacks"] = [lack.sentence for name in HANDED_OVER for lack in lacks(f"crowd_lod.{name}")]
    for name in ("estimate", *HANDED_OVER):
        found[name] = yield from press(name)
    yield from robot.picture("14_handed_over")
    found["job"] = sorted(path.name for path in (folder / "output" / "farm").iterdir())
    return found | {"pressed": pressed, "freezes": freezes}


def change_lens_and_path():
    camera = scene().camera
    camera.data.lens = 38
    for frame, x in ((1, 0.0), (scene().frame_end, 2.5)):
        camera.location.x += x
        camera.keyframe_insert("location", frame=frame)


def wall():
    """The default cube in the crowd's middle again, which agents are led around."""
    block = bpy.data.objects.new("Block", bpy.data.meshes["Cube"])
    scene().collection.objects.link(block)
    for item in scene().objects:
        item.select_set(item == block, view_layer=robot.window().view_layer)
    return (yield from press("walls_from_selection"))


def seen_agents() -> list[int]:
    """Two agents that the build shows at its coarsest LOD."""
    return built_agents()[-1][:2]


def built_agents() -> list[list[int]]:
    """The agents that the camera sees in each LOD of the build."""
    seen = [item for item in settings().build.objects if item.visible_camera]
    seen.sort(key=lambda item: item["crowd_lod_level"])
    return [[entry.value for entry in item.data.attributes["id"].data] for item in seen]


def override(agent: int, kind: str):
    settings().agent = agent
    status = yield from press("override_agent", type=kind)
    settings().overrides[settings().override_index].level = 0
    return status


def most_triangles() -> int:
    """Triangles that the frame draws."""
    return robot.overlay().latest(scene()).triangles


def verdict() -> str:
    """What the last proof found."""
    proof = sys.modules[f"{robot.MODULE}.operators.freshness.artifacts"].current_proof(scene())
    return proof.sentence if proof else ""


def lacks(operator: str) -> list:
    """What the panel Hand Over says that an output needs."""
    return sys.modules[f"{robot.MODULE}.operators.deliver.hand_over"].lacks_of(scene(), operator)


def due() -> dict:
    """The steps that Update All would do."""
    return sys.modules[f"{robot.MODULE}.operators.deliver.update_all"].due_steps(scene())
