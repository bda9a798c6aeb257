"""What the overlay draws without baked characters: boxes, materials, actions and sizes."""

from dataclasses import replace

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.animation.skinning import SkinnedMesh
from crowd_lod_extension.crowd_lod.crowd.agents import Group
from crowd_lod_extension.operators.viewport import gpu_batches
from crowd_lod_extension.operators.viewport.gpu_batches import GpuBodies
from crowd_lod_extension.operators.viewport.skinned_characters import SkinnedCharacter

from .test_meshes import HEIGHT, WIDTH, hue, instances, picture, row


def test_boxes_are_as_high_as_the_characters():
    groups = (Group("one", 0.9, 1.0, 0.0, 1.0),)
    pixels, matrix = picture(instances([row(0, 0)], [(0, 0, 0, 1)]), GpuBodies(groups, ()))
    v, u = np.nonzero(hue(pixels) == 0)
    half = np.sqrt((1.0 - 0.81) / 2)
    corners = (
        np.array([(x, y, z, 1) for x in (-half, half) for y in (-half, half) for z in (0, 1.8)])
        @ matrix.T
    )
    place = (corners[:, :2] / corners[:, 3:] + 1) / 2 * (WIDTH, HEIGHT)
    assert (u.min(), v.min(), u.max() + 1, v.max() + 1) == pytest.approx(
        (*place.min(0), *place.max(0)), abs=1.1
    )


def test_boxes_drawn_in_runs_are_those_drawn_one_by_one():
    bodies = GpuBodies((Group("one", 0.9, 0.95, 0.0, 1.0),), ())
    rows = [row(x - 4.5, 9.0 - 1.5 * y) for y in range(7) for x in range(10)]  # a run and six more
    first = ((0, 0, 0, 3), (0, 0, 3, 67))
    second = tuple((0, 0, k, 1) for k in range(70))
    runs, single, short = (
        picture(instances(rows, draws), bodies)[0] for draws in (first, second, second[:-1])
    )
    assert (runs == single).all() and (short != single).any()


def quad_character(images, layers):
    points = np.array([(-1, 0, 0), (1, 0, 0), (1, 0, 2), (-1, 0, 2)], np.float32)
    mesh = SkinnedMesh(
        points, np.array([(0, 1, 2), (0, 2, 3)], np.uint32), np.tile(np.float32((0, 0, 1)), (4, 1)), np.zeros((4, 4), np.uint16),
        np.tile(np.float32((1, 0, 0, 0)), (4, 1)), np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32),
        np.tile(np.float32((0.6, 0.3, 0.1)), (4, 1)), np.full(4, layers, np.float32),
    )  # fmt: skip
    return SkinnedCharacter(
        "quad", np.eye(4, dtype=np.float32)[None, None, :3], (mesh,), images, np.ones(3), 0.0, None
    )


def test_materials_show_their_color_or_their_image():
    what = instances([row(0, 0)], [(0, 0, 0, 1)], materials=True)
    nothing = np.empty((0, 1, 1, 4), np.uint8)
    plain, _ = picture(what, GpuBodies((), (quad_character(nothing, -1),)), (0, -4, 1))
    middle = plain[HEIGHT // 2, WIDTH // 2]
    assert middle / middle[0] == pytest.approx([1, 0.5, 1 / 6], abs=1e-4)
    images = np.zeros((2, 2, 2, 4), np.uint8)
    images[1] = ((255, 128, 0, 255), (255, 128, 0, 255)), ((0, 128, 255, 255), (0, 128, 255, 255))
    shown, _ = picture(what, GpuBodies((), (quad_character(images, 1),)), (0, -4, 1))
    below, above = (
        shown[int(HEIGHT * part), WIDTH // 2] / middle for part in (0.344, 0.657)
    )  # the texels' middles
    green = ((128 / 255 + 0.055) / 1.055) ** 2.4
    assert below == pytest.approx([1, green, 0], abs=0.01) and above == pytest.approx(
        [0, green, 1], abs=0.01
    )


@pytest.mark.parametrize("kind", ["FRAMES", "JOINTS"])
def test_a_draw_shows_its_action_and_an_agent_its_size(kind, monkeypatch):
    if kind == "JOINTS":
        monkeypatch.setattr(gpu_batches, "MOST_SKINNED", 0)
    frames = np.repeat(np.eye(4, dtype=np.float32)[None, None, :3], 4, axis=0)
    frames[2:, 0, 2, 3] = (
        0.5,
        1.0,
    )  # its second action, of the last three frames, lifts it by a meter
    body = replace(
        quad_character(np.empty((0, 1, 1, 4), np.uint8), -1),
        frames=frames,
        rows={"": (0, 1), "lift": (1, 3)},
    )
    bodies = GpuBodies((), (body,))
    for action, phase, size, low in (
        ("", 0.75, 1.0, 0.0),
        ("lift", 0.0, 1.0, 0.0),
        ("lift", 0.75, 1.0, 0.75),
        ("lift", 0.5, 0.4, 0.2),
    ):
        what = instances([(*row(0, 0, phase=phase), size)], [(0, 0, 0, 1)], plays=(action,))
        pixels, matrix = picture(what, bodies, (0, -6, 1))
        v, u = np.nonzero(pixels.any(axis=-1))
        corners = (
            np.array([(size * x, 0, low + size * z, 1) for x in (-1, 1) for z in (0, 2)]) @ matrix.T
        )
        place = (corners[:, :2] / corners[:, 3:] + 1) / 2 * (WIDTH, HEIGHT)
        assert (u.min(), v.min(), u.max() + 1, v.max() + 1) == pytest.approx(
            (*place.min(0), *place.max(0)), abs=1.1
        )
