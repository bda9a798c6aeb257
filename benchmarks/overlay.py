"""Redraws of the overlay against those of geometry-nodes instances.

Both of the same LOD meshes, in a real window, playing.

    blender --python benchmarks/overlay.py -- [OUT.json]

The extension must be enabled. Blender quits at the end.

Prints, for 10,000 and 100,000 agents, the milliseconds of a frame (set, planned, drawn, shown),
median and quartiles, of the empty window, the overlay and the build, taken in turns, and the ratio
of build to overlay: as they are, and less the empty window; the same of the overlay with all agents
at LOD 0, as without LODs. Likewise the processor's time, which on a software renderer is the whole
work and which other programs disturb less. Then how the overlay grows to 1,000,000 agents: LOD
meshes, boxes and points.
"""

import json
import statistics
import sys
import time
from pathlib import Path

import bpy

sys.path.append(str(Path(__file__).parent))
from in_window import begin, overlay  # noqa: E402

ARGUMENTS = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
# frames that do not count, those that do, how often
WARM = 2
FRAMES = 6
ROUNDS = 3
MOST_SECONDS = 30.0  # for the frames of a round
COUNTS = 10_000, 100_000, 1_000_000
RATIOS = 0.1, 0.02, 0.005  # of the sample's characters: some 1,100, 230 and 60 triangles


def session():
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    results = {}
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.crowd_lod.sample(name="chapter")
        scene = window.scene
        settings = scene.crowd_lod
        scene.collection.children["Scenery"].hide_viewport = True
        for k, ratio in reversed(list(enumerate(RATIOS))):
            settings.ratios[k] = ratio
        area.spaces[0].region_3d.view_perspective = "CAMERA"
    yield
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.crowd_lod.populate()
        bpy.ops.crowd_lod.make_levels("EXEC_DEFAULT")
    for count in COUNTS[:2]:
        settings.count = count
        settings.overlay = True
        settings.overlay_mode = "MESHES"
        yield from ready(scene)
        with bpy.context.temp_override(window=window, area=area, region=region):
            bpy.ops.crowd_lod.build("EXEC_DEFAULT")
        visible, way_times = yield from in_turns(scene, window)
        with bpy.context.temp_override(window=window, area=area, region=region):
            bpy.ops.crowd_lod.remove_build()
        results[f"{count} agents"] = compared(count, visible, way_times)
        yield
    settings.overlay = True
    for mode, counts in (("MESHES", (1_000_000,)), ("BOXES", COUNTS), ("POINTS", COUNTS)):
        for count in counts:
            settings.count = count
            settings.overlay_mode = mode
            yield
            entry = results[f"{count} {mode}"] = summary(measure(scene, window))
            said_each = ", ".join(f"{clock} {describe(times)}" for clock, times in entry.items())
            print(f"{count:,} agents as {mode.lower()}: {said_each}", flush=True)
    if ARGUMENTS:
        Path(ARGUMENTS[0]).write_text(json.dumps(results, indent=1), encoding="utf-8")


def in_turns(scene, window):
    """Play the built scene by the empty window, the overlay, the build, and at full detail.

    Returns (agents that the overlay shows, frames by name).
    """
    settings = scene.crowd_lod
    visible = 0
    top = settings.build
    times = {"empty": [], "overlay": [], "nodes": [], "full": []}
    thresholds = settings.thresholds[:]
    at_the_end = [0.99 + k / 1000 for k in range(len(thresholds))]  # of what the camera sees
    for _ in range(ROUNDS):
        for name, frames in times.items():
            if name == "full" and frames:  # one round takes long enough
                continue
            settings.overlay = name in ("overlay", "full")
            settings.thresholds = at_the_end if name == "full" else thresholds
            settings.build = top if name == "nodes" else None
            top.hide_viewport = name != "nodes"
            yield
            frames += measure(scene, window)
            if name == "overlay":
                visible = int(overlay().latest(scene).visible.sum())
    settings.build = top
    settings.thresholds = thresholds
    return visible, times


def compared(count: int, visible: int, times: dict[str, list]) -> dict:
    """Print and return what `in_turns` took, and its ratios to the overlay."""
    entry = {"visible": visible} | {name: summary(frames) for name, frames in times.items()}
    print(f"{count:,} agents, {visible:,} visible", flush=True)
    for clock in ("shown", "processor"):
        empty, overlay, *others = (entry[name][clock] for name in times)
        print(f"  {clock}: empty {describe(empty)}, overlay {describe(overlay)}", flush=True)
        for name, other in zip(("nodes", "full"), others, strict=True):
            ratio = other["median"] / overlay["median"]
            net = (other["median"] - empty["median"]) / (overlay["median"] - empty["median"])
            entry[f"{clock} {name} ratio"] = ratio
            entry[f"{clock} {name} ratio less empty"] = net
            print(f"    {name} {describe(other)}, x{ratio:.2f}, x{net:.2f} less empty", flush=True)
    return entry


def ready(scene):
    """Wait until the viewport shows LOD meshes."""
    began = time.monotonic()
    while (
        not (overlay().display_of(scene) and overlay().display_of(scene).bodies)
        and time.monotonic() - began < 60
    ):
        redraw()
        yield


def measure(scene, window) -> list[tuple[float, float]]:
    """Milliseconds (until shown, of the processor) of frames that are played."""
    times = []
    began = time.monotonic()
    for number in range(WARM + FRAMES):
        start = time.perf_counter()
        work = time.process_time()
        scene.frame_set(2 + number)
        with bpy.context.temp_override(window=window):
            redraw()
        if number >= WARM:
            times.append(
                (1000 * (time.perf_counter() - start), 1000 * (time.process_time() - work))
            )
        if len(times) >= 2 and time.monotonic() - began > MOST_SECONDS:
            break
    return times


def summary(frames: list[tuple[float, float]]) -> dict:
    """Medians and quartiles of what `measure` took."""
    clocks = {}
    for name, times in zip(("shown", "processor"), zip(*frames, strict=True), strict=True):
        low, median, high = statistics.quantiles(times, n=4)
        clocks[name] = {"median": median, "quartiles": [low, high], "frames": len(times)}
    return clocks


def redraw():
    """Draw the window and wait for it."""
    bpy.ops.wm.redraw_timer(type="DRAW_WIN_SWAP", iterations=1)


def describe(times: dict) -> str:
    low, high = times["quartiles"]
    return f"{times['median']:.1f} ms ({low:.1f} to {high:.1f})"


begin(session())
