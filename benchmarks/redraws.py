"""What the overlay adds to a redraw of the viewport while the camera moves.

It shows 10,000 agents of the plaza, in a real window.

    blender --python benchmarks/redraws.py

The extension must be enabled. Blender quits at the end.

Takes redraws without the overlay, with points and with boxes in turns. Prints the median and the
95th percentile, in milliseconds, of the overlay's own part (Python, and with what it gives the
GPU), of the processor's time for it, and of the whole redraw, most of which is Blender's. The GPU
is waited for before and after the overlay's part, by reading one pixel, so that it is charged for
its own work alone.
"""

import statistics
import sys
import time
from pathlib import Path

import bpy
import gpu

sys.path.append(str(Path(__file__).parent))
from in_window import begin, overlay  # noqa: E402

ROUNDS = 4
REDRAWS = 10
WARM = 2
MODES = "OFF", "POINTS", "BOXES"
STEP = 0.05  # meters that the camera moves from one redraw to the next


def session():
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.crowd_lod.sample(name="plaza")
        bpy.ops.crowd_lod.populate()
    area.spaces[0].region_3d.view_perspective = "CAMERA"
    print(gpu.platform.renderer_get(), region.width, "x", region.height, flush=True)
    parts = timed()
    settings = window.scene.crowd_lod
    camera = window.scene.camera
    times = {mode: {} for mode in MODES}
    for _ in range(ROUNDS):
        for mode in MODES:
            settings.overlay = mode != "OFF"
            if settings.overlay:
                settings.overlay_mode = mode
            yield
            for number in range(WARM + REDRAWS):
                camera.location.x += STEP if number % 2 else -STEP
                window.view_layer.update()
                parts.clear()
                began = time.perf_counter()
                with bpy.context.temp_override(window=window, area=area, region=region):
                    bpy.ops.wm.redraw_timer(type="DRAW_SWAP", iterations=1)
                parts["whole redraw"] = 1000 * (time.perf_counter() - began)
                for name, value in parts.items() if number >= WARM else ():
                    times[mode].setdefault(name, []).append(value)
    for mode, by_part in times.items():
        print(
            mode,
            "; ".join(f"{name} {describe(values)}" for name, values in by_part.items()),
            flush=True,
        )


def timed() -> dict[str, float]:
    """Have the overlay's draw handlers note their milliseconds in a dict, which is returned."""
    state = overlay()
    noted: dict[str, float] = {}

    def noting(part):
        def draw(context):
            finish()
            began = time.perf_counter()
            work = time.process_time()
            part(context)
            python = time.perf_counter()
            finish()
            ends = (
                ("Python", python - began),
                ("with the GPU", time.perf_counter() - began),
                ("CPU", time.process_time() - work),
            )
            for name, seconds in ends:
                noted[name] = noted.get(name, 0.0) + 1000 * seconds

        return draw

    space = bpy.types.SpaceView3D
    while state._handlers:
        space.draw_handler_remove(state._handlers.pop(), "WINDOW")
    for part, when in ((state._draw_crowd, "POST_VIEW"), (state._draw_figures, "POST_PIXEL")):
        state._handlers.append(space.draw_handler_add(state._draw, (noting(part),), "WINDOW", when))
    return noted


def finish() -> None:
    """Wait for the GPU."""
    gpu.state.active_framebuffer_get().read_color(0, 0, 1, 1, 4, 0, "FLOAT")


def describe(values: list[float]) -> str:
    return f"{statistics.median(values):.1f} ({statistics.quantiles(values, n=20)[-1]:.1f})"


begin(session())
