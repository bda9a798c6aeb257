import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.crowd.agents import Draw, Group
from crowd_lod_extension.crowd_lod.crowd.bounds import bounding_sphere, cover_sizes
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.world.first_frame import populate
from crowd_lod_extension.crowd_lod.world.maps import Area

from ..support.shots import chapter

MACHINE, WORLD = chapter(Area(-10, 5, 30, 25, 2.0))


def test_same_seed_same_crowd_bit_for_bit_and_another_seed_another():
    a, b, c = (populate(5000, seed, 3, MACHINE, WORLD) for seed in (7, 7, 8))
    for name, column in a.columns.items():
        assert column.tobytes() == b.columns[name].tobytes()
    assert (a.x != c.x).any()


def test_crowd_starts_where_it_may_and_spreads_evenly():
    crowd = populate(20_000, 1, 3, MACHINE, WORLD)
    assert MACHINE.spawn[WORLD.at(crowd.x, crowd.y)].all()
    assert (crowd.y >= 5).all() and (crowd.y < 25).all() and (crowd.z == 2).all()
    assert (crowd.state == 0).all()  # the chapter's start: all walk right
    assert (crowd.heading == 0).all()
    assert abs(np.bincount(crowd.phase_class, minlength=16) - 20_000 / 16).max() < 5 * np.sqrt(
        20_000 * 15 / 16**2
    )
    # 20,000 fair draws into 3 groups and 4 quarters stay within 5 standard deviations
    assert abs(np.bincount(crowd.group, minlength=3) - 20_000 / 3).max() < 5 * np.sqrt(
        20_000 * 2 / 9
    )
    quarters = np.bincount((crowd.x > 10) * 2 + (crowd.y > 15), minlength=4)
    assert abs(quarters - 5000).max() < 5 * np.sqrt(20_000 * 3 / 16)


def test_groups_get_their_shares_of_the_agents():
    crowd = populate(20_000, 1, (3.0, 0.0, 1.0, 0.0), MACHINE, WORLD)
    counts = np.bincount(crowd.group, minlength=4)
    assert counts[1] == counts[3] == 0 and (np.diff(crowd.group) >= 0).all()
    assert abs(counts[0] - 15_000) < 5 * np.sqrt(20_000 * 3 / 16)
    with pytest.raises(CrowdError, match="give one a share above 0"):
        populate(10, 1, (0.0, 0.0), MACHINE, WORLD)


def test_agents_are_drawn_from_some_of_the_groups():
    crowd = populate(20_000, 1, Draw((3.0, 1.0), (1, 4)), MACHINE, WORLD)
    plain = populate(20_000, 1, (3.0, 1.0), MACHINE, WORLD)
    assert (crowd.group == np.array([1, 4])[plain.group]).all() and (crowd.x == plain.x).all()


@pytest.mark.parametrize("count", [0, -1, 10_000_001])
def test_impossible_counts_are_refused(count):
    with pytest.raises(CrowdError, match="agents"):
        populate(count, 0, 1, MACHINE, WORLD)


def test_bounding_sphere_holds_the_points_at_every_heading():
    points = np.random.default_rng(3).normal(size=(500, 3)) * (0.3, 0.2, 0.9) + (0.1, 0, 0.9)
    center, radius = bounding_sphere(points)
    for angle in np.linspace(0, 6, 13):
        c = np.cos(angle)
        s = np.sin(angle)
        turned = points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        distance = np.linalg.norm(turned - (0, 0, center), axis=1).max()
        assert distance == pytest.approx(radius, rel=1e-12)


def test_the_sphere_of_a_group_holds_its_agents_of_all_sizes():
    points = np.random.default_rng(3).normal(size=(500, 3)) * (0.3, 0.2, 0.9) + (0.1, 0, 0.9)
    group = cover_sizes(
        Group(
            "one",
            *bounding_sphere(points),
            1.0,
            1.0,
            bounds=(0.0, 0.1),
            deviations=(0.0, 0.08),
            scale=(0.4, 1.7),
            girth=np.hypot(*points[:, :2].T).max(),
        )
    )
    for size in np.linspace(0.4, 1.7, 14):
        assert np.linalg.norm(size * points - (0, 0, group.center), axis=1).max() <= group.radius
        assert size * np.hypot(*points[:, :2].T).max() <= group.girth
    assert group.bounds[1] >= 1.7 * 0.1 and group.deviations[1] == pytest.approx(0.136)
    assert group.radius < 1.71 * bounding_sphere(points)[1]
