"""The chapter's two tests, and the growth with the crowd.

Prints the chapter's tables, and writes CSV, JSON and figure 1.6.

./crowd-lod bench [--quick] [--out DIR] [--seed N]
./crowd-lod bench --worth [--quick] [--out DIR]     renders instead: worth.py
./crowd-lod bench --shots [--quick] [--out DIR]     shot plans instead: shots.py
./crowd-lod bench --costs                           what things cost engines: costs.py

Test 1: milliseconds of each stage for 1 K to 1 M agents that walk, under a camera that moves,
beside other ways to do the same (peers.py, loop.c, the GPU), each taken in turn in the same run.
Test 2: the plan from perspective A, which sees nearly all, and B, which sees nearly none, with LOD
meshes of 2,500, 1,000 and 118 vertices; then the same drawn (drawn.py), with and without LODs, with
and without culling. The whole frame: from behavior to points in Blender, beside geometry nodes
(walkers.py). Behavior where much happens. Growth: time and memory an agent from 100 K to 10 M
agents. Medians, with the quartiles as the spread.
"""

import argparse
import sys
import time
import tracemalloc
from dataclasses import replace
from functools import partial
from pathlib import Path

import drawn
import loop
import numpy as np
import peers
import walkers
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.crowd.agents import Group, populate
from crowd_lod_extension.crowd_lod.crowd.maps import Area, edge_map
from crowd_lod_extension.crowd_lod.crowd.state_machine import load_preset
from crowd_lod_extension.crowd_lod.culling.camera import Camera, Window
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.frame.frame import plan, plan_of
from crowd_lod_extension.crowd_lod.frame.index_cache import blocks_at
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy, limits
from crowd_lod_extension.crowd_lod.reporting import files, tables
from crowd_lod_extension.operators.overlay.gpu_culling import Planner
from crowd_lod_extension.operators.runs.error_report import machine_name
from crowd_lod_extension.sample_scenes import plaza_map
from matplotlib.image import imsave

SIZES = (
    2500,
    1000,
    118,
)  # the chapter's last number is lost; 118 is its co-author's later characters'
PERSON = Group("person", 0.9, 1.0, 1.25, 1.0, SIZES, tuple(2 * n for n in SIZES))
POLICY = LevelPolicy((0.1, 0.35))
PEERS = ("naive", "six_planes", "geometry_nodes", "c_loop", "gpu")  # each does what the core does
CHAPTER = {
    "Agents": "agents",
    "t": "t_ms",
    "LOD0": "lod0",
    "LOD1": "lod1",
    "LOD2": "lod2",
    "Vertices": "vertices_millions",
}
CHAPTER |= {"Visible %": "visible_percent", "Culled %": "culled_percent"}
DRAWN = {
    "Agents": "agents",
    "t": "t_ms",
    "t, no culling": "t_ms_no_culling",
    "t, no LOD": "t_ms_no_lod",
    "t, neither": "t_ms_neither",
}
DRAWN |= {"Vertices": "vertices_millions", "Vertices, neither": "vertices_millions_neither"}


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


def taken(job, *arguments) -> tuple[float, object]:
    begun = time.perf_counter()
    result = job(*arguments)
    return 1000 * (time.perf_counter() - begun), result


def stages(agents: int, repeats: int, seed: int) -> dict:
    """A row of test 1.

    The peers' agents stand as at the first frame; they are asked once a repeat, in turn with the
    core, and find as many agents a LOD as the core does for the same crowd, but for those that
    float32 may put on the other side of a plane: the core keeps them (camera.as_pictured).
    """
    trajectory, side = crowd_of(agents, seed)
    still = replace(trajectory, seconds_per_frame=0.0)
    crowd = trajectory.start
    begin = limits(POLICY, camera(side, 0), np.ones(1))[0]
    nodes = peers.Nodes(crowd, PERSON, begin)
    planner = Planner(trajectory) if peers.has_gpu() else None
    c_cull = loop.library() and loop.Cull(crowd, PERSON, begin)
    c_step = loop.library() and loop.Step(crowd, trajectory.machine, trajectory.world, 1 / 24)
    took: dict[str, list[float]] = {}
    still.at(1)
    for repeat in range(repeats + 1):
        view = camera(side, 0.2 + 0.3 * repeat / repeats, 0.2 * np.sin(repeat))
        frame = plan(trajectory, view, POLICY, 1 + repeat)
        same = plan(still, view, POLICY, 1)
        moving = frame.milliseconds
        once = {
            "behavior": moving["behavior"],
            "culling": moving["culling"] + moving["levels"],
            "sorting": moving["sorting"],
        }
        once["core"] = sum(moving.values()) - moving["behavior"]
        if planner:
            there = plan_of(trajectory, frame, planner)
            once["gpu"] = sum(there.milliseconds.values()) - there.milliseconds["behavior"]
            assert there.buckets.order.tobytes() == frame.buckets.order.tobytes()
        counts = {}
        for name in ("naive", "six_planes"):
            once[name], found = taken(getattr(peers, name), crowd, PERSON, view, begin)
            counts[name] = [len(each) for each in found]
        nodes.aim(view)
        once["geometry_nodes"], _ = taken(nodes.update)
        counts["geometry_nodes"] = nodes.counts(3)
        if c_cull:
            once["c_loop"], counts["c_loop"] = taken(c_cull, view)
            once["c_step"], _ = taken(c_step)
            once["behavior / c_step"] = once["behavior"] / once["c_step"]
        for name, found in counts.items():
            assert np.abs(found - same.buckets.counts).sum() <= 1e-4 * agents + 2, name
        once |= {f"core / {name}": once["core"] / once[name] for name in PEERS if name in once}
        if repeat:  # the first warms up
            for name, value in once.items():
                took.setdefault(name, []).append(value)
    row = {"agents": agents}
    for name, values in took.items():
        row[name], row[f"{name} q1"], row[f"{name} q3"] = quartiles(values)
    nodes.close()
    return row


def perspective(agents: int, which: str, repeats: int, seed: int) -> dict:
    """A row of test 2."""
    trajectory, side = crowd_of(agents, seed)
    ms = []
    for repeat in range(repeats + 1):
        view = camera(side, -0.1, half=1.5) if which == "A" else camera(side, 0.9)
        once, frame = taken(
            plan,
            trajectory,
            replace(view, origin=view.origin + (0.01 * repeat, 0, 0)),
            POLICY,
            1 + repeat,
        )
        ms.append(once)
    middle, first, third = quartiles(ms[1:])
    seen = len(frame.buckets.order)
    counts = {f"lod{k}": int(n) for k, n in enumerate(frame.buckets.counts)}
    percent = round(100 * seen / agents, 2)
    return {
        "perspective": which, "agents": agents, "t_ms": middle, "t_q1": first, "t_q3": third, **counts,
        "vertices_millions": round(frame.vertices / 1e6, 3), "visible_percent": percent, "culled_percent": round(100 - percent, 2),
    }  # fmt: skip


def pictures(agents: int, which: str, repeats: int, seed: int, path: Path) -> dict:
    """A row of test 2, drawn: milliseconds from plan to pixels by the overlay.

    With and without LODs and culling. The picture goes to `path`.
    """
    trajectory, side = crowd_of(agents, seed)
    screen = drawn.Screen(PERSON)
    view = camera(side, -0.1, half=1.5) if which == "A" else camera(side, 0.9)
    ways = {
        "": (True, True),
        "_no_culling": (True, False),
        "_no_lod": (False, True),
        "_neither": (False, False),
    }
    took = {name: [] for name in ways}
    row = {"perspective": which, "agents": agents}
    seen = {}
    for repeat in range(repeats + 1):
        for name, way in ways.items():
            trajectory.at(1 + repeat)  # its steps are test 1's
            begun = time.perf_counter()
            frame = drawn.planned(trajectory, view, POLICY, 1 + repeat, *way)
            seen[name] = screen(frame)
            took[name].append(1000 * (time.perf_counter() - begun))
            row[f"vertices_millions{name}"] = round(frame.vertices / 1e6, 3)
    for one, other in (
        ("", "_no_culling"),
        ("_no_lod", "_neither"),
    ):  # culling shows in no pixel but for ties in depth
        assert (seen[one] != seen[other]).any(axis=2).mean() < 1e-3
    screen.free()
    for name, values in took.items():
        row[f"t_ms{name}"], row[f"t_q1{name}"], row[f"t_q3{name}"] = quartiles(values[1:])
    imsave(path, seen[""][::-1])
    return row


def growth(agents: int, repeats: int, seed: int) -> dict:
    """Time and memory an agent.

    Memory is what Python asks for: the state; what it takes to make the blocks anew, which then
    hold 9 bytes; and a plan's results, of a camera that sees nearly all, with what it takes to make
    them.
    """
    trajectory, side = crowd_of(agents, seed)
    state = sum(column.nbytes for column in trajectory.start.columns.values()) / agents
    ms = {"behavior": [], "core": []}
    for repeat in range(repeats + 1):
        found = plan(
            trajectory, camera(side, 0.2 + 0.3 * repeat / repeats), POLICY, 1 + repeat
        ).milliseconds
        if repeat:
            ms["behavior"].append(found["behavior"])
            ms["core"].append(sum(found.values()) - found["behavior"])
    trajectory.at(65)  # when blocks are made anew, in a new order
    peaks = []
    for job in (
        partial(blocks_at, trajectory),
        lambda frame: plan(trajectory, camera(side, -0.1, half=1.5), POLICY, frame),
    ):
        tracemalloc.start()
        job(65)
        peaks.append(round(tracemalloc.get_traced_memory()[1] / agents, 2))
        tracemalloc.stop()
    row = {
        "agents": agents,
        "state_bytes": state,
        "blocks_peak_bytes": peaks[0],
        "results_peak_bytes": peaks[1],
    }
    for name, values in ms.items():
        row[f"{name}_ns_per_agent"] = round(quartiles(values)[0] * 1e6 / agents, 3)
    return row


def whole(agents: int, repeats: int, seed: int) -> dict:
    """A row of the whole frame, by Crowd LOD and by geometry nodes, in turn.

    From behavior to points that the dependency graph holds. The processor's time counts all
    threads: it says what the work costs, the other how long it takes.
    """
    trajectory, side = crowd_of(agents, seed)
    points = walkers.Points(trajectory, POLICY)
    nodes = walkers.Walkers(trajectory, PERSON, limits(POLICY, camera(side, 0), np.ones(1))[0])
    took: dict[str, list[float]] = {}
    for repeat in range(repeats + 2):
        view = camera(side, 0.2 + 0.3 * repeat / repeats)
        nodes.aim(view)
        once = {}
        for name, job in (("crowd_lod", partial(points, view)), ("geometry_nodes", nodes.frame)):
            work = time.process_time()
            once[name], _ = taken(job, 2 + repeat)
            once[f"{name}_processor"] = 1000 * (time.process_time() - work)
        assert (
            np.abs(nodes.counts(3) - points.counts()).sum() <= 1e-3 * agents + 2
        )  # their steps are not cut at the map's edge
        once["ratio"], once["ratio_processor"] = (
            once[f"crowd_lod{k}"] / once[f"geometry_nodes{k}"] for k in ("", "_processor")
        )
        if repeat > 1:  # the first two warm up
            for name, value in once.items():
                took.setdefault(name, []).append(value)
    row = {"agents": agents, "visible": int(points.counts().sum())}
    for name, values in took.items():
        row[name], row[f"{name} q1"], row[f"{name} q3"] = quartiles(values)
    # some frames work ahead, for others: medians do not show those
    row["ratio_means"] = round(sum(took["crowd_lod"]) / sum(took["geometry_nodes"]), 4)
    points.close()
    nodes.close()
    return row


def busy(agents: int, frames: int, seed: int) -> dict:
    """A row of behavior where much happens, on the plaza's map.

    Eight ways to turn at walls, timers, chance, three characters. The C loop reads the same table,
    but has neither timers nor chance. Means: some frames work ahead, for others.
    """
    machine = load_preset("plaza")
    world = plaza_map.plan(machine)
    groups = (PERSON, replace(PERSON, stride=1.1), replace(PERSON, stride=0.9))
    trajectory = Walk(
        populate(agents, seed, len(groups), machine, world), machine, world, groups, 1 / 24
    )
    loop_step = loop.library() and loop.Step(trajectory.start, machine, world, 1 / 24)
    trajectory.at(16)
    took = {"behavior": [], "c_step": []}
    for number in range(17, 17 + frames):
        took["behavior"].append(taken(trajectory.at, number)[0])
        if loop_step:
            took["c_step"].append(taken(loop_step)[0])
    row = {"agents": agents}
    for name, values in took.items():
        if values:
            row[f"{name}_mean"] = round(float(np.mean(values)), 4)
            row[name], row[f"{name} q1"], row[f"{name} q3"] = quartiles(values)
    if loop_step:
        row["behavior_mean / c_step_mean"] = round(row["behavior_mean"] / row["c_step_mean"], 4)
    return row


def table(rows: list[dict], columns: dict[str, str]) -> str:
    """The rows as text, `columns` by heading."""
    cells = [
        list(columns),
        *([_text(row.get(key, "")) for key in columns.values()] for row in rows),
    ]
    widths = [max(len(row[k]) for row in cells) for k in range(len(columns))]
    return "\n".join(
        "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True))
        for row in cells
    )


def gpu_name() -> str:
    import gpu

    return f"{gpu.platform.renderer_get()}, {gpu.platform.backend_type_get()}"


def _text(value: str | int | float | None) -> str:
    return "" if value is None else value if isinstance(value, str) else f"{value:,}"


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="crowd-lod bench", description="Measure the core: the chapter's tests and growth."
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="fewer sizes and repeats, no growth: under a minute (--worth: a quarter of an hour)",
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=1,
        metavar="N",
        help="with --worth: so many renders at a time (default: 1)",
    )
    parser.add_argument(
        "--worth",
        action="store_true",
        help="instead, what renders take with and without Crowd LOD: an hour",
    )
    parser.add_argument(
        "--shots",
        action="store_true",
        help="instead, shot plans beside thresholds and hysteresis: ten minutes",
    )
    parser.add_argument(
        "--costs",
        action="store_true",
        help="instead, fit what things cost engines (crowd_lod/levels/cost_model.py): about an "
        "hour",
    )
    parser.add_argument(
        "--held-out",
        choices=("cycles", "eevee"),
        help="instead, judge what this engine's costs say of time with LODs, by crowds that none "
        "was fitted to: ten minutes",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("bench"),
        metavar="DIR",
        help="the folder for tables and figures (default: bench)",
    )
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="another crowd of the same kind"
    )
    args = parser.parse_args(arguments)
    if args.worth:
        import worth

        if args.jobs < 1:
            parser.error("--jobs takes a whole number from 1 on")
        return worth.main(files.absolute(args.out), args.quick, args.jobs)
    if args.shots:
        import shots

        return shots.main(files.absolute(args.out), args.quick)
    if args.costs:
        import costs

        return costs.main()
    if args.held_out:
        import costs

        return costs.judge(args.held_out.upper())
    with files.staged(files.absolute(args.out)) as stage:
        measure(stage, args)
    print(f"\n{args.out.absolute()}")


def measure(stage: Path, args: argparse.Namespace) -> None:
    """Take the times, print their tables and write them to the folder `stage`."""
    repeats = 7 if args.quick else 21
    machine = f"{machine_name()}; medians of {repeats} runs"
    print(machine, flush=True)
    one = [
        stages(n, repeats, args.seed)
        for n in (
            (1000, 32_000, 1_000_000)
            if args.quick
            else (1000, 4000, 16_000, 64_000, 256_000, 1_000_000)
        )
    ]
    heads = [
        name
        for name in ("agents", "behavior", "culling", "sorting", "core", *PEERS, "c_step")
        if name in one[0]
    ]
    print(
        "\nTest 1: milliseconds a stage (culling with LOD assignment); core: culling, LOD and "
        "sorting; peers do the same"
    )
    print(table(one, {name.replace("_", " "): name for name in heads}))
    ratios = [name for name in one[0] if "/" in name and not name.endswith(("q1", "q3"))]
    print(table(one, {"agents": "agents"} | {name: name for name in ratios}), flush=True)
    if not loop.library():
        print(
            "Without the C loop: there is no C compiler (cc, gcc or clang, or the one that CC "
            "names), or it fails."
        )
    two = [
        perspective(n, which, repeats, args.seed)
        for which in "AB"
        for n in (
            (8192, 1_000_000)
            if args.quick
            else (1024, 4096, 8192, 16_384, 65_536, 262_144, 1_000_000)
        )
    ]
    for which in "AB":
        print(
            f"\nTable 1.{1 + 'AB'.index(which)}: perspective {which}; t in ms, without drawing; "
            f"vertices in millions"
        )
        print(table([row for row in two if row["perspective"] == which], CHAPTER), flush=True)
    runs = 16 if args.quick else 48  # rounds of the frames that work ahead
    three = [
        whole(n, runs, args.seed)
        for n in ((10_000, 100_000) if args.quick else (10_000, 100_000, 1_000_000))
    ]
    print(
        f"\nThe whole frame, behavior to points in Blender: milliseconds, and of the processor's "
        f"time; medians of {runs} runs"
    )
    print(
        table(
            three,
            {name.replace("_", " "): name for name in three[0] if not name.endswith(("q1", "q3"))},
        ),
        flush=True,
    )
    plaza = [
        busy(n, 2 * runs, args.seed)
        for n in ((10_000, 1_000_000) if args.quick else (10_000, 100_000, 1_000_000))
    ]
    print(f"\nBehavior on the plaza's map: milliseconds, and of {2 * runs} frames the means")
    print(
        table(
            plaza,
            {name.replace("_", " "): name for name in plaza[0] if not name.endswith(("q1", "q3"))},
        ),
        flush=True,
    )
    results = {
        "machine": machine,
        "test_1": one,
        "test_2": two,
        "whole_frame": three,
        "plaza": plaza,
    }
    if not args.quick:
        results["growth"] = [growth(n, 9, args.seed) for n in (100_000, 1_000_000, 10_000_000)]
        print(
            f"\nGrowth\n{table(results['growth'], {name.replace('_', ' '): name for name in results['growth'][0]})}"
        )
    if peers.has_gpu():
        sizes, times = ((1024,), 3) if args.quick else ((1024, 4096, 8192), 5)
        results["drawn"] = [
            pictures(n, which, times, args.seed, stage / f"perspective_{which}.png")
            for n in sizes
            for which in "AB"
        ]
        for which in "AB":
            print(
                f"\nTest 2, perspective {which}, drawn by {gpu_name()}, 900 x 900 pixels; t in "
                f"ms; vertices in millions"
            )
            print(
                table([row for row in results["drawn"] if row["perspective"] == which], DRAWN),
                flush=True,
            )
    else:
        print("\nTest 2 is not drawn: this Blender has no GPU without a window.")
    (stage / "bench.json").write_text(tables.to_json(results), encoding="utf-8")
    for name, rows in results.items():
        if name != "machine":
            (stage / f"{name}.csv").write_text(
                f"# {machine}\n{tables.to_csv(rows)}", encoding="utf-8"
            )
    draw(stage / "figure_1_6.png", one, machine)


def draw(path: Path, rows: list[dict], machine: str) -> None:
    """Figure 1.6: milliseconds a stage against agents; beside it the peers."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5.5), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(machine, fontsize=7, color="#444444")
    sets = {
        "Test 1 (figure 1.6): stages": ("behavior", "culling", "sorting"),
        "Culling, LOD and sorting, beside other ways": ("core", *PEERS),
    }
    for place, (title, names) in enumerate(sets.items()):
        axes = figure.add_subplot(1, 2, place + 1)
        for name in (name for name in names if name in rows[0]):
            x, y, low, high = np.array(
                [[row[k] for k in ("agents", name, f"{name} q1", f"{name} q3")] for row in rows]
            ).T
            label = {"culling": "culling & LOD assignment", "core": "Crowd LOD"}.get(
                name, name.replace("_", " ")
            )
            axes.errorbar(
                x,
                y,
                yerr=(y - low, high - y),
                marker="o",
                ms=4,
                capsize=2,
                lw=2.2 if name == "core" else 1.2,
                label=label,
            )
        axes.set(
            xscale="log",
            yscale="log",
            xlabel="agents",
            ylabel="ms (median; bars: quartiles)",
            title=title,
        )
        axes.grid(alpha=0.25)
        axes.legend(frameon=False)
    figure.savefig(path)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except CrowdError as error:
        sys.exit(f"crowd-lod bench: {error}")
