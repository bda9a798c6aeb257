"""Redraws of the overlay against those of geometry-nodes instances of the same LOD meshes, in a real window, playing.

blender --python benchmarks/overlay.py -- [OUT.json]    with the extension enabled; it quits when it is done

Prints, for 10,000 and 100,000 agents, the milliseconds of a frame (set, planned, drawn, shown): median and quartiles of
the overlay and of the build, and their ratio; then the overlay's boxes and points up to 1,000,000 agents.
"""

import json
import statistics
import sys
import time
from pathlib import Path

import bpy

ARGUMENTS = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
WARM, FRAMES, MOST_SECONDS = 2, 15, 60.0  # frames before those that count, those that count, seconds for them
RATIOS = 0.1, 0.02, 0.005  # of the sample's characters: some 1,100, 230 and 60 triangles


def session():
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    found = {}
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
    for count in (10_000, 100_000):
        settings.count, settings.overlay, settings.overlay_mode = count, True, "MESHES"
        yield from ready(scene)
        drawn = measure(scene, window)
        settings.overlay = False
        with bpy.context.temp_override(window=window, area=area, region=region):
            bpy.ops.crowd_lod.build("EXEC_DEFAULT")
        yield
        built = measure(scene, window)
        with bpy.context.temp_override(window=window, area=area, region=region):
            bpy.ops.crowd_lod.remove_build()
        ratio = built["median"] / drawn["median"]
        visible = int(overlay().latest(scene).visible.sum()) if overlay().latest(scene) else None
        found[f"{count} agents"] = {"overlay": drawn, "nodes": built, "ratio": ratio, "visible": visible}
        print(f"{count:9,} agents: overlay {said(drawn)}, nodes {said(built)}, x{ratio:.2f}", flush=True)
        yield
    settings.overlay = True
    for mode in ("BOXES", "POINTS"):
        for count in (10_000, 100_000, 1_000_000):
            settings.count, settings.overlay_mode = count, mode
            yield
            times = found[f"{count} {mode}"] = measure(scene, window)
            print(f"{count:9,} agents as {mode.lower()}: {said(times)}", flush=True)
    if ARGUMENTS:
        Path(ARGUMENTS[0]).write_text(json.dumps(found, indent=1), encoding="utf-8")


def overlay():
    return next(module for name, module in sys.modules.items() if name.endswith(".operators.overlay"))


def ready(scene):
    """Wait until the viewport shows LOD meshes."""
    began = time.monotonic()
    while not (overlay().shown_of(scene) and overlay().shown_of(scene).cast) and time.monotonic() - began < 60:
        redraw()
        yield


def measure(scene, window) -> dict:
    """Milliseconds of frames played one after the other."""
    times, began = [], time.monotonic()
    for number in range(WARM + FRAMES):
        start = time.perf_counter()
        scene.frame_set(2 + number)
        with bpy.context.temp_override(window=window):
            redraw()
        if number >= WARM:
            times.append(1000 * (time.perf_counter() - start))
        if len(times) >= 3 and time.monotonic() - began > MOST_SECONDS:
            break
    low, median, high = statistics.quantiles(times, n=4)
    return {"median": median, "quartiles": [low, high], "frames": len(times)}


def redraw():
    """Draw the window and wait for it."""
    bpy.ops.wm.redraw_timer(type="DRAW_WIN_SWAP", iterations=1)


def said(times: dict) -> str:
    low, high = times["quartiles"]
    return f"{times['median']:.1f} ms ({low:.1f} to {high:.1f})"


def go_on(steps):
    def tick():
        try:
            next(steps)
            return 0.5
        except StopIteration:
            bpy.ops.wm.quit_blender()

    return tick


bpy.context.preferences.view.show_splash = False
bpy.app.timers.register(go_on(session()), first_interval=1.0, persistent=True)
