"""What renders of a file take: a script of its own, for a Blender that need not know Crowd LOD.

Its arguments, after "--" or alone: the .blend file, its frames as 1,5,9, and the .json file to
write. Each frame is rendered to an EXR beside that. The .json tells the seconds of all frames, of
the clock (`wall_s`) and of all processors (`cpu_s`), and the largest memory of the process,
`peak_mb`, None where the system does not tell it.
"""

import json
import sys
import time
from pathlib import Path

import bpy


def peak_mb() -> float | None:
    """Return the largest memory that this process has had, MB; None where that is not known."""
    status = Path("/proc/self/status")
    if status.exists():  # Linux's getrusage begins with the peak of the process that started this
        line = next(x for x in status.read_text().splitlines() if x.startswith("VmHWM"))
        return float(line.split()[1]) / 1e3
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)


def measure(file: str, frames: list[int], result: Path) -> None:
    """Render the `frames` of the `file`, and write what that took to `result`."""
    bpy.ops.wm.open_mainfile(filepath=file, load_ui=False)
    scene = bpy.context.scene
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    wall, processors = time.perf_counter(), time.process_time()
    for frame in frames:
        scene.frame_set(frame)
        scene.render.filepath = str(result.with_name(f"{result.stem}_{frame}.exr"))
        bpy.ops.render.render(write_still=True)
    taken = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - processors}
    result.write_text(json.dumps({**taken, "peak_mb": peak_mb()}))


if __name__ == "__main__":
    own = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    measure(own[0], [int(frame) for frame in own[1].split(",")], Path(own[2]))
