"""Why an agent is shown as it is: every test with its numbers, and what other LODs would cost."""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ..culling.camera import Camera, stretch
from ..culling.frustum import ROUNDING, frustum_of, reach_of
from ..format import aligned, number
from ..levels.assignment import assign, pixels_of
from ..levels.cost_model import NAMES, Costs
from .agent_under_cursor import Account, account
from .frame import Frame

PLANES = "right", "left", "top", "bottom", "near", "far"


@dataclass(frozen=True)
class Side:
    """The test of the agent's bounding sphere against one side of what a camera sees.

    name: of the side.
    outside: meters by which the sphere's center lies beyond the side; below 0 within.
    reach: meters by which it may. A fixed margin is a part of `outside`.
    """

    name: str
    outside: float
    reach: float

    @property
    def passed(self) -> bool:
        return self.outside <= self.reach


@dataclass(frozen=True)
class Alternative:
    """What one LOD of the agent costs and shows.

    begins: meters from which thresholds give it; None for LOD 0, infinite if they never do, or
        always.
    triangles: None if the LOD meshes were not made.
    pixels: by which its surface lies off the character's at most; None if not measured, or behind
        the camera.
    seconds: of the engine, for one more agent.
    mesh_seconds: of the engine, once a frame for all agents that show the same mesh.
    companions: agents of its group that are seen with this LOD, itself not counted.
    """

    level: int
    begins: float | None
    triangles: int | None
    pixels: float | None
    seconds: float | None
    mesh_seconds: float | None
    companions: int


@dataclass(frozen=True)
class Explanation:
    """All that a frame decided on one agent.

    place: world meters of its feet.
    radius: meters, of its bounding sphere.
    away: meters from the first camera to the sphere's center.
    distance: meters from which its LOD follows: of several cameras the least.
    factor: by which the detail map multiplies it.
    by_distance: the LOD that follows from it.
    eyes: for each camera the tests.
    unseen: why it matters though no camera sees it, or "".
    engine, costs: of what the seconds are, and what they rest on.
    """

    account: Account
    place: tuple[float, float, float]
    radius: float
    away: float
    distance: float
    factor: float
    by_distance: int
    eyes: tuple[tuple[Side, ...], ...]
    unseen: str
    engine: str
    costs: str
    alternatives: tuple[Alternative, ...]

    @property
    def as_json(self) -> dict[str, Any]:
        """Return the explanation as plain data; infinite values are None."""
        data: dict[str, Any] = _finite(asdict(self))
        data["eyes"] = [
            [_finite(vars(side)) | {"passed": side.passed} for side in sides] for sides in self.eyes
        ]
        return data

    @property
    def text(self) -> str:
        """Return the explanation as lines of text."""
        about = self.account
        x, y, z = self.place
        lines = [
            f"Agent {about.agent:,} of {about.group}: {about.state}, at ({x:.2f}, {y:.2f}, "
            f"{z:.2f}).",
            f"{'Shown' if about.visible else 'Culled'}: {about.reason}."
            + f" {self.unseen}" * bool(self.unseen),
            f"Its sphere of {number(self.radius)} m is {number(about.depth)} m along the view, "
            f"{number(self.away)} m from the camera"
            + ("." if about.pixels is None else f", {number(about.pixels)} pixels wide."),
        ]
        for eye, sides in enumerate(self.eyes):
            rows = [
                (
                    side.name,
                    f"{side.outside:.3f} m",
                    f"{side.reach:.3f} m",
                    "inside" if side.passed else "outside",
                )
                for side in sides
            ]
            lines += [
                "",
                *aligned(
                    (
                        f"Side, eye {eye}" if len(self.eyes) > 1 else "Side",
                        "Beyond by",
                        "May be",
                        "",
                    ),
                    rows,
                ),
            ]
        detail = "" if self.factor == 1 else f" times {number(self.factor)} by the detail map"
        lines += ["", f"LOD {self.by_distance} by distance: {number(self.distance)} m{detail}."]
        lines += (
            [f"The shot plan: {about.planned}{'' if about.visible else ', when it is seen next'}."]
            if about.planned
            else []
        )
        lines += [
            "",
            *aligned(
                ("LOD", "From", "Triangles", "Pixels off", "Seconds", "Mesh", "Others"),
                [self._row(alternative) for alternative in self.alternatives],
            ),
        ]
        lines += [
            f"Seconds of {NAMES[self.engine]}: for one more agent, and once a frame for the mesh, "
            f"by costs of {self.costs}. Others show the same LOD."
        ]
        return "\n".join(lines)

    def _row(self, alternative: Alternative) -> tuple[str, ...]:
        begins = (
            "-"
            if alternative.begins is None
            else f"{number(alternative.begins)} m"
            if abs(alternative.begins) < np.inf
            else "never"
        )
        begins = "always" if alternative.begins == -np.inf else begins
        mark = "*" if alternative.level == self.account.level and self.account.visible else ""
        return (
            f"{alternative.level}{mark}",
            begins,
            "-" if alternative.triangles is None else f"{alternative.triangles:,}",
            number(alternative.pixels),
            *(
                "-" if seconds is None else f"{seconds:.2e}"
                for seconds in (alternative.seconds, alternative.mesh_seconds)
            ),
            f"{alternative.companions:,}",
        )


def explain_agent(frame: Frame, agent: int, costs: Costs, meters: float = 1.0) -> Explanation:
    """Return all that `frame` decided on one agent.

    costs: of the engine, on the machine that renders.
    meters: in a unit of the scene.
    CrowdError if there is no such agent.
    """
    about = account(frame, agent)
    crowd = frame.crowd
    g = int(frame.crowd.group[agent])
    spheres = frame.trajectory.spheres
    margin = frame.policy.margin
    feet = np.array([crowd.x[agent], crowd.y[agent], crowd.z[agent]], np.float64)
    center = feet + np.array([0.0, 0.0, spheres.center[g]])
    reach = float(spheres.reach[g])
    distance = frame.distances[agent : agent + 1]
    factor = None if frame.factors is None else frame.factors[agent : agent + 1]
    unseen = {
        "Its shadow or its light falls into the picture.": frame.shadow,
        "A mirror shows it.": frame.mirrored,
    }
    return Explanation(
        account=replace(about, depth=about.depth * meters),
        place=(float(feet[0]) * meters, float(feet[1]) * meters, float(feet[2]) * meters),
        radius=reach * meters,
        away=float(np.linalg.norm(center - frame.camera.origin)) * meters,
        distance=float(distance[0]) * meters,
        factor=1.0 if factor is None else float(factor[0]),
        by_distance=int(assign(distance, frame.begins, crowd.group[agent : agent + 1], factor)[0]),
        eyes=tuple(
            _in_meters(sides_of(eye, center, reach if margin is None else 0.0, margin), meters)
            for eye in frame.eyes
        ),
        unseen=" ".join(
            told for told, each in unseen.items() if each is not None and agent in each.order
        ),
        engine=costs.engine,
        costs=costs.basis,
        alternatives=tuple(
            _alternative(frame, about, g, level, costs, meters)
            for level in range(frame.policy.count)
        ),
    )


def sides_of(
    camera: Camera, center: np.ndarray, radius: float, margin: float | None
) -> tuple[Side, ...]:
    """Return the tests by which `radar` decides whether the camera sees a sphere.

    center: (3,) world meters.
    radius: meters; 0 for a fixed margin.
    margin: see RadarOptions.
    """
    v = tuple(np.array([coordinate]) for coordinate in center - camera.origin)
    away = float(np.linalg.norm(center - camera.origin))
    reach, slack = (
        float(coordinate[0])
        for coordinate in reach_of(camera, v, np.array([away]), np.array([radius]))
    )
    if camera.kind != "PANO":
        frustum = frustum_of(camera)
        outside = frustum.normals @ (center - camera.origin) - frustum.limits(margin, ROUNDING)
        return tuple(
            Side(name, float(d), reach + frustum.rounding * slack)
            for name, d in zip(PLANES, outside, strict=True)
        )
    sides = [
        Side("near", camera.near * (1 - ROUNDING) - away, reach + slack),
        Side("far", away - camera.far * (1 + ROUNDING), reach + slack),
    ]
    if camera.cone < np.pi:
        x, y, z = (
            float((center - camera.origin) @ axis) for axis in (camera.X, camera.Y, camera.Z)
        )
        beyond = float(np.hypot(x, y) * np.cos(camera.cone) - z * np.sin(camera.cone))
        sides.append(Side("cone", beyond, (reach + slack) * stretch(camera)[1]))
    return tuple(sides)


def _in_meters(sides: tuple[Side, ...], meters: float) -> tuple[Side, ...]:
    return tuple(Side(side.name, side.outside * meters, side.reach * meters) for side in sides)


def _alternative(
    frame: Frame, about: Account, g: int, level: int, costs: Costs, meters: float
) -> Alternative:
    group = frame.trajectory.groups[g]
    triangles = group.triangles[level] if level < len(group.triangles) else None
    pixels = None
    if level < len(group.bounds) and about.pixels is not None:
        pixels = float(
            pixels_of(
                np.float64(group.bounds[level]),
                np.float64(about.depth),
                frame.camera,
                np.float64(group.radius),
            )
        )
    same = int((frame.crowd.group[frame.buckets[level]] == g).sum())
    return Alternative(
        level=level,
        begins=float(frame.begins[g, level - 1]) * meters if level else None,
        triangles=triangles,
        pixels=pixels,
        seconds=None
        if triangles is None
        else costs.seconds["instances"] + costs.seconds.get("instanced", 0.0) * triangles,
        mesh_seconds=None if triangles is None else costs.seconds["unique"] * triangles,
        companions=same - (about.visible and about.level == level),
    )


def _finite(value: Any) -> Any:
    """Return plain data with None for numbers that are not finite."""
    if isinstance(value, dict):
        return {name: _finite(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
