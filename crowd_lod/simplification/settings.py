"""The numbers of simplification.

Lengths are of a mesh of unit size. "The worst distance" is that of a fit, see surface_fit.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Each field says its unit, and what it decides."""

    # Bulk: fast-simplification's collapses, cheap but without knowledge of poses. It leaves
    # bulk_margin x the triangles wanted + bulk_part x the source's: the last collapses are chosen
    # better.
    bulk_margin: float = 1.1
    bulk_part: float = 0.04
    # triangles that it leaves at least: of a mesh with seams, which it does not know, with poses
    bulk_seamed: int = 30_000
    bulk_posed: int = 60_000
    bulk_aggression: int = 3  # its care; its own default of 7 errs more
    # weight of the planes of what it leaves, beside the source's: a flat face keeps its corners
    bulk_planes: float = 0.5

    # Quadrics and collapses.
    # Where a smaller part of the triangles than this is wanted, and nothing moves, seams weigh
    # less: by the cube of the ratio of the two.
    seams_yield: float = 0.1
    seams_posed: float = 0.5  # weight of seams in each pose, relative to rest: they add up
    # A collapse's error is divided by its area to this power: 0 spares large faces, 1 treats all
    # alike.
    area_power: float = 0.9
    # weight of an edge's middle against the planes: decides where they leave a choice
    midpoint: float = 1e-9
    facing: float = 0.2  # least cosine between a triangle's normals before and after a collapse
    facing_last: float = -1.0  # the same where nothing else is left to collapse
    # No collapse makes a triangle thinner than this: twice its area over the sum of squared sides.
    thinnest: float = 0.001
    round_part: float = 0.15  # part of the edges, the cheapest, that may collapse in a round
    round_passes: int = 6  # choices of edges in a round

    # Poses.
    poses: int = 3  # besides the one at rest, that decimation heeds
    pose_triangles: int = 5_000  # triangles by which poses are compared, about
    pose_least: float = 1e-3  # mean change of an edge's turn, below which poses are alike
    # weight of the three axes, as part of an edge's length: they decide where a vertex's triangles
    # do not
    pose_axes: float = 1e-3
    # sizes of the mesh between its copies in the poses, so that no copy is nearest to another
    pose_gap: float = 2.0
    # The copy at rest is larger by this factor, so that distances count more there.
    rest_scale: float = 2.0

    # Fit: rounds of moves.
    moves: int = 1_100_000  # samples moved, at least: the work on a small mesh
    # samples moved for each of the source's triangles: the work on a large mesh
    moves_each: float = 17
    rounds: tuple[int, int] = (1, 40)  # at least and at most
    steps: int = 8  # moves in a round
    samples: int = 15_000  # of the LOD's surface, about
    samples_finest: int = 5  # along an edge, at most
    samples_posed: int = 3_000  # of the source's vertices, about, that count in each pose
    stride: float = 0.8  # part of each move that is made
    damping: float = 0.01  # weight that holds a vertex in place, as part of all vertices' mean
    weight_kept: float = 0.8  # part of a sample's weight that it keeps for the next move
    # Each move adds to a sample's weight its distance over the worst near it, to this power.
    weight_power: float = 10.0
    # That worst is a mean of the worst near it and the worst of all; this is the former's exponent.
    weight_local: float = 0.8
    halvings: int = 3  # times that a move which turns a triangle is halved before it is dropped
    near_enough: float = 1e-6  # worst distance below which nothing is moved
    # An edge is flipped only if its triangles are off by this part of the worst distance at least,
    # and by flip_gain of that at most afterwards.
    flip_from: float = 0.6
    flip_gain: float = 0.9
    # If the flips of a round raise the worst distance by more than this factor, none is made.
    flip_loss: float = 1.05

    # Fit: new samples between the others.
    resamplings: int = 3  # at most
    # Another one follows if this one found a distance as many times larger than the one known.
    resample_gain: float = 1.1
    # Triangles get new samples where they are off by this part of the worst distance, or where the
    # cosine to the nearest triangle is below resample_steep; all of them up to resample_few samples
    # along an edge.
    resample_from: float = 0.6
    resample_steep: float = 0.5
    resample_few: int = 2
    resample_kept: float = 0.9  # new samples that are off by this part of the worst distance stay

    # Loose parts.
    # A point of the source that a collapse leaves behind counts with this part of the distance: the
    # fit brings the surfaces nearer afterwards.
    parts_fitted: float = 0.25
    # A part is replaced by one that is parts_larger times its size, if it lies within parts_near
    # times its own radius of that.
    parts_larger: float = 4.0
    parts_near: float = 4.0
    # A part is widened if its silhouette is smaller than the source's by more than this part, by at
    # most parts_grown times the worst distance.
    parts_lost: float = 0.03
    parts_grown: float = 1.0
    parts_flat: float = 0.01  # a part whose thickness is less than this part of its length is flat

    # Walks to closest points.
    walk_steps: int = 40  # along a surface to the nearest triangle, at most
    # Points that are off by this part of the largest distance search their nearest triangle again.
    walk_again: float = 0.5
    doubt_points: int = 32  # those farthest off, whose walks may have ended at a wrong place
    doubt_rounds: int = 12  # searches for these, at most, while one of them was wrong

    # The bound of the Hausdorff distance.
    bound_tolerance: float = 0.03  # the bound is larger by this part than what was measured
    bound_floor: float = 5e-5  # of the size: no bound need be lower
    bound_depth: int = 10  # times that pieces are divided, at most
    # pieces of one surface in a pose; where there would be more, the bound is left as it is
    bound_pieces: int = 400_000
    # points of each pose that are measured first, those which may be farthest off
    bound_first: int = 8
    bound_spokes: int = 4  # edges that one side of a piece crosses, at most
    # The triangle beneath a piece's corner is sought this part of the way to the piece's middle.
    bound_inside: float = 0.1

    # Thin parts, which a LOD may show from some sides alone.
    thin_spacing: float = 1 / 32  # of the size, between samples of a large triangle at most
    # of the deviation: what is thinner is less than half a pixel wide where a LOD of a pixel begins
    thin_least: float = 0.5
    # A LOD must have this part of a thickness. Of half a pixel, 16 samples in a pixel then meet it.
    thin_shown: float = 0.25


CURRENT = Settings()
