"""The build that a proof is of: the scene's own, else one that is made for the proof."""

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.frame.frame import Frame
from ....crowd_lod.frame.frame_range import frames_are, shot_frames
from ....crowd_lod.sources.trajectory import Trajectory
from ...blender import mesh_data
from ...blender.provenance import read_inputs
from ...build import bake, frame_update, render_setup
from ...build.shelves import Bucket, BucketKind, members, points_of
from ...build.visibility import layers_of
from ...freshness import artifacts
from ...freshness.bake_frames import (
    CAMERAS,
    cameras_digest,
    differing_in_frame,
    is_bake,
    lights_digest,
)
from ...freshness.parts import RANGE
from ...scene.characters.character_provenance import reading_afresh
from ...scene.shot_reference import SceneMoment

# kinds of builds
MADE = "made for this proof"
LIVE = "build"
BAKE = "bake"

Columns = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class ProvedBuild:
    """The build that is proved.

    top: its collection; None until it is made.
    kind: MADE, LIVE or BAKE.
    changed: names of what has changed since it was made.
    hidden: whether renders do not show it.
    """

    top: bpy.types.Collection | None = None
    kind: str = MADE
    changed: tuple[str, ...] = ()
    hidden: bool = False

    def rows(
        self, trajectory: Trajectory, planned: Frame, poses: frame_update.OpenShutter, number: int
    ) -> dict[Bucket, Columns]:
        """Return the points that each bucket shows in the frame `number`.

        A live build gets the points that renders of that frame give it.

        planned, poses: of the frame.
        """
        if self.kind == MADE:
            return columns_of_members(self.top, trajectory, members(planned), poses, number)
        if self.kind == LIVE:
            frame_update.write(self.top, trajectory, planned, poses, planned.crowd)
        rows = {
            bucket: mesh_data.read_points(points.data)
            for bucket, points in points_of(self.top).items()
        }
        rows = {bucket: columns for bucket, columns in rows.items() if "id" in columns}
        if self.kind == LIVE:
            return rows
        return {
            bucket: {key: values[columns["frame"] == number] for key, values in columns.items()}
            for bucket, columns in rows.items()
        }

    def older_than(self, number: int, moment: SceneMoment) -> list[str]:
        """Return what of a bake's frame `number` was other when it was baked: the camera, the
        lights.
        """
        if self.kind != BAKE:
            return []
        cameras = cameras_digest(moment.eyes)
        return differing_in_frame(self.top, number, cameras, lights_digest(moment.around))


def columns_of_members(
    top: bpy.types.Collection,
    trajectory: Trajectory,
    shown: Mapping[Bucket, np.ndarray],
    poses: frame_update.OpenShutter,
    number: int,
) -> dict[Bucket, Columns]:
    """Return the attributes of each bucket's points in a build.

    shown: the agents (m,) intp that a bucket shows.
    """
    points = points_of(top)
    nobody = np.empty(0, np.intp)
    cast = render_setup.cast_of(top, trajectory)
    return {
        bucket: bake.columns_in_time(trajectory, poses, number, shown.get(bucket, nobody), cast)
        for bucket in points
    }


def build_of(scene: bpy.types.Scene, frames: Sequence[int]) -> Generator[float, None, ProvedBuild]:
    """Read the scene's build, or that none is there yet: yield the progress, return it.

    CrowdError if it cannot follow the scene, or if a bake lacks some of the `frames`.
    """
    top = scene.crowd_lod.build
    if top is None:
        return ProvedBuild()
    render_setup.check_build(scene)
    if is_bake(top):
        missing = sorted(set(frames).difference(baked_frames(scene) or frames))
        if missing:
            raise CrowdError(
                f"The bake of {scene.name} has {shot_frames(sorted(baked_frames(scene)))}, and "
                f"{frames_are(missing)} not in it: "
                "verify frames that are, or bake again."
            )
    else:
        frame_update.update(scene, scene.view_layers[0].depsgraph)
    scene.view_layers[0].update()
    yield from reading_afresh(scene)
    changes = artifacts.changes_of(scene, artifacts.build_artifact(scene))
    changed = tuple(change.part for change in changes if change.part != RANGE)
    places = layers_of(scene).values()
    hidden = top.hide_render or all(place.exclude for place in places)
    return ProvedBuild(top, BAKE if is_bake(top) else LIVE, changed, hidden)


def baked_frames(scene: bpy.types.Scene) -> set[int]:
    """Return the frames that the scene's bake has; none without a bake, or if it does not say."""
    top = scene.crowd_lod.build
    noted = read_inputs(top, CAMERAS) if is_bake(top) else {}
    return {int(number) for number in noted if number.lstrip("-").isdecimal()}


def frames_to_verify(scene: bpy.types.Scene, frames: Sequence[int]) -> list[int]:
    """Return those of the shot's `frames` that the scene's bake has; all of its own if it has none
    of them.
    """
    baked = baked_frames(scene)
    return [number for number in frames if number in baked] or sorted(baked) or list(frames)


def seen_by_kind(
    rows: Mapping[Bucket, Columns], count: int
) -> tuple[dict[BucketKind, np.ndarray], int]:
    """Return (the agents of each kind of bucket, (m,) intp, increasing; how many points are no
    agents).

    count: agents of the crowd.
    """
    agents_of = {}
    strangers = 0
    for kind in BucketKind:
        agents = [
            frame_update.indices_in(columns)
            for bucket, columns in rows.items()
            if bucket.kind is kind
        ]
        every = np.concatenate([np.empty(0, np.int32), *agents])
        known = every[(every >= 0) & (every < count)]
        strangers += len(every) - len(known)
        agents_of[kind] = np.unique(known).astype(np.intp)
    return agents_of, strangers
