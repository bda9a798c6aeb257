"""Far from the origin: positions that Blender has are float32, and nobody whom these show may be
culled.
"""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.behavior.walk import Walk
from crowd_lod_extension.crowd_lod.culling import blocks
from crowd_lod_extension.crowd_lod.culling.frustum import frustum_of
from crowd_lod_extension.crowd_lod.culling.radar import radar
from crowd_lod_extension.crowd_lod.culling.volumes import Light, shades_into, view
from crowd_lod_extension.crowd_lod.frame.frame import plan
from crowd_lod_extension.crowd_lod.frame.shadows import Surroundings, surround
from crowd_lod_extension.crowd_lod.validation.exact_frustum import sees
from crowd_lod_extension.crowd_lod.world.maps import Area, LabelMap

from ..support.crowds import crowd_at, walker
from ..support.culling_audit import LENSES, random_camera
from ..support.machines import machine_of
from ..support.shots import POLICY, full_plan

pytestmark = pytest.mark.once

GROUP = walker()
CENTER = np.array([GROUP.center])
RADIUS = np.array([GROUP.radius])
STANDS = machine_of({"a": {"on": {"*": {}}}})


def in_float32(camera):
    """What Blender holds of the camera: all its numbers in float32."""
    return replace(
        camera,
        **{
            name: np.float64(np.float32(getattr(camera, name)))
            for name in ("origin", "X", "Y", "Z")
        },
    )


def at_the_planes(camera, random, count):
    """Feet (count, 3) of agents whose spheres touch the camera's planes, to within the spacing of
    float32.
    """
    if camera.kind == "PANO":
        way = random.normal(size=(count, 3))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        reach = np.where(
            random.random(count) < 0.5, camera.far + RADIUS, max(camera.near - RADIUS[0], 0.5)
        )
        points = camera.origin + way * reach[:, None]
    else:
        frustum = frustum_of(camera)
        axes = np.array([camera.X, camera.Y, camera.Z])
        depth = camera.near + (camera.far - camera.near) * random.random(count)
        w = camera.window
        at = random.random((count, 2))
        across = [w.left + at[:, 0] * (w.right - w.left), w.bottom + at[:, 1] * (w.top - w.bottom)]
        scale = 1.0 if camera.kind == "ORTHO" else depth
        v = np.array([scale * across[0], scale * across[1], depth]).T @ np.linalg.inv(axes).T
        which = random.integers(6, size=count)
        normal = frustum.normals[which]
        beyond = np.einsum("nd,nd->n", v, normal) - frustum.offsets[which] - RADIUS
        points = camera.origin + v - beyond[:, None] * normal
    spacing = np.spacing(np.float32(np.abs(points).max()))
    return points + random.uniform(-1, 1, (count, 3)) * spacing - [0, 0, GROUP.center]


def seen_in_blender(camera, feet):
    """(n,) bool: whose sphere the camera sees, about the feet (n, 3) in float32, in rational
    arithmetic.
    """
    found = np.zeros(len(feet), bool)
    for i, foot in enumerate(np.float32(feet)):
        center = [
            Fraction(float(foot[0])),
            Fraction(float(foot[1])),
            Fraction(float(foot[2])) + Fraction(GROUP.center),
        ]
        nearby = [
            float(p) for p in center
        ]  # of the sum float64 may miss the last bits: so much more or less of a radius
        off = float(abs(Fraction(nearby[2]) - center[2]))
        found[i] = sees(camera, nearby, GROUP.radius - off)
    return found


def shot(feet):
    low = feet.min(axis=0) - 10
    high = feet.max(axis=0) + 10
    world = LabelMap(np.zeros((1, 1), np.uint8), Area(low[0], low[1], high[0], high[1]))
    return Walk(crowd_at(feet), STANDS, world, (GROUP,), 1 / 24, 0)


@pytest.mark.parametrize("away", [0.0, 1e3, 1e5, 1e6, 1e7])
@pytest.mark.parametrize("lens", LENSES)
def test_nobody_is_culled_whom_float32_positions_show(lens, away, in_blocks, monkeypatch):
    monkeypatch.setattr(blocks, "SIZE", 4)
    random = np.random.default_rng([list(LENSES).index(lens), int(away)])
    missed = 0
    beside = 0
    for _ in range(8):
        way = random.normal(size=3) * [1, 1, 0.1]
        camera = random_camera(random, lens)
        camera = in_float32(
            replace(camera, origin=camera.origin + away * way / np.linalg.norm(way))
        )
        feet = at_the_planes(camera, random, 60)
        seen = seen_in_blender(camera, feet)
        frames = [planned(shot(feet), camera, POLICY, 0) for planned in (plan, full_plan)]
        for frame in frames:
            assert not (seen & ~frame.visible).any()
        assert (frames[0].visible == frames[1].visible).all()
        bare = radar(crowd_at(feet), camera, CENTER, RADIUS)[0]
        missed += (seen & ~bare).sum()
        beside += seen.sum()
    assert beside > 60 and (
        missed or away < 1e5
    )  # the positions' own rounding makes the difference


@pytest.mark.parametrize("away, meters", [(0.0, 1e-3), (1e3, 1e-2), (1e6, 5.0)])
def test_who_is_clearly_outside_is_culled_all_the_same(away, meters):
    """Near the origin the bound is a tenth of a millimeter for each 100 m."""
    random = np.random.default_rng(1)
    culled = 0
    for _ in range(20):
        camera = random_camera(random, "normal")
        camera = in_float32(
            replace(camera, origin=np.array([away, -away / 3, 2]), near=0.1, far=100.0)
        )
        feet = at_the_planes(camera, random, 60) + random.uniform(-3, 3, (60, 3)) * meters
        v = feet + [0, 0, GROUP.center] - camera.origin
        outside = (
            (v @ frustum_of(camera).normals.T - frustum_of(camera).offsets) > GROUP.radius + meters
        ).any(axis=1)
        assert not (outside & plan(shot(feet), camera, POLICY, 0).visible).any()
        culled += outside.sum()
    assert culled > 100


def where_rays_start(points, normals):
    """Where Cycles starts the rays that leave a surface at `points` (n, 3) float32 with the unit
    `normals`, once they would hit it again: so many representable numbers away along each axis (Ray
    Tracing Gems, chapter 6; Cycles' ray_offset)."""
    steps = np.trunc(256 * normals).astype(np.int32)
    moved = (points.view(np.int32) + np.where(points < 0, -steps, steps)).view(np.float32)
    return np.where(np.abs(points) < 1 / 32, points + np.float32(normals / 65536), moved).astype(
        np.float64
    )


@pytest.mark.parametrize("away", [0.0, 1e3, 1e5, 9e5])
@pytest.mark.parametrize("kind", ["sun", "spot"])
def test_no_shadow_is_missed_by_rays_that_start_beside_their_surface(kind, away):
    """Of points at a side of the picture, lit along it, so that a ray beside them never comes into
    the picture.
    """
    random = np.random.default_rng([kind == "sun", int(away)])
    asked = 0
    missed = 0
    for _ in range(10):
        camera = random_camera(random, "normal")
        way = random.normal(size=3) * [1, 1, 0.1]
        camera = in_float32(
            replace(
                camera, origin=camera.origin + away * way / np.linalg.norm(way), near=0.1, far=100.0
            )
        )
        out = frustum_of(camera).normals[random.integers(4)]
        w = camera.window
        depth = random.uniform(20, 90, 40)
        slopes = random.uniform([w.left, w.bottom], [w.right, w.top], (40, 2))
        v = (
            np.array([*(slopes.T * depth), depth]).T
            @ np.linalg.inv([camera.X, camera.Y, camera.Z]).T
        )
        points = np.float32(camera.origin + v - (v @ out)[:, None] * out)
        seen = (
            (points - camera.origin) @ frustum_of(camera).normals.T
            <= frustum_of(camera).offsets + 1e-7 * (1 + away)
        ).all(axis=1)
        sun = np.cross(out, random.normal(size=3))
        sun /= np.linalg.norm(sun)
        starts = where_rays_start(points, np.broadcast_to(out, points.shape))
        lamp = points[0] + 200 * sun
        light = Light(None, -sun, angle=0.0)
        to_light = np.broadcast_to(200 * sun, points.shape)
        if kind == "spot":
            light = Light(lamp, -sun, angle=0.4)
            to_light = lamp - starts
            beside = (points - lamp) @ -sun / np.linalg.norm(points - lamp, axis=1)
            seen &= np.arccos(beside.clip(-1, 1)) < 0.4
        aside = out - (to_light @ out / (to_light**2).sum(axis=1))[:, None] * to_light
        aside /= np.linalg.norm(aside, axis=1)[:, None]
        centers = (
            starts + random.uniform(0, 0.5, (40, 1)) * to_light + (1 - 1e-6) * GROUP.radius * aside
        )  # rays just touch them
        feet = centers - [0, 0, GROUP.center]
        frame = plan(shot(feet), camera, POLICY, 0)
        seen &= ~frame.visible
        kept = np.isin(np.arange(40), surround(frame, Surroundings((light,))).shadow.order)
        assert not (seen & ~kept).any()
        asked += seen.sum()
        missed += (
            seen & ~shades_into(view(camera), light, centers, np.full(40, GROUP.radius))
        ).sum()
    assert asked > 20 and missed > asked / 4  # the rays' own way makes the difference
