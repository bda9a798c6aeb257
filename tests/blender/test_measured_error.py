"""Use Measured Error: after a proof that failed, the LOD that is off begins farther away."""

import bpy
import pytest
from crowd_lod_extension.operators.freshness.artifacts import (
    ProofResult,
    note_proof,
    proof_parts,
    reasons,
)
from crowd_lod_extension.operators.scene.scene_crowd import read_crowd
from crowd_lod_extension.operators.scene.shot_reference import frame_of, moment_now


def note_failure(scene, **changes):
    """A proof in which agent 3, of the first group, is off by twice what its LOD 1 allows."""
    worst = {"agent": 3, "group": 0, "lod": 1, "frame": 5, "error_px": 3.0, "predicted_px": 1.5}
    note_proof(scene, ProofResult("Failed.", False, proof_parts(scene), worst | changes))


def starts(scene):
    """Where each LOD of the first group begins."""
    moment = moment_now(scene, scene.view_layers[0].depsgraph)
    return frame_of(read_crowd(scene), moment).thresholds[0]


def test_the_lod_begins_at_twice_the_distance_and_coarser_ones_no_nearer(by_tolerance):
    group = by_tolerance.crowd_lod.groups[0]
    before, bounds = starts(by_tolerance), [*group.bounds]
    note_failure(by_tolerance)
    assert bpy.ops.crowd_lod.use_measured_error() == {"FINISHED"}
    assert group.bounds[1] == pytest.approx(2 * bounds[1])
    now = starts(by_tolerance)
    assert len(now) > 1
    # agents are seen as large as their nearest point
    assert now[0] - group.radius == pytest.approx(2 * (before[0] - group.radius), rel=1e-3)
    assert (now >= before - 1e-6).all() and (now[1:] >= now[:-1]).all()
    assert "crowd_lod.make_levels" not in reasons(by_tolerance)


def test_what_no_lod_explains_is_not_mended(by_tolerance):
    assert not bpy.ops.crowd_lod.use_measured_error.poll()
    note_failure(by_tolerance, predicted_px=0.0)
    assert not bpy.ops.crowd_lod.use_measured_error.poll()
    note_failure(by_tolerance)
    assert bpy.ops.crowd_lod.use_measured_error.poll()
    by_tolerance.crowd_lod.choice = "BY_DISTANCE"
    assert not bpy.ops.crowd_lod.use_measured_error.poll()


def test_the_agent_is_shown_and_pinned(by_tolerance):
    settings = by_tolerance.crowd_lod
    assert bpy.ops.crowd_lod.go_to_switch(frame=5, agent=3) == {"FINISHED"}
    assert (by_tolerance.frame_current, settings.agent) == (5, 3)
    assert bpy.ops.crowd_lod.override_agent(type="ALWAYS", agent=4, level=0) == {"FINISHED"}
    (entry,) = settings.overrides
    assert (entry.type, entry.agents, entry.level) == ("ALWAYS", "4", 0)
