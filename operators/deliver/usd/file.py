"""The file: one point instancer with all prototypes, and materials."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ....crowd_lod.errors import CrowdError
from ....crowd_lod.format import printable
from ....crowd_lod.frame.instances import Instances
from ...blender import scene_data
from .materials import Materials
from .prototypes import Form

BUFFERS = {
    "points": "Vec3fArray",
    "normals": "Vec3fArray",
    "sizes": "IntArray",
    "corners": "IntArray",
    "uv": "Vec2fArray",
}
PER = {"POINT": "vertex", "FACE": "uniform", "CORNER": "faceVarying"}  # Blender's domains


class CrowdFile:
    """A USD file while it is written. A context: it is closed at the end, saved or not.

    usd: of openusd.openusd. path: where the file will be; hidden: the folder where it is until
    then.
    cast: its agents and prototypes, and a name for each of these; no two are the same.
    """

    ROOT = "/Crowd"
    AGENTS = f"{ROOT}/Agents"
    CAMERA = f"{ROOT}/Camera"
    MATERIALS = f"{ROOT}/Materials"
    PROTOTYPES = f"{AGENTS}/Prototypes"

    def __init__(
        self,
        usd,
        scene: bpy.types.Scene,
        path: Path,
        hidden: Path,
        cast: tuple[Instances, Sequence[str]],
    ):
        self.usd = usd
        self.scene = scene
        self.path = path
        instances, names = cast
        self._homes = {
            prototype: f"{self.PROTOTYPES}/{usd.Tf.MakeValidIdentifier(name)}"
            for prototype, name in zip(instances.prototypes.tolist(), names, strict=True)
        }
        with self._writing():
            self.stage = usd.Usd.Stage.CreateNew(str(hidden / path.name))
        geometry = usd.UsdGeom
        geometry.SetStageUpAxis(self.stage, geometry.Tokens.z)
        geometry.SetStageMetersPerUnit(self.stage, scene_data.meters(scene))
        root = geometry.Xform.Define(self.stage, self.ROOT)
        self.stage.SetDefaultPrim(root.GetPrim())
        self.model = geometry.ModelAPI.Apply(root.GetPrim())
        usd.Usd.ModelAPI(root.GetPrim()).SetKind("component")
        self.instancer = geometry.PointInstancer.Define(self.stage, self.AGENTS)
        for scope in (self.PROTOTYPES, self.MATERIALS):
            geometry.Scope.Define(self.stage, scope)
        self.materials = Materials(usd, self.stage, self.MATERIALS, path, hidden)
        self._reach = 0.0
        self._meshes = {}
        relation = self.instancer.CreatePrototypesRel()
        for home in self._homes.values():
            prototype = geometry.Xform.Define(self.stage, home)
            usd.Usd.ModelAPI(prototype.GetPrim()).SetKind("subcomponent")
            relation.AddTarget(home)
        self.instancer.CreateIdsAttr(usd.Vt.Int64Array.FromNumpy(instances.agents.astype(np.int64)))

    def __enter__(self) -> "CrowdFile":
        return self

    def __exit__(self, *error) -> None:
        self.stage = self.model = self.instancer = self.materials = self._meshes = None

    def mesh(self, prototype: int, name: str, form: Form, frame: float | None) -> None:
        """Write a mesh of a prototype, or its points and normals at `frame`."""
        key = prototype, name
        usd_mesh = self._meshes.get(key)
        if usd_mesh is None:
            usd_mesh = self._meshes[key] = self._new_mesh(prototype, name, form)
        arrays = {field: self._array(field, form) for field in ("points", "normals")}
        usd_mesh.GetPointsAttr().Set(arrays["points"], *(() if frame is None else (frame,)))
        usd_mesh.GetNormalsAttr().Set(arrays["normals"], *(() if frame is None else (frame,)))
        corners = form.points.min(axis=0), form.points.max(axis=0)
        extent = self.usd.Vt.Vec3fArray.FromNumpy(np.array(corners, np.float32))
        usd_mesh.GetExtentAttr().Set(extent, *(() if frame is None else (frame,)))
        self._reach = max(self._reach, float(np.linalg.norm(np.abs(corners).max(axis=0))))

    def _new_mesh(self, prototype: int, name: str, form: Form) -> Any:
        geometry = self.usd.UsdGeom
        path = f"{self._homes[prototype]}/{self.usd.Tf.MakeValidIdentifier(name)}"
        while self.stage.GetPrimAtPath(path):
            path += "_"
        mesh = geometry.Mesh.Define(self.stage, path)
        mesh.CreateSubdivisionSchemeAttr(geometry.Tokens.none)
        mesh.CreateFaceVertexCountsAttr(self._array("sizes", form))
        mesh.CreateFaceVertexIndicesAttr(self._array("corners", form))
        mesh.SetNormalsInterpolation(PER[form.per])
        if form.mirrored:
            mesh.CreateOrientationAttr(geometry.Tokens.leftHanded)
        if form.uv is not None:
            types = self.usd.Sdf.ValueTypeNames
            st = geometry.PrimvarsAPI(mesh).CreatePrimvar(
                "st", types.TexCoord2fArray, geometry.Tokens.faceVarying
            )
            st.Set(self._array("uv", form))
        self._dress(mesh, form)
        return mesh

    def _array(self, field: str, form: Form) -> Any:
        return getattr(self.usd.Vt, BUFFERS[field]).FromNumpy(
            np.ascontiguousarray(getattr(form, field))
        )

    def _dress(self, mesh, form: Form) -> None:
        """Bind the materials of the mesh: to it, or to its faces where they have several."""
        shade = self.usd.UsdShade
        slots = np.unique(form.slots).tolist()
        parts = [mesh.GetPrim()]
        if len(slots) > 1:
            api = shade.MaterialBindingAPI.Apply(mesh.GetPrim())
            token = self.usd.Vt.IntArray
            parts = [
                api.CreateMaterialBindSubset(
                    f"slot_{slot}",
                    token.FromNumpy(np.flatnonzero(form.slots == slot).astype(np.int32)),
                ).GetPrim()
                for slot in slots
            ]
            api.SetMaterialBindSubsetsFamilyType(self.usd.UsdGeom.Tokens.partition)
        for part, slot in zip(parts, slots, strict=True):
            shade.MaterialBindingAPI.Apply(part).Bind(self.materials.of(form.materials[slot]))

    def agents(self, number: float, **columns: np.ndarray | None) -> None:
        """Write the agents in a frame.

        columns: positions (a, 3) float32, orientations (a, 4) x y z w, prototypes (a,) int32,
            hidden (h,) int64 ids; scales (a,), velocities (a, 3) per second, or None; looks (a,) of
            all frames.
        """
        vt = self.usd.Vt
        instancer = self.instancer
        place = columns["positions"]
        instancer.GetPositionsAttr().Set(vt.Vec3fArray.FromNumpy(place), number)
        turned = np.ascontiguousarray(columns["orientations"], np.float16)
        instancer.GetOrientationsAttr().Set(vt.QuathArray.FromNumpy(turned), number)
        instancer.GetProtoIndicesAttr().Set(vt.IntArray.FromNumpy(columns["prototypes"]), number)
        instancer.GetInvisibleIdsAttr().Set(vt.Int64Array.FromNumpy(columns["hidden"]), number)
        if columns["scales"] is not None:
            sizes = np.repeat(columns["scales"].astype(np.float32)[:, None], 3, axis=1)
            instancer.GetScalesAttr().Set(vt.Vec3fArray.FromNumpy(sizes), number)
        if columns["velocities"] is not None:
            instancer.GetVelocitiesAttr().Set(
                vt.Vec3fArray.FromNumpy(columns["velocities"]), number
            )
        reach = self._reach * (1.0 if columns["scales"] is None else float(columns["scales"].max()))
        extent = vt.Vec3fArray.FromNumpy(
            np.array([place.min(axis=0) - reach, place.max(axis=0) + reach], np.float32)
        )
        instancer.CreateExtentAttr().Set(extent, number)
        # of the whole crowd, so that a viewer draws its bounds without reading the agents
        self.model.SetExtentsHint(extent, number)
        primvar = self.usd.UsdGeom.PrimvarsAPI(instancer).CreatePrimvar(
            "looks", self.usd.Sdf.ValueTypeNames.FloatArray, "vertex"
        )
        primvar.Set(vt.FloatArray.FromNumpy(columns["looks"]))

    def save(self, frames: tuple[int, int]) -> None:
        """Write the file to disk; frames: the first and the last."""
        self.stage.SetStartTimeCode(frames[0])
        self.stage.SetEndTimeCode(frames[1])
        speed = scene_data.frame_rate(self.scene)
        self.stage.SetTimeCodesPerSecond(speed)
        self.stage.SetFramesPerSecond(speed)
        with self._writing():
            self.stage.GetRootLayer().Save()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Raise CrowdError where OpenUSD cannot write the file."""
        try:
            yield
        except self.usd.Tf.ErrorException as error:
            reason = (re.findall(r" : '(.*?)'", str(error)) or ["it does not say why"])[
                0
            ].rpartition(": ")[2]
            raise CrowdError(
                f"OpenUSD could not write {printable(self.path)} ({reason}): free space there, or "
                f"choose another folder."
            ) from None
