"""A crowd of tracks: the file's places to the bit, linear between them, nobody missed, one answer
for a frame.
"""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.leave_outs import BLOCKS
from crowd_lod_extension.crowd_lod.culling.volumes import Light
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.shadows import Surroundings, surround
from crowd_lod_extension.crowd_lod.sources.several import Several
from crowd_lod_extension.crowd_lod.tracks.rows import Rows
from crowd_lod_extension.crowd_lod.validation.exact_frustum import sees
from crowd_lod_extension.crowd_lod.world.height_map import HeightMap
from crowd_lod_extension.crowd_lod.world.maps import Area
from crowd_lod_extension.crowd_lod.world.terrain import Terrain

from ..support.cameras import straight
from ..support.shots import POLICY, full_plan, known, shot, walking
from ..support.tracks import GROUPS, recorded, wanderers
from .test_terrain import two_floors

COLUMNS = ("x", "y", "z", "heading", "state", "phase_class", "pace", "present")


def track(rows, agent):
    """(frame, x, y, z) of one agent's rows, in order."""
    (own,) = np.nonzero(rows.id == agent)
    own = own[np.argsort(rows.frame[own])]
    return rows.frame[own], rows.x[own], rows.y[own], None if rows.z is None else rows.z[own]


def same(a, b):
    return all(
        (getattr(a, name) is None and getattr(b, name) is None)
        or getattr(a, name).tobytes() == getattr(b, name).tobytes()
        for name in COLUMNS
    )


def test_a_samples_frame_is_the_files_to_the_bit_at_the_files_rate_and_at_others():
    rows = wanderers(60)
    first = rows.frame.min()
    for fps, every in ((16.0, 1), (24.0, 2), (48.0, 1), (30000 / 1001, 1001)):
        crowd = recorded(rows, fps)
        for frame in np.unique(rows.frame)[:: 7 * every]:
            time = 1 + (frame - first) * fps / 16
            if time != round(time):
                continue
            found = crowd.at(time)
            (own,) = np.nonzero(rows.frame == frame)
            agents = np.searchsorted(crowd.ids, rows.id[own])
            assert found.x[agents].tobytes() == rows.x[own].tobytes()
            assert found.y[agents].tobytes() == rows.y[own].tobytes()
            assert found.present is None or found.present[agents].all()


@pytest.mark.parametrize("z", [False, True])
def test_between_samples_all_is_linear_and_who_is_away_stands_where_it_enters_or_left(z):
    rows = wanderers(80, z=z)
    crowd = recorded(rows)
    first = rows.frame.min()
    last = rows.frame.max()
    for time in (-5, 1, 1.25, 8, 33.4, 90.75, 150, 300):
        found = crowd.at(time)
        frame = np.clip(first + (time - 1) * 16 / 24, first, last)
        for k, agent in enumerate(crowd.ids):
            frames, x, y, height = track(rows, agent)
            assert found.x[k] == pytest.approx(np.interp(frame, frames, x), abs=1e-12)
            assert found.y[k] == pytest.approx(np.interp(frame, frames, y), abs=1e-12)
            if z:
                assert found.z[k] == pytest.approx(np.interp(frame, frames, height), abs=1e-12)
            after = np.searchsorted(frames, frame, side="right")
            inside = frames[0] <= frame <= frames[-1]
            lost = (
                inside and 0 < after < len(frames) and (frames[after] - frames[after - 1]) / 16 > 2
            )
            assert (found.present is None or found.present[k]) == (inside and not lost)


def test_a_frame_has_one_answer_whatever_was_asked_before():
    rows = wanderers(100)
    times = [3, 60.5, 7.25, 3, 120, 60.5, 60.25]
    once = [recorded(rows).at(time) for time in times]
    crowd = recorded(rows)
    assert all(same(crowd.at(time), own) for time, own in zip(times, once, strict=True))


def test_rows_in_any_order_and_between_other_agents_give_the_same():
    rows = wanderers(50)
    order = np.lexsort((rows.frame, rows.id))
    other = replace(rows, **{name: column[order] for name, column in rows.columns.items()})
    a = recorded(rows)
    b = recorded(other)
    assert a.digests() == b.digests() and same(a.at(31.5), b.at(31.5))


@pytest.mark.parametrize("z", [False, True])
def test_velocities_are_never_exceeded(z):
    rows = wanderers(200, z=z)
    random = np.random.default_rng(3)
    heights = (
        None
        if z
        else HeightMap(random.uniform(0, 2, (9, 9)).astype(np.float32), Area(-60, -20, 60, 120))
    )
    crowd = recorded(rows, heights=heights)
    for since in random.uniform(-10, 200, 40):
        until = since + random.choice([0.01, 0.5, 3.0, 40.0])
        bounds = crowd.velocity(since, until)
        a = crowd.at(since)
        b = crowd.at(until)
        least, most = bounds.between([(until - since) / 24])
        for axis, name in enumerate("xyz"):
            moved = getattr(b, name) - getattr(a, name)
            assert moved.min() >= least[axis] - 1e-9 and moved.max() <= most[axis] + 1e-9
        assert np.hypot(b.x - a.x, b.y - a.y).max() <= crowd.most_moved([since, until]) + 1e-9
        assert bounds.speed < 10


def test_a_slip_of_a_tracker_counts_in_its_own_second_alone():
    rows = wanderers(40, gaps=False)
    x = rows.x.copy()
    slip = int(np.flatnonzero(rows.frame == 100)[0])
    x[slip] += 30
    crowd = recorded(replace(rows, x=x))
    assert crowd.velocity(148, 150).speed > 100
    assert crowd.velocity(1, 100).speed < 10 and crowd.velocity(200, 260).speed < 10


def test_who_crosses_a_gap_is_fast_until_its_end():
    rows = line(np.arange(60) * 0.1)
    rows = replace(
        rows, **{name: np.delete(column, slice(21, 38)) for name, column in rows.columns.items()}
    )  # 1.8 seconds
    x = np.where(rows.frame < 30, rows.x, rows.x + 30)
    crowd = recorded(replace(rows, x=x), fps=10.0)
    for time in np.arange(1, 60, 0.3):
        since = time
        until = time + 0.1
        moved = crowd.at(until).x[0] - crowd.at(since).x[0]
        assert moved <= crowd.velocity(since, until).between([0.01])[1][0] + 1e-9
    assert crowd.velocity(37, 38).speed > 15 > 2 > crowd.velocity(50, 59).speed


@pytest.mark.once
@pytest.mark.parametrize("kind", ["alone", "heights", "terrain", "several"])
def test_nobody_is_missed_and_leave_outs_change_nothing(blocks, kind):
    random = np.random.default_rng(9)
    heights = (
        HeightMap(random.uniform(0, 3, (9, 9)).astype(np.float32), Area(-60, -20, 60, 120))
        if kind == "heights"
        else None
    )
    heights = Terrain(two_floors()) if kind == "terrain" else heights
    crowd = recorded(wanderers(250, z=kind == "alone"), heights=heights)
    found = set()
    if kind == "several":
        crowd = Several([shot(walking(), groups=GROUPS), crowd], ("", "File"), (True, True))
    for time in (1, 30, 61.25, 90, 147.5):
        camera = straight(offset=(random.uniform(-40, 40), random.uniform(-20, 60), 1.7))
        frame = plan(crowd, camera, POLICY, time, [(time - 0.5, [camera]), (time + 0.5, [camera])])
        found |= set(frame.left_out)
        there = frame.crowd.present
        for moment in (time, time - 0.5, time + 0.5):
            now = crowd.at(moment)
            center, radius = (
                np.array([getattr(group, name) for group in GROUPS])[now.group]
                for name in ("center", "radius")
            )
            places = np.stack([now.x, now.y, now.z + center], axis=1)
            missed = [
                a
                for a in np.flatnonzero(~frame.visible & there)
                if sees(camera, places[a], radius[a])
            ]
            assert not missed
        assert not frame.visible[~there].any() and frame.visible.any()
        assert known(frame) == known(full_plan(crowd, camera, POLICY, time, frame.shutter))
        lit = surround(frame, Surroundings(lights=(Light(None, np.array([0.6, 0.0, -0.8])),)))
        assert there[lit.shadow.order].all()
    assert (BLOCKS in found) == blocks


def line(x, y=None, rate=10.0, **more):
    """One agent who walks through x, a row a frame."""
    x = np.asarray(x, float)
    return Rows(
        np.zeros(len(x), np.int64),
        np.arange(len(x), dtype=float),
        x,
        np.zeros(len(x)) if y is None else y,
        rate=rate,
        **more,
    )


def test_who_stands_keeps_heading_way_and_pose_whatever_the_tracker_trembles():
    random = np.random.default_rng(4)
    x = np.concatenate([np.linspace(0, 4, 31), np.full(60, 4.0), np.linspace(4, 8, 31)])
    tremble = random.normal(0, 0.005, (2, len(x)))
    crowd = recorded(line(x + tremble[0], tremble[1]), fps=10.0)
    stands = [crowd.at(time) for time in np.arange(40, 82, 0.5)]
    assert len({float(each.heading[0]) for each in stands}) == 1
    assert len({int(each.phase_class[0]) for each in stands}) == 1
    assert all(each.pace[0] == 0 and each.state[0] == 0 for each in stands)
    assert crowd.states.names[crowd.at(10).state[0]] == "walks"


def test_headings_turn_the_shorter_way():
    angle = np.radians(np.linspace(150, 210, 30))  # over the seam at 180 degrees
    x = np.cumsum(np.cos(angle)) * 0.1
    y = np.cumsum(np.sin(angle)) * 0.1
    crowd = recorded(line(x, y), fps=10.0)
    headings = np.unwrap([float(crowd.at(time).heading[0]) for time in np.arange(1, 30, 0.1)])
    assert np.abs(np.diff(headings)).max() < 0.02
    assert np.degrees(headings[0]) % 360 == pytest.approx(152, abs=4) and np.degrees(
        headings[-1]
    ) % 360 == pytest.approx(208, abs=4)


def test_feet_keep_to_the_ground_poses_are_a_32nd_of_a_cycle_off_at_most():
    rows = wanderers(60, gaps=False)
    crowd = recorded(rows)
    strides = np.array([group.stride for group in crowd.groups])[crowd.start.group]
    walkers = strides > 0
    way = np.zeros(len(crowd.ids))
    previous = None
    off = []
    for time in np.arange(1, 150, 1.5):  # the file's own frames
        now = crowd.at(time)
        phase = crowd.phase(now, time)
        frame = crowd.file_frame(time)
        way = np.array([walked(rows, agent, frame) for agent in crowd.ids])
        part = (way / np.where(walkers, strides, 1) - phase) % 1.0
        if previous is not None:
            there = walkers & now.present & previous[1].present
            off.append(np.abs((part - previous[0] + 0.5) % 1.0 - 0.5)[there])
        previous = part, now
    assert np.concatenate(off).max() <= 1 / 16 + 1e-4  # each of two within 1/32
    assert len(crowd.gaits.paces.speeds) <= 6 and crowd.gaits.paces.speeds[0] == 0


def walked(rows, agent, frame):
    """Meters of the agent's smoothed way to a whole frame, summed row by row."""
    frames, x, y, _ = track(rows, agent)
    total = 0.0
    near = round(0.25 * rows.rate)
    for k, own in enumerate(frames):
        if own >= frame:
            break
        a = max(k - near, 0)
        b = min(k + near, len(frames) - 1)
        speed = np.hypot(x[b] - x[a], y[b] - y[a]) / (frames[b] - frames[a]) * rows.rate
        if speed >= 0.1 and k + 1 < len(frames):
            total += speed * (frames[k + 1] - own) / rows.rate
    return total


def test_a_files_own_headings_phases_and_groups_are_played():
    count = 40
    heading = np.linspace(3, 5, count)
    phase = np.arange(count) * 0.06
    crowd = recorded(line(np.linspace(0, 4, count), heading=heading, phase=phase), fps=10.0)
    for time in (1, 9, 20, 39):
        now = crowd.at(time)
        assert now.heading[0] == np.float32(heading[time - 1])
        apart = (crowd.phase(now, time)[0] - phase[time - 1] + 0.5) % 1.0 - 0.5
        assert abs(apart) <= 1 / 32 + 1e-5


def test_the_crowd_is_moved_and_played_from_its_start_frame_on():
    rows = wanderers(30)
    plain = recorded(rows)
    moved = recorded(rows, offset=(10.0, -5.0, 2.0), first_frame=101)
    a = plain.at(31)
    b = moved.at(131)
    assert np.array_equal(b.x, a.x + 10) and np.array_equal(b.y, a.y - 5) and (b.z == 2).all()
    assert moved.area.x_min == plain.area.x_min + 10
    before = moved.at(50)
    after = moved.at(101)
    assert (
        np.array_equal(before.x, after.x)
        and np.array_equal(before.present, after.present)
        and not before.pace.any()
    )
    assert moved.note.startswith("The file has 30 agents in frames")
    assert plain.regrouped(np.zeros(30, np.uint8)).at(31).x.tobytes() == a.x.tobytes()


def test_on_several_floors_agents_keep_to_theirs_and_a_files_z_chooses_it():
    y = np.linspace(10, 70, 500)
    up, under = (np.stack([np.full(500, x), y]) for x in (0.0, 30.0))  # one takes the ramp
    ids = np.repeat([1, 2], 500)
    frame = np.tile(np.arange(500.0), 2)
    rows = Rows(ids, frame, *np.concatenate([up, under], axis=1), rate=10.0)
    crowd = recorded(rows, fps=10.0, heights=Terrain(two_floors()))
    assert crowd.at(500).z.tolist() == [4, 0] and crowd.at(1).z.tolist() == [0, 0]
    middle = crowd.at(168.5)
    assert middle.z[0] == pytest.approx((middle.y[0] - 20) / 5) and middle.z[1] == 0
    told = recorded(
        replace(rows, z=np.repeat([0.0, 3.9], 500)), fps=10.0, heights=Terrain(two_floors())
    )
    assert told.at(500).z.tolist() == [0, 4] and told.at(1).z.tolist() == [0, 0]
