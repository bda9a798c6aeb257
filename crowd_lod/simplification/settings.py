"""The numbers of simplification.

Lengths are of a mesh of unit size. "The worst distance" is that of a fit, see surface_fit.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """How often, how far and how carefully: each field says its unit and why."""

    # Bulk: fast-simplification's collapses, cheap but without knowledge of poses.
    # times the triangles wanted, that it leaves at least: the last collapses are chosen better
    bulk_margin: float = 1.1
    bulk_part: float = 0.04  # of the source's triangles, that it leaves besides
    # triangles, that it leaves at least of a mesh with seams, of which it knows nothing
    bulk_seamed: int = 30_000
    bulk_posed: int = 60_000  # the same of a mesh with poses
    bulk_aggression: int = 3  # its care; its own default of 7 errs more
    # weight of the planes that it leaves, of those of the source: a flat face keeps its corners
    bulk_planes: float = 0.5

    # Quadrics and collapses.
    # part of the triangles: where fewer are wanted and nothing moves, seams weigh less, by its cube
    seams_yield: float = 0.1
    seams_posed: float = 0.5  # weight of seams in each pose, of that at rest: they add up
    # of its area, that a collapse's error is divided by: 0 spares large faces, 1 all alike
    area_power: float = 0.9
    # weight of an edge's middle against the planes: decides where they leave a choice
    midpoint: float = 1e-9
    facing: float = 0.2  # least cosine between a triangle's normals before and after a collapse
    facing_last: float = -1.0  # the same where nothing else is left to collapse
    # twice a triangle's area over its squared sides: no collapse makes a thinner one
    thinnest: float = 0.001
    round_part: float = 0.15  # of a round's edges, the cheapest, that may collapse in it
    round_passes: int = 6  # choices of edges in a round

    # Poses.
    poses: int = 3  # besides the one at rest, that decimation heeds
    pose_triangles: int = 5_000  # triangles that tell poses apart, about
    pose_least: float = 1e-3  # mean change of an edge's turn, below which poses are alike
    # of an edge's length, that the axes count where a vertex's triangles tell nothing
    pose_axes: float = 1e-3
    # sizes of the mesh between its copies in the poses: none is nearest to another
    pose_gap: float = 2.0
    # times that the mesh at rest is as large as in its poses: there distances count more
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
    damping: float = 0.01  # weight, of all vertices' mean, that holds a vertex in place
    weight_kept: float = 0.8  # part of a sample's weight that it has for the next move
    # of a sample's distance over the worst near it, which each move adds to its weight
    weight_power: float = 10.0
    weight_local: float = 0.8  # power of the worst near it, against the worst of all
    halvings: int = 3  # times that a move which turns a triangle is halved before it is left
    near_enough: float = 1e-6  # worst distance below which nothing is moved
    # of the worst distance, that an edge's triangles are off at least before it is flipped
    flip_from: float = 0.6
    flip_gain: float = 0.9  # of its triangles' distance, that a flip must at least come down to
    # times the worst distance that flips together may lead to, or none is made
    flip_loss: float = 1.05

    # Fit: new samples between the others.
    resamplings: int = 3  # at most
    # times farther off than known, that a resampling must find something for another one
    resample_gain: float = 1.1
    resample_from: float = 0.6  # of the worst distance: near samples as far off, it adds others
    # cosine between a triangle and what it is nearest to, below which it does so, too
    resample_steep: float = 0.5
    resample_few: int = 2  # samples along an edge, up to which it does so on all triangles
    resample_kept: float = 0.9  # of the worst distance: what is as far off is a sample from then on

    # Loose parts.
    # of how far a collapse leaves a point of the source behind, what it counts against a part:
    # the fit moves surfaces nearer
    parts_fitted: float = 0.25
    parts_larger: float = 4.0  # times as large as a part, that another must be to outlast it
    parts_near: float = 4.0  # of a part's radius, that it may reach away from such a one
    parts_lost: float = 0.03  # of a part's area, that it may show less than the source's
    parts_flat: float = 0.01  # of a part's length: no thicker, it is flat
    parts_grown: float = 1.0  # of the worst distance, that parts may be widened by to show as much

    # Walks to closest points.
    walk_steps: int = 40  # along a surface to the nearest triangle, at most
    # of the largest distance: beyond it a point's nearest triangle is sought again
    walk_again: float = 0.5
    doubt_points: int = 32  # those farthest off, whose walks may have ended at a wrong place
    doubt_rounds: int = 12  # times that such are doubted, at most, while any of them was wrong

    # The bound of the Hausdorff distance.
    bound_tolerance: float = 0.03  # part of what was measured, by which the bound may lie above it
    bound_floor: float = 5e-5  # of the size: no bound need be lower
    bound_depth: int = 10  # times that pieces are divided, at most
    # of one surface in a pose; where there would be more, the bound is left as it is
    bound_pieces: int = 400_000
    # points of each pose that are measured first, those which may be farthest off
    bound_first: int = 8
    bound_spokes: int = 4  # edges that one side of a piece crosses, at most
    # of the way to a piece's middle: where the triangles beneath its corners are sought
    bound_inside: float = 0.1

    # Thin parts, which a LOD may show from some sides alone.
    # of the size: samples of a large triangle are no farther apart
    thin_spacing: float = 1 / 32
    # of the deviation: what is thinner is less than half a pixel wide where a LOD of a pixel begins
    thin_least: float = 0.5
    # of a thickness, that a LOD must have: of half a pixel, 16 samples in a pixel then meet it
    thin_shown: float = 0.25


CURRENT = Settings()
