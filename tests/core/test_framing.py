"""A camera that frames a crowd: the exact judge of frusta sees most of it, from eye height."""

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.culling.camera import Camera, Window, framing
from crowd_lod_extension.crowd_lod.validation.exact_frustum import find_visible

ACROSS = 0.6
BELOW = 0.45
ABOVE = 0.2


def seen_of(places):
    view = framing(places, ACROSS, BELOW, ABOVE)
    X = np.array([view.ahead[1], -view.ahead[0], 0])
    Z = np.array([*view.ahead, 0])
    camera = Camera(
        "PERSP",
        view.eye,
        X,
        np.array([0.0, 0, 1]),
        Z,
        Window(-ACROSS, ACROSS, -BELOW, ABOVE),
        0.1,
        view.far,
        (1920, 1080),
    )
    return view, find_visible(camera, places + [0, 0, 1.0], np.full(len(places), 0.3))[0]


def crowd(shape, random):
    if shape == "corridor":
        return random.uniform((0, 0, 0), (60, 3, 0), (2000, 3))
    if shape == "two floors":
        places = random.uniform((0, 0, 0), (30, 20, 0), (2000, 3))
        places[::2, 2] = 6
        return places
    if shape == "one":
        return np.array([[5.0, 6, 7]])
    places = random.normal((1000, -2000, 50), (20, 15, 0), (2000, 3))
    places[0] += 5000  # who is lost
    return places


@pytest.mark.parametrize("shape", ["corridor", "two floors", "one", "far out"])
def test_most_places_are_in_the_frustum_and_all_before_its_end(shape):
    places = crowd(shape, np.random.default_rng(3))
    view, inside = seen_of(places)
    assert inside.mean() >= 0.95
    assert (((places[:, :2] - view.eye[:2]) @ view.ahead) < view.far).all()


def test_the_eye_is_above_the_ground_of_the_densest_part_and_looks_at_it():
    random = np.random.default_rng(5)
    dense = random.uniform((30, 40, 4), (32, 42, 4), (300, 3))
    view, _ = seen_of(np.concatenate([random.uniform((0, 0, 0), (60, 60, 0), (300, 3)), dense]))
    assert view.eye[2] == pytest.approx(5.7)
    way = np.array([31, 41]) - view.eye[:2]
    assert abs(way[0] * view.ahead[1] - way[1] * view.ahead[0]) < 1.5 and way @ view.ahead > 3
