import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.levels import LevelPolicy, assign
from crowd_lod_extension.crowd_lod.sorting import sort


def test_listing_1_3_and_equation_1_7_agree_but_for_the_threshold_itself():
    thresholds, far = (0.1, 0.25, 0.6), 80.0
    distance = np.array([-5.0, 0, 7.999, 8, 8.001, 19.9, 20, 47.9, 48, 80, 1e9])
    ifs = []
    for d in distance:  # U(0) = 1: on the threshold the coarser LOD begins
        ifs.append(0 if d < 8 else 1 if d < 20 else 2 if d < 48 else 3)
    assert assign(distance, far, thresholds).tolist() == ifs


def test_far_plane_never_gives_an_id_beyond_the_last_mesh():
    policy = LevelPolicy((0.5, 1.0))
    assert assign(np.array([100.0, 1e12]), 100.0, policy.thresholds).max() == policy.count - 1


@pytest.mark.parametrize("thresholds", [(0.5, 0.5), (0.5, 0.4), (0.0,), (-0.1, 0.5), (0.2, 1.1), (np.nan,), (0.1,) * 8])
def test_thresholds_that_do_not_increase_are_refused(thresholds):
    with pytest.raises(CrowdError, match="threshold|levels"):
        LevelPolicy(tuple(thresholds))


@pytest.mark.parametrize("margin", [-1.0, np.nan, np.inf])
def test_margin_must_be_a_length(margin):
    with pytest.raises(CrowdError, match="margin"):
        LevelPolicy((), margin=margin)


@pytest.mark.parametrize("count", [0, 1, 5000])
def test_buckets_are_contiguous_complete_and_in_agent_order(count):
    random = np.random.default_rng(count)
    visible, ids = random.random(count) < 0.6, random.integers(4, size=count).astype(np.uint8)
    buckets = sort(visible, ids, 5)
    assert buckets.counts.sum() == visible.sum() == len(buckets.order)
    for level in range(5):
        brute = [i for i in range(count) if visible[i] and ids[i] == level]
        assert buckets[level].tolist() == brute
