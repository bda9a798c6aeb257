from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.culling.camera import Window, lens_blur
from crowd_lod_extension.crowd_lod.culling.radar import radar
from crowd_lod_extension.crowd_lod.culling.volumes import (
    Light,
    Mirror,
    bound_volume,
    mirror_volume,
    reaches_into,
    shades_into,
    view,
)
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.shadows import Surroundings, surround
from crowd_lod_extension.crowd_lod.levels.assignment import LevelPolicy
from crowd_lod_extension.crowd_lod.validation.exact_frustum import scatter

from ..support.cameras import ONE, straight
from ..support.crowds import crowd_at
from ..support.culling_audit import LENSES, gap, random_camera
from ..support.frames import shot

pytestmark = pytest.mark.once

SUNS = [
    Light(None, np.array(way) / np.linalg.norm(way), angle=angle)
    for way in ((1, 0, -1), (-0.2, 1, -0.3))
    for angle in (0, 0.2)
]
LAMPS = [
    Light(np.array([20.0, 40, 15]), np.array([0, 0, -1.0]), 0.5),
    Light(np.array([-60.0, 30, 10]), np.array([1.0, 0, 0]), 1.0, np.pi / 2),
    Light(np.array([-30.0, 50, 30]), np.array([0.6, 0, -0.8]), 0.0, 0.5),
    Light(np.array([0.0, -20, 5]), np.array([0, 0, -1.0]), 0.2, reach=50.0),
]


def emitter(light, random, n):
    """Points of the light: (n, 3), and for a sun ways (n, 3) of its rays."""
    if light.origin is not None:
        way = random.normal(size=(n, 3))
        way *= (light.size * random.random((n, 1)) ** (1 / 3)) / np.linalg.norm(
            way, axis=1, keepdims=True
        )
        return light.origin + way
    turn = light.angle * np.sqrt(random.random(n))
    aside = np.cross(light.direction, random.normal(size=(n, 3)))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    return np.cos(turn)[:, None] * light.direction + np.sin(turn)[:, None] * aside


def hidden_from(light, points, random, centers, radius):
    """(n,) bool: spheres at centers (n, 3) that stand between some of the points (m, 3) and a
    random place of the light. By distance of a center from the ray's segment: another way than
    sweeping spheres."""
    found = np.zeros(len(centers), bool)
    for point, place in zip(points, emitter(light, random, len(points)), strict=True):
        if light.origin is None:
            way = -place
            length = np.inf
        else:
            way = place - point
            length = np.linalg.norm(place - point)
            way = way / length
            if length > light.reach + light.size or (-way) @ light.direction < np.cos(light.angle):
                continue
        along = np.clip((centers - point) @ way, 0, length)
        found |= np.linalg.norm(centers - point - along[:, None] * way, axis=1) <= radius
    return found


def seen_points(camera, random, n, box):
    """Points (n, 3) that the camera sees, within the box (2, 3)."""
    points = random.uniform(*box, (400 * n, 3))
    return points[radar(crowd_at(points), camera, ONE, ONE)[0]][:n]


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO", "PANO"])
@pytest.mark.parametrize(
    "light", SUNS + LAMPS, ids=lambda light: "sun" if light.origin is None else "lamp"
)
def test_no_shadow_that_falls_into_the_picture_is_missed(light, kind):
    random = np.random.default_rng(5)
    camera = straight(kind=kind)
    if kind == "PANO":
        camera = replace(camera, cone=0.8)
    elif kind == "ORTHO":
        camera = lens_blur(camera, 1.0, 5.0)
    box = np.array([(-100, -30, -1), (100, 150, 20.0)])
    centers = random.uniform((-100, -30, 0), (100, 150, 20), (1000, 3))
    radius = random.uniform(0.5, 5, 1000)
    kept = shades_into(bound_volume(view(camera), box), light, centers, radius)
    found = hidden_from(light, seen_points(camera, random, 1500, box), random, centers, radius)
    assert found.sum() >= 5 and not (found & ~kept).any() and not kept.all()


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize(
    "light", SUNS[::2] + LAMPS[:1], ids=lambda light: "sun" if light.origin is None else "lamp"
)
def test_what_is_kept_for_nothing_passes_by_near_an_edge(light, kind):
    """By the true distance of the picture's body from spheres all along the shadow."""
    random = np.random.default_rng(6)
    camera = straight(kind=kind)
    centers = random.uniform((-100, -30, 0), (100, 150, 20), (400, 3))
    radius = random.uniform(0.5, 5, 400)
    kept = shades_into(view(camera), light, centers, radius)
    along = np.concatenate([[0], np.geomspace(0.01, 300, 300)])
    way, grow = (
        (light.direction, 0.0)
        if light.origin is None
        else (centers - light.origin, (radius + light.size)[:, None])
    )
    places = centers[:, None] + along[:, None] * (way[:, None] if light.origin is not None else way)
    away = gap(camera, places.reshape(-1, 3)).reshape(400, -1) - radius[:, None] - along * grow
    true = (away <= 0).any(axis=1)
    assert not (true & ~kept).any() and true.sum() >= 10
    beside = kept & ~true
    assert beside.sum() <= 0.25 * true.sum()
    assert (
        (away / (radius[:, None] + along * grow))[beside].min(axis=1, initial=np.inf) < 0.8
    ).all()


@pytest.mark.parametrize("lens", LENSES)
def test_without_a_way_to_go_it_is_the_radar_test(lens):
    """Also of a camera with depth of field."""
    random = np.random.default_rng(8)
    for aperture in (0.0, 0.0, 0.3, 3.0):
        camera = random_camera(random, lens)
        radius = 10.0 ** random.uniform(-3, 1.5, 200)
        points = scatter(camera, radius, random)
        camera = lens_blur(camera, aperture, 5.0)
        visible, _ = radar(crowd_at(points, np.arange(200)), camera, np.zeros(200), radius)
        assert not (visible & ~reaches_into(view(camera), points, radius)).any()


def test_a_sphere_on_the_edge_of_its_shadows_way_is_kept_and_one_beyond_is_not():
    camera = straight()  # sees |x| <= y, |z| <= y, 1 <= y <= 100
    sun = Light(None, np.array([1.0, 0, 0]), angle=0.0)
    at = np.array(
        [(-300, 50, 51), (-300, 50, 51.41), (300, 50, 0), (-300, 101, 0), (-300, 101.01, 0)], float
    )
    assert shades_into(view(camera), sun, at, np.ones(5)).tolist() == [
        True,
        True,
        False,
        True,
        False,
    ]
    # at sqrt(2) a sphere of the radius 1 leaves a plane of 45 degrees
    assert shades_into(view(camera), sun, np.array([(-300, 50, 51.42)]), np.ones(1)).tolist() == [
        False
    ]


def test_a_half_sky_of_light_keeps_everyone_in_front_of_what_is_seen():
    camera = straight()
    wide = Light(None, np.array([0, 0, -1.0]), angle=np.pi / 2)
    assert shades_into(view(camera), wide, np.array([(0.0, -50, 5), (500, 0, 3)]), np.ones(2)).all()


def test_a_mirror_shows_what_its_reflection_shows():
    random = np.random.default_rng(4)
    rectangle = np.array([(-4, 30, 0), (6, 30, 0), (6, 30, 5), (-4, 30, 5)], float)
    for normal in ((0, 1.0, 0), (0, -1.0, 0)):
        mirror = Mirror(np.array(normal), rectangle)
        for camera in (straight(), straight(kind="ORTHO"), straight(kind="PANO")):
            points = random.uniform((-60, -80, -10), (60, 40, 20), (20_000, 3))
            kept = reaches_into(mirror_volume(camera, mirror), points, np.zeros(20_000))
            # by hand: the ray from the eye to the point's image meets the rectangle, and the point
            # stands before it
            image = points * (1, -1, 1) + (0, 60, 0)
            if camera.kind == "ORTHO":
                hit = image
                shown = (np.abs(image[:, ::2]) <= 5).all(axis=1)
            else:
                hit = image * (30 / image[:, 1:2])
                shown = (
                    (np.abs(image[:, ::2]) <= image[:, 1:2]).all(axis=1)
                    if camera.kind == "PERSP"
                    else True
                )
            shown &= (
                (points[:, 1] <= 30)
                & (hit[:, 0] >= -4)
                & (hit[:, 0] <= 6)
                & (hit[:, 2] >= 0)
                & (hit[:, 2] <= 5)
            )
            assert (kept == shown).all() and 100 < shown.sum() < 10_000


def test_a_mirror_that_the_camera_does_not_see_shows_nothing():
    behind = np.array([(-4, -30, 0), (6, -30, 0), (6, -30, 5), (-4, -30, 5)], float)
    beyond = behind + (0, 200, 0)
    for rectangle in (behind, beyond):
        assert mirror_volume(straight(), Mirror(np.array([0, 1.0, 0]), rectangle)) is None
    on_edge = np.array([(0, 10, 0), (0, 20, 0), (0, 20, 5), (0, 10, 5)], float)
    assert mirror_volume(straight(), Mirror(np.array([1.0, 0, 0]), on_edge)) is None


GLASS = Mirror(
    np.array([0, 1.0, 0]), np.array([(-9, 60, 0), (9, 60, 0), (9, 60, 5), (-9, 60, 5)], float)
)


def around(**more):
    light = Light(None, np.array([0.6, 0, -0.8]), angle=0.01)
    return Surroundings(lights=(light,), box=np.array([(-60, -60, -1), (60, 160, 0.0)]), **more)


def test_buckets_hold_each_agent_once_at_their_lod_and_do_not_depend_on_what_was_asked_before():
    trajectory = shot()
    camera = straight()
    policy = LevelPolicy((0.3, 0.6))
    both = around(mirrors=(GLASS,))
    made = {
        time: surround(plan(trajectory, camera, policy, time), both) for time in (33.5, 80, 5, 33.5)
    }
    for frame in made.values():
        seen = [set(b.order.tolist()) for b in (frame.buckets, frame.shadow, frame.mirrored)]
        assert all(seen) and len(set.union(*seen)) == sum(map(len, seen))
        assert frame.shadow.counts.tolist()[:2] == frame.mirrored.counts.tolist()[:2] == [0, 0]
    again = shot()
    fresh = surround(plan(again, camera, policy, 33.5), both)
    assert (fresh.shadow.order == made[33.5].shadow.order).all()


def test_a_box_of_what_is_there_ends_the_shadows_of_a_low_sun():
    trajectory = shot()
    policy = LevelPolicy((0.3, 0.6))
    camera = straight(60.0, offset=(0, -5, 2))
    camera = replace(camera, window=Window(-0.3, 0.3, -0.2, 0.2), near=0.1)
    frame = plan(trajectory, camera, policy, 1)
    low = Light(None, np.array([0.999, 0, -0.0447]), angle=0.005)
    scene = Surroundings(lights=(low,), box=np.array([(-60, -60, -1), (60, 160, 0.0)]))
    with_box = surround(frame, scene).shadow.order
    without = surround(frame, replace(scene, box=None)).shadow.order
    assert 0 < len(with_box) <= len(without) and set(with_box) <= set(without)


def culled_but_kept(points, **more):
    """The agents at the points (n, 3) that stay beside those seen from a meter above the origin."""
    trajectory = replace(shot(), start=crowd_at(points))
    frame = plan(trajectory, straight(offset=(0, 0, 1)), LevelPolicy(()), 1)
    return surround(frame, Surroundings(**more)).shadow.order.tolist()


@pytest.mark.parametrize(("slope", "falls"), [(0.05, True), (0.1, False)])
@pytest.mark.parametrize("way", [-1, 1])
def test_shadows_fall_on_agents_from_head_to_foot_and_not_above_or_below(way, slope, falls):
    light = Light(None, np.array([1, 0, way * slope]) / np.hypot(1, slope), angle=0)
    inside = np.array([(0, 5, 0.9), (0, 5, 0.9)])
    kept = culled_but_kept([(0, 5, 0), (-30, 5, 0)], lights=(light,), box=inside)
    assert kept == [1] * falls


def test_who_glows_stays_wherever_it_is():
    assert culled_but_kept([(0, 5, 0), (-30, 5, 0), (0, -9, 0)], glows=(True, False)) == [1, 2]
    assert culled_but_kept([(0, 5, 0), (-30, 5, 0), (0, -9, 0)], glows=(False, True)) == []


def test_an_open_shutter_keeps_whoever_a_mirror_shows_and_whoevers_shadow_passes_through():
    trajectory = shot()
    policy = LevelPolicy((0.3, 0.6))
    camera = straight()
    both = around(mirrors=(GLASS,))
    trajectory.seconds_per_frame = 8.0
    samples = [(time, (camera,)) for time in (40.0, 40.5, 41.0)]
    blurred = surround(plan(trajectory, camera, policy, 40, samples), both)
    buckets = blurred.buckets, blurred.shadow, blurred.mirrored
    held = np.concatenate([each.order for each in buckets])
    for time in np.linspace(40, 41, 5):
        frame = surround(plan(trajectory, camera, policy, float(time)), both)
        assert not {*frame.shadow.order, *frame.mirrored.order} - set(held)


def test_lost_agents_cast_no_shadow():
    trajectory = shot()
    camera = straight()
    x = trajectory.start.x.copy()
    x[[5, 8]] = np.nan, np.inf
    lost = replace(trajectory, start=replace(trajectory.start, x=x))
    frame = plan(lost, camera, LevelPolicy(()), 1)
    found = surround(frame, around()).shadow.order
    assert len(found) and not {5, 8} & set(found)
