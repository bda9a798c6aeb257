"""Strategies for Hypothesis: any map, state machine, camera, policy and shot.

What there is much of, such as agents and pixels, comes from a seed.
"""

from dataclasses import replace

import numpy as np
from crowd_lod_extension.crowd_lod.culling.camera import lens_blur
from crowd_lod_extension.crowd_lod.culling.shutter import open_shutter
from crowd_lod_extension.crowd_lod.levels.assignment import Bias, LevelPolicy
from crowd_lod_extension.crowd_lod.world.height_map import HeightMap
from hypothesis import strategies as st

from .culling_audit import LENSES, random_camera
from .shots import AREA, ground, machine, shot

seeds = st.integers(0, 2**32 - 1)
generators = seeds.map(np.random.default_rng)


def powers(low, high):
    """Numbers from 10^low to 10^high, of any size."""
    return st.floats(low, high).map(lambda exponent: 10.0**exponent)


def sometimes(strategy, otherwise=None):
    return st.just(otherwise) | strategy


@st.composite
def tables(draw):
    """A table of one to three states over two labels: who stands, walks, changes, draws or is
    timed.
    """
    names = ["a", "b", "c"][: draw(st.integers(1, 3))]
    still = draw(st.booleans())
    constant = draw(st.booleans())
    part = st.integers(-3000, 3000).map(lambda hundredths: hundredths / 100)
    move = st.just([0, 0]) if still else st.lists(part, min_size=2, max_size=2)
    any_of = st.sampled_from(names)
    weights = any_of | st.just({name: 1 for name in names})
    states = {}
    for k, name in enumerate(names):
        rule = st.fixed_dictionaries({"move": move, "next": st.just(name) if constant else weights})
        on = {label: draw(rule) for label in ("ground", "wall")}
        states[name] = {"color": f"#ff{k:02x}00", "start": draw(st.integers(1, 2)), "on": on}
        if draw(st.booleans()):
            states[name] |= {"after": [0.1, 0.3], "then": draw(any_of)}
    return machine(states, draw(st.sampled_from(["clamp", "wrap", "reflect", "stop"])))


# maps with one wall, or with none
grounds = st.lists(st.tuples(st.integers(0, 6), st.integers(0, 8)), max_size=1).map(ground)
# of any lens, at any place
cameras = st.builds(random_camera, generators, st.sampled_from(list(LENSES)))


@st.composite
def cameras_of_crowd(draw):
    """One camera, or two eyes, that looks at the crowd from near or far, perhaps blurred."""
    camera = draw(cameras)
    camera = replace(camera, origin=np.array([0, 50, 1]) - camera.Z * draw(powers(0, 4)))
    if draw(st.booleans()):
        camera = lens_blur(camera, 0.05, 10.0)
    return (
        (camera, replace(camera, origin=camera.origin + camera.X * 0.1))
        if draw(st.booleans())
        else camera
    )


@st.composite
def policies(draw, groups=1):
    """Any LODs by distance, perhaps others for each group."""
    part = st.floats(0.01, 1)
    steps = tuple(sorted(draw(st.lists(part, max_size=3, unique=True))))
    own = st.tuples(
        *(st.just(tuple(step**power for step in steps)) for power in range(1, groups + 1))
    )
    margin = draw(sometimes(st.just(0.5)))
    return LevelPolicy(steps, margin, group_thresholds=draw(sometimes(own, ())))


@st.composite
def trajectories(draw, groups, counts):
    """A crowd of these groups, one or more, that does as any table says, on flat ground or on
    hills.
    """
    own = tuple(draw(st.lists(st.sampled_from(groups), min_size=1, max_size=3)))
    heights = draw(
        sometimes(generators.map(lambda random: HeightMap(random.random((4, 5), np.float32), AREA)))
    )
    return shot(
        draw(tables()),
        draw(grounds),
        own,
        draw(st.sampled_from(counts)),
        draw(seeds),
        heights=heights,
    )


@st.composite
def shots(draw, groups, counts):
    """(trajectory, camera, policy, shutter, bias) as `plan` takes them, before and after the
    time.
    """
    trajectory = draw(trajectories(groups, counts))
    camera = draw(cameras_of_crowd())
    shutter = ()
    eyes = camera if isinstance(camera, tuple) else (camera,)
    if draw(st.booleans()):
        moving = [
            [replace(eye, origin=eye.origin + eye.X * part) for part in (0, 0.1)] for eye in eyes
        ]
        shutter = list(
            zip((8.5, 9.0), zip(*(open_shutter(each) for each in moving), strict=True), strict=True)
        )
    bias = draw(sometimes(generators.map(lambda random: Bias(random.random((3, 3)), AREA))))
    return trajectory, camera, draw(policies(len(trajectory.groups))), shutter, bias
