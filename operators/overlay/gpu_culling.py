"""Culling, LOD assignment and LOD sorting in compute shaders, as in the chapter.

The results equal NumPy's to the bit, although the GPU has only float32. The GPU decides an agent
only if no rounding can move it to the other side of a plane or of a LOD's border. The others, about
ten in a million, go into a bucket of their own, the open one. `radar` and `assign` then decide
those on the CPU. Positions are uploaded relative to the area's middle, once for all cameras that
look at the same crowd.

Blender's gpu module has no storage buffers, no indirect draws and no memory shared between threads.
So agents are uploaded as textures, runs of agents are summed in several passes, and the order is
read back.
"""

import statistics
import sys
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from ...crowd_lod.crowd.agents import Crowd
from ...crowd_lod.culling.frustum import frustum_of
from ...crowd_lod.culling.radar import RadarOptions, radar
from ...crowd_lod.errors import CrowdError
from ...crowd_lod.frame.frame import Frame, plan_of
from ...crowd_lod.frame.request import Request
from ...crowd_lod.frame.stages import Unsorted
from ...crowd_lod.levels.assignment import assign
from ...crowd_lod.sources.trajectory import Trajectory
from .shader_programs import TEXELS, source

if TYPE_CHECKING:
    from gpu.types import GPUShader, GPUTexture

RUN = 64  # agents that a thread takes
PART = 256  # counts that a thread sums
THREADS = 64  # in a work group
# Far more than all roundings of float32: some ten of them, each 2 ** -24 of the terms' sizes.
SLACK = 2.0**-19
# Meters; no slack is smaller, since float32 would lose the square of a smaller one.
HUGE = 1e15
TINY = 1e-20
# Each way is tried for so many frames, if a plan takes at least so many milliseconds.
TRIES = 4
WORTH = 1.0

PLAN = "struct CrowdPlan { vec4 planes[6]; vec4 axis; vec4 origin; vec4 slack; };"
# The passes in their order: the textures that each reads and writes, and its constants.
PASSES = {
    "levels": (
        ("agents", "spheres", "feet_x", "feet_y", "feet_z"),
        ("kinds", "counts"),
        ("runs", "count"),
    ),
    "sums": (("counts",), ("sums",), ("total",)),
    "offsets": (("counts", "sums"), ("offsets",), ("total",)),
    "sorting": (("kinds", "offsets"), ("places",), ("runs", "count")),
}


@cache
def program(name: str, levels: int, radial: bool) -> "GPUShader":
    """Return the compute shader of a pass.

    name: a key of PASSES.
    levels: number of LODs.
    radial: measure the distance from the camera (True), or along the view axis (False).
    """
    from gpu import shader
    from gpu.types import GPUShaderCreateInfo

    info = GPUShaderCreateInfo()
    numbers = {
        "TEXELS": TEXELS,
        "RUN": RUN,
        "PART": PART,
        "OPEN": levels,
        "CULLED": levels + 1,
        "RADIAL": int(radial),
    }
    for key, value in numbers.items():
        info.define(key, str(value))
    reads, writes, constants = PASSES[name]
    for slot, buffer in enumerate(reads):
        info.sampler(slot, "FLOAT_2D" if name == "levels" else "UINT_2D", buffer)
    for slot, buffer in enumerate(writes):
        info.image(slot, "R32UI", "UINT_2D", buffer, qualifiers={"WRITE"})
    for buffer in constants:
        info.push_constant("INT", buffer)
    if name == "levels":
        info.typedef_source(PLAN)
        info.uniform_buf(0, "CrowdPlan", "view")
    info.local_group_size(THREADS)
    info.compute_source(source("texel.glsl", f"{name}.comp.glsl"))
    return shader.create_from_info(info)


class Planner:
    """Culls and sorts a trajectory's frames on the GPU: a `sorter` for frame.plan_of.

    Needs a GPU context. Keeps what it uploaded for the next frame.
    """

    def __init__(self, trajectory: Trajectory):
        area = trajectory.area
        self.middle = np.array(
            [(area.x_min + area.x_max) / 2, (area.y_min + area.y_max) / 2, area.z]
        )
        self.spheres = trajectory.spheres.center, trajectory.spheres.reach
        self._agents = None
        self._asked = (None, None)
        self._places = {}
        self._columns = (None,) * 3

    def __call__(self, request: Unsorted) -> tuple[np.ndarray, np.ndarray]:
        """Return (places, offsets) of the visible agents' buckets.

        They are those of frame/stages.py, Sorter: places (m,) int32, offsets (n + 1,).
        """
        from gpu.types import Buffer, GPUUniformBuf

        count = len(request.crowd)
        levels = request.policy.count
        self._upload(request.crowd, request.order)
        view, spheres = _inputs(self.middle, self.spheres, request)
        runs = -(-count // RUN)
        total = (levels + 1) * runs + 1  # counts, and where all end
        sizes = {
            "kinds": count,
            "counts": total,
            "sums": -(-total // PART),
            "offsets": total,
            "places": count,
        }
        textures = {name: _texture(size) for name, size in sizes.items()}
        textures |= self._places | {
            "agents": self._agents,
            "spheres": _texture(spheres.size // 4, "RGBA32F", spheres),
        }
        view = GPUUniformBuf(Buffer("FLOAT", view.size, view))
        numbers = {"runs": runs, "count": count, "total": total}
        radial = request.policy.metric == "RADIAL"
        for name in PASSES:
            threads = runs if "runs" in PASSES[name][2] else sizes["sums"]
            dispatch_pass(program(name, levels, radial), name, threads, textures, view, numbers)
        ends = _read(textures["offsets"], total)[::runs].astype(np.intp)
        places = _read(textures["places"], count)[: ends[-1]]
        return settle_open_agents(places, ends, self.spheres, request)

    def _upload(self, crowd: Crowd, order: np.ndarray | None) -> None:
        """Upload the columns that have changed since the last call."""
        inputs = order, crowd.group
        if any(new is not old for new, old in zip(inputs, self._asked, strict=True)):
            agents = np.empty((len(crowd), 2), np.float32)
            agents[:, 0] = np.arange(len(crowd)) if order is None else order
            agents[:, 1] = crowd.group if order is None else crowd.group[order]
            self._agents = _texture(len(crowd), "RG32F", agents)
            self._asked = inputs
        columns = crowd.x, crowd.y, crowd.z
        for axis, new, old, at in zip("xyz", columns, self._columns, self.middle, strict=True):
            if new is not old:
                with np.errstate(over="ignore", invalid="ignore"):
                    self._places[f"feet_{axis}"] = _texture(len(new), "R32F", new, at)
        self._columns = columns


def _inputs(middle, spheres: tuple, request: Unsorted) -> tuple[np.ndarray, np.ndarray]:
    """Return (the shader's CrowdPlan (36,), spheres (G * n, 4)), both float32.

    CrowdPlan: planes, view axis and origin relative to `middle` (3,), and the slack for rounding.
    spheres: n rows per group. The first row holds the height of the center, the reach, and |height|
        + reach. Row k holds where LOD k begins.
    """
    center, radius = spheres
    camera = request.camera
    policy = request.policy
    frustum = frustum_of(camera)
    reach = camera.pad + (radius if policy.margin is None else np.zeros_like(radius))
    normals = np.vstack([frustum.normals, camera.Z])
    origin = camera.origin - middle
    offsets = np.append(frustum.limits(policy.margin), 0.0) + normals @ origin
    begin = np.clip(request.begins, -HUGE, HUGE)
    largest = (
        np.abs(offsets).max()
        + np.abs(origin).sum()
        + np.abs(begin[np.abs(begin) < HUGE]).max(initial=0.0)
    )
    slack = SLACK * max(1.0, frustum.rounding) * (1 + np.abs(camera.Z).sum())
    most = slack * largest + camera.grain * (np.abs(middle).sum() + 2 * np.abs(camera.origin).sum())
    view = np.zeros((9, 4), np.float32)
    view[:7, :3] = normals
    view[:7, 3] = offsets
    view[7, :3] = origin
    view[8, :2] = (slack + camera.grain, most + TINY)
    rows = np.zeros((len(radius), policy.count, 4), np.float32)
    rows[:, 0, :3] = np.column_stack([center, reach, np.abs(center) + reach])
    rows[:, 1:, 0] = begin
    return view.ravel(), rows.reshape(-1, 4)


def _texture(
    count: int, form: str = "R32UI", values: np.ndarray | None = None, middle: float = 0.0
) -> "GPUTexture":
    """Return a texture of `count` texels, TEXELS to a row.

    values: (count,) or (count, k), stored in float32 less `middle`; None leaves the texture unset.
    """
    from gpu.types import Buffer, GPUTexture

    size = TEXELS, max(1, -(-count // TEXELS))
    if values is None:
        return GPUTexture(size, format=form)
    texels = np.zeros((size[0] * size[1], *values.shape[1:]), np.float32)
    np.subtract(values, middle, out=texels[:count], dtype=np.float64, casting="same_kind")
    return GPUTexture(size, format=form, data=Buffer("FLOAT", texels.size, texels))


def dispatch_pass(
    shader, name: str, threads: int, textures: dict, view, numbers: dict[str, int]
) -> None:
    from gpu.compute import dispatch

    reads, writes, constants = PASSES[name]
    shader.bind()
    for buffer in reads:
        shader.uniform_sampler(buffer, textures[buffer])
    for buffer in writes:
        shader.image(buffer, textures[buffer])
    for buffer in constants:
        shader.uniform_int(buffer, numbers[buffer])
    if name == "levels":
        shader.uniform_block("view", view)
    dispatch(shader, -(-threads // THREADS), 1, 1)


def _read(texture, count: int) -> np.ndarray:
    """Return the first `count` numbers of an R32UI texture, int32."""
    return np.asarray(memoryview(texture.read())).ravel()[:count].view(np.int32)


def settle_open_agents(
    places, ends, spheres: tuple, request: Unsorted
) -> tuple[np.ndarray, np.ndarray]:
    """Decide the agents of the open bucket and return (places, offsets) with them.

    places: (m,) places of agents in the planner's order, bucket after bucket.
    ends: (n + 2,), starts with 0; bucket k is places[ends[k]:ends[k + 1]], and the last bucket is
        the open one.
    """
    undecided = places[ends[-2] :]
    places = places[: ends[-2]]
    offsets = ends[:-1]
    if not len(undecided):
        return places, offsets
    crowd = request.crowd
    policy = request.policy
    agents = undecided if request.order is None else request.order[undecided]
    options = RadarOptions(policy.margin, policy.metric == "RADIAL")
    visible, distance = radar(crowd, request.camera, *spheres, options, agents)
    levels = assign(distance, request.begins, crowd.group[agents])
    buckets = []
    for level, (first, last) in enumerate(zip(offsets[:-1], offsets[1:], strict=True)):
        more = undecided[visible & (levels == level)]
        buckets.append(
            np.insert(places[first:last], np.searchsorted(places[first:last], more), more)
        )
    return np.concatenate(buckets), np.cumsum([0, *map(len, buckets)])


class Faster:
    """Plans frames on the GPU or with NumPy, whichever measured faster for the crowd.

    Both give the same frame. A software renderer is not tried: it runs on the CPU and takes many
    times as long. A driver that failed is not tried again.

    usable: whether the GPU may be tried; None if not known yet.
    """

    def __init__(self, usable: bool | None = None):
        self.usable = usable
        self.clear()

    def clear(self) -> None:
        """Drop everything on the GPU: the planner's textures and the compiled programs."""
        self._trajectory = self._planner = None
        program.cache_clear()

    def plan_of(self, trajectory: Trajectory, request: Request) -> Frame:
        """Return frame.plan_of(trajectory, request), made the faster way."""
        import gpu

        if self.usable is None:
            self.usable = gpu.platform.device_type_get() != "SOFTWARE"
        if self._trajectory is not trajectory:
            self._trajectory = trajectory
            self._planner = Planner(trajectory)
            self._took = [], []
        on_gpu = self.usable and worth_the_gpu(*self._took)
        try:
            frame = plan_of(trajectory, request, self._planner if on_gpu else None)
        except Exception as error:  # whatever a driver makes of compute shaders, NumPy plans on
            if isinstance(error, CrowdError) or not on_gpu:
                raise
            print(
                f"Crowd LOD plans frames on the CPU from now on, because the GPU failed: {error}",
                file=sys.stderr,
            )
            self.usable = on_gpu = False
            frame = plan_of(trajectory, request)
        took = self._took[on_gpu]
        took.append(sum(ms for stage, ms in frame.milliseconds.items() if stage != "behavior"))
        del took[:-TRIES]
        return frame


def worth_the_gpu(cpu_seconds: list[float], there: list[float]) -> bool:
    """Return whether to make the next plan on the GPU.

    False while plans without the GPU take less than WORTH milliseconds. Compares medians, so that
    the slow first plan of each way (it builds blocks or compiles) does not decide.

    cpu_seconds, there: milliseconds of the last plans without and with the GPU.
    """
    if len(cpu_seconds) < TRIES or statistics.median(cpu_seconds) < WORTH:
        return False
    return len(there) < TRIES or statistics.median(there) < statistics.median(cpu_seconds)
