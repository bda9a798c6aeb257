"""What `bench` measures: a row of numbers for each size of the crowd.

Test 1, the stages beside other ways to do the same; test 2, the plan from two perspectives, and the
same drawn; the whole frame beside geometry nodes; behavior on the plaza's map; growth. Columns that
end in " q1" and " q3" hold the quartiles of the column of that name, a median.
"""

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import drawn
import loop
import numpy as np
import peers
import walkers
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset
from crowd_lod_extension.crowd_lod.culling.camera import Camera, Window
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.index_cache import blocks_at
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy, threshold_distances
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.maps import Area, edge_map
from crowd_lod_extension.sample_scenes import plaza_map
from matplotlib.image import imsave

# vertices of the chapter's LODs; its last number is lost, and 118 is that of its co-author's later
# characters
SIZES = (2500, 1000, 118)
PERSON = Group("person", 0.9, 1.0, 1.25, 1.0, SIZES, tuple(2 * n for n in SIZES))
POLICY = LevelPolicy((0.1, 0.35))
PEERS = ("naive", "six_planes", "geometry_nodes", "c_loop")  # each does what the core does
# way to draw -> (with LODs, with culling)
DRAWING_WAYS = {
    "": (True, True),
    "_no_culling": (True, False),
    "_no_lod": (False, True),
    "_neither": (False, False),
}


def crowd_of(agents: int, seed: int) -> tuple[Walk, float]:
    """Return (trajectory, side in meters) of the chapter's crowd.

    6 agents a square meter, half of them in either state, at 24 frames a second.
    """
    side = (agents / 6) ** 0.5
    area = Area(-side / 2, -side / 2, side / 2, side / 2)
    machine = replace(load_preset("chapter"), start=np.array([0.5, 0.5]))
    world = edge_map(area, machine.labels)
    return Walk(populate(agents, seed, 1, machine, world), machine, world, (PERSON,), 1 / 24), side


def camera(side: float, part: float, turn: float = 0.0, half: float = 0.5) -> Camera:
    """A camera at eye height above the crowd's front edge.

    It is moved `part` of the crowd's side inwards and turned by `turn` radians.
    """
    c = np.cos(turn)
    s = np.sin(turn)
    X = np.array([c, s, 0.0])
    Z = np.array([-s, c, 0.0])
    origin = np.array([0.0, side * (part - 0.5), 0.02 * side + 2])
    return Camera(
        "PERSP",
        origin,
        X,
        np.array([0, 0, 1.0]),
        Z,
        Window(-half, half, -half, half),
        0.1,
        1.2 * side,
        (900, 900),
    )


def quartiles(values: list[float]) -> list[float]:
    """[median, first quartile, third quartile]."""
    return np.percentile(values, (50, 25, 75)).round(4).tolist()


def time_job(job: Callable, *arguments) -> tuple[float, object]:
    """Call the job; return (milliseconds, what it returns)."""
    begun = time.perf_counter()
    result = job(*arguments)
    return 1000 * (time.perf_counter() - begun), result


def add_quartiles(row: dict, times: dict[str, list[float]]) -> None:
    """Add to the row the median and the quartiles of each column of `times`."""
    for name, values in times.items():
        row[name], row[f"{name} q1"], row[f"{name} q3"] = quartiles(values)


def measure_stages(agents: int, repeats: int, seed: int) -> dict:
    """A row of test 1: milliseconds a stage, and of each of PEERS that this machine has.

    The peers' agents stand as at the first frame. In each repeat every peer plans that frame, and
    must find as many agents a LOD as the core does: AssertionError otherwise. Agents that float32
    may put on the other side of a plane are excepted, the core keeps them (camera.as_pictured).
    """
    trajectory, side = crowd_of(agents, seed)
    still = replace(trajectory, seconds_per_frame=0.0)
    rivals = _Peers(trajectory, threshold_distances(POLICY, camera(side, 0), np.ones(1))[0])
    times: dict[str, list[float]] = {}
    still.at(1)
    for repeat in range(repeats + 1):
        view = camera(side, 0.2 + 0.3 * repeat / repeats, 0.2 * np.sin(repeat))
        frame = plan(trajectory, view, POLICY, 1 + repeat)
        core_counts = plan(still, view, POLICY, 1).buckets.counts
        stages = frame.milliseconds
        once = {
            "behavior": stages["behavior"],
            "culling": stages["culling"] + stages["levels"],
            "sorting": stages["sorting"],
            "core": sum(stages.values()) - stages["behavior"],
        }
        peer_times, peer_counts = rivals.plan(view)
        once |= peer_times
        if "c_step" in once:
            once["behavior / c_step"] = once["behavior"] / once["c_step"]
        for name, counts in peer_counts.items():
            assert np.abs(counts - core_counts).sum() <= 1e-4 * agents + 2, name
        once |= {f"core / {name}": once["core"] / once[name] for name in PEERS if name in once}
        if repeat:  # the first warms up
            for name, value in once.items():
                times.setdefault(name, []).append(value)
    row = {"agents": agents}
    add_quartiles(row, times)
    rivals.nodes.close()
    return row


class _Peers:
    """All of PEERS that this machine has, for the crowd of a trajectory at its start.

    thresholds: the distances at which LODs begin, of one group (threshold_distances()).
    """

    def __init__(self, trajectory: Walk, thresholds: np.ndarray):
        crowd = trajectory.start
        self.trajectory = trajectory
        self.thresholds = thresholds
        self.nodes = peers.Nodes(crowd, PERSON, thresholds)
        self.c_cull = loop.library() and loop.Cull(crowd, PERSON, thresholds)
        self.c_step = loop.library() and loop.Step(
            crowd, trajectory.machine, trajectory.world, 1 / 24
        )

    def plan(self, view: Camera) -> tuple[dict[str, float], dict[str, list[int]]]:
        """Plan the start from `view`; return milliseconds, and agents a LOD, by peer's name."""
        crowd = self.trajectory.start
        times = {}
        counts = {}
        for name in ("naive", "six_planes"):
            times[name], buckets = time_job(
                getattr(peers, name), crowd, PERSON, view, self.thresholds
            )
            counts[name] = [len(bucket) for bucket in buckets]
        self.nodes.aim(view)
        times["geometry_nodes"], _ = time_job(self.nodes.update)
        counts["geometry_nodes"] = self.nodes.counts(3)
        if self.c_cull:
            times["c_loop"], counts["c_loop"] = time_job(self.c_cull, view)
            times["c_step"], _ = time_job(self.c_step)
        return times, counts


def perspective_camera(side: float, perspective: str) -> Camera:
    """Perspective A, which sees nearly all of a crowd `side` meters wide, or B, nearly none."""
    return camera(side, -0.1, half=1.5) if perspective == "A" else camera(side, 0.9)


def measure_perspective(agents: int, perspective: str, repeats: int, seed: int) -> dict:
    """A row of test 2: milliseconds of the plan from a perspective, and what it shows."""
    trajectory, side = crowd_of(agents, seed)
    view = perspective_camera(side, perspective)
    times = []
    for repeat in range(repeats + 1):
        moved = replace(view, origin=view.origin + (0.01 * repeat, 0, 0))
        once, frame = time_job(plan, trajectory, moved, POLICY, 1 + repeat)
        times.append(once)
    median, first, third = quartiles(times[1:])
    percent = round(100 * len(frame.buckets.order) / agents, 2)
    return {
        "perspective": perspective,
        "agents": agents,
        "t_ms": median,
        "t_q1": first,
        "t_q3": third,
        **{f"lod{k}": int(n) for k, n in enumerate(frame.buckets.counts)},
        "vertices_millions": round(frame.vertices / 1e6, 3),
        "visible_percent": percent,
        "culled_percent": round(100 - percent, 2),
    }


def measure_pictures(agents: int, perspective: str, repeats: int, seed: int, path: Path) -> dict:
    """A row of test 2, drawn: milliseconds from plan to pixels by the overlay.

    With and without LODs and culling. The picture goes to `path`.
    """
    trajectory, side = crowd_of(agents, seed)
    screen = drawn.Screen(PERSON)
    view = perspective_camera(side, perspective)
    times = {name: [] for name in DRAWING_WAYS}
    row = {"perspective": perspective, "agents": agents}
    picture = {}
    for repeat in range(repeats + 1):
        for name, way in DRAWING_WAYS.items():
            trajectory.at(1 + repeat)  # its steps are test 1's
            begun = time.perf_counter()
            frame = drawn.planned(trajectory, view, POLICY, 1 + repeat, *way)
            picture[name] = screen(frame)
            times[name].append(1000 * (time.perf_counter() - begun))
            row[f"vertices_millions{name}"] = round(frame.vertices / 1e6, 3)
    # culling shows in no pixel but for ties in depth
    for culled, complete in (("", "_no_culling"), ("_no_lod", "_neither")):
        assert (picture[culled] != picture[complete]).any(axis=2).mean() < 1e-3
    screen.free()
    for name, values in times.items():
        row[f"t_ms{name}"], row[f"t_q1{name}"], row[f"t_q3{name}"] = quartiles(values[1:])
    imsave(path, picture[""][::-1])
    return row


def measure_growth(agents: int, repeats: int, seed: int) -> dict:
    """Time and memory an agent.

    Memory is what Python asks for: the state; what it takes to make the blocks anew, which then
    hold 9 bytes; and a plan's results, of a camera that sees nearly all, with what it takes to make
    them.
    """
    trajectory, side = crowd_of(agents, seed)
    state = sum(column.nbytes for column in trajectory.start.columns.values()) / agents
    times = {"behavior": [], "core": []}
    for repeat in range(repeats + 1):
        view = camera(side, 0.2 + 0.3 * repeat / repeats)
        stages = plan(trajectory, view, POLICY, 1 + repeat).milliseconds
        if repeat:
            times["behavior"].append(stages["behavior"])
            times["core"].append(sum(stages.values()) - stages["behavior"])
    trajectory.at(65)  # when blocks are made anew, in a new order
    make_blocks = partial(blocks_at, trajectory, 65)
    make_plan = partial(plan, trajectory, perspective_camera(side, "A"), POLICY, 65)
    row = {
        "agents": agents,
        "state_bytes": state,
        "blocks_peak_bytes": round(_peak_bytes(make_blocks) / agents, 2),
        "results_peak_bytes": round(_peak_bytes(make_plan) / agents, 2),
    }
    for name, values in times.items():
        row[f"{name}_ns_per_agent"] = round(quartiles(values)[0] * 1e6 / agents, 3)
    return row


def _peak_bytes(job: Callable) -> int:
    """Call the job; return the most bytes that Python held for it at a time."""
    tracemalloc.start()
    job()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def measure_whole_frame(agents: int, repeats: int, seed: int) -> dict:
    """A row of the whole frame, by Crowd LOD and by geometry nodes, in turn.

    From behavior to points that the dependency graph holds. The processor's time counts all
    threads: it says what the work costs, the other how long it takes.
    """
    trajectory, side = crowd_of(agents, seed)
    points = walkers.Points(trajectory, POLICY)
    nodes = walkers.Walkers(
        trajectory, PERSON, threshold_distances(POLICY, camera(side, 0), np.ones(1))[0]
    )
    times: dict[str, list[float]] = {}
    for repeat in range(repeats + 2):
        view = camera(side, 0.2 + 0.3 * repeat / repeats)
        nodes.aim(view)
        once = {}
        for name, job in (("crowd_lod", partial(points, view)), ("geometry_nodes", nodes.frame)):
            work = time.process_time()
            once[name], _ = time_job(job, 2 + repeat)
            once[f"{name}_processor"] = 1000 * (time.process_time() - work)
        # the nodes' steps are not cut at the map's edge
        assert np.abs(nodes.counts(3) - points.counts()).sum() <= 1e-3 * agents + 2
        for kind in ("", "_processor"):
            once[f"ratio{kind}"] = once[f"crowd_lod{kind}"] / once[f"geometry_nodes{kind}"]
        if repeat > 1:  # the first two warm up
            for name, value in once.items():
                times.setdefault(name, []).append(value)
    row = {"agents": agents, "visible": int(points.counts().sum())}
    add_quartiles(row, times)
    # some frames work ahead, for others: medians do not show those
    row["ratio_means"] = round(sum(times["crowd_lod"]) / sum(times["geometry_nodes"]), 4)
    points.close()
    nodes.close()
    return row


def measure_plaza(agents: int, frames: int, seed: int) -> dict:
    """A row of behavior where much happens, on the plaza's map.

    Eight ways to turn at walls, timers, chance, three characters. The C loop reads the same table,
    but has neither timers nor chance. Means: some frames work ahead, for others.
    """
    machine = load_preset("plaza")
    world = plaza_map.plan(machine)
    groups = (PERSON, replace(PERSON, stride=1.1), replace(PERSON, stride=0.9))
    start = populate(agents, seed, len(groups), machine, world)
    trajectory = Walk(start, machine, world, groups, 1 / 24)
    loop_step = loop.library() and loop.Step(start, machine, world, 1 / 24)
    trajectory.at(16)
    times = {"behavior": []}
    if loop_step:
        times["c_step"] = []
    for frame in range(17, 17 + frames):
        times["behavior"].append(time_job(trajectory.at, frame)[0])
        if loop_step:
            times["c_step"].append(time_job(loop_step)[0])
    row = {"agents": agents}
    for name, values in times.items():
        row[f"{name}_mean"] = round(float(np.mean(values)), 4)
        add_quartiles(row, {name: values})
    if loop_step:
        row["behavior_mean / c_step_mean"] = round(row["behavior_mean"] / row["c_step_mean"], 4)
    return row
