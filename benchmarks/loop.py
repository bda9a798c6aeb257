"""The C loop (loop.c), called on the project's own arrays.

It is built with the machine's compiler.
"""

import ctypes
import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from crowd_lod_extension.crowd_lod.crowd.agents import Crowd, Group
from crowd_lod_extension.crowd_lod.crowd.state_machine import StateMachine
from crowd_lod_extension.crowd_lod.culling.camera import Camera
from crowd_lod_extension.crowd_lod.culling.frustum import frustum_of
from crowd_lod_extension.crowd_lod.world.maps import LabelMap

FLAGS = ("-O3", "-march=native", "-shared", "-fPIC")


@cache
def library() -> ctypes.CDLL | None:
    """The loops; None where there is no C compiler that makes them."""
    compiler = next(
        filter(None, map(shutil.which, (os.environ.get("CC", "cc"), "gcc", "clang"))), None
    )
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "loop.so"
        compilation = subprocess.run(
            [compiler, *FLAGS, str(Path(__file__).with_name("loop.c")), "-o", str(target), "-lm"]
        )
        return ctypes.CDLL(str(target)) if not compilation.returncode else None


def _at(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


class Cull:
    """Culling, LOD and sorting of a crowd of one group.

    Its agents stay in the order they are in.
    """

    def __init__(self, crowd: Crowd, group: Group, thresholds: np.ndarray):
        self.crowd = crowd
        self.group = group
        self.thresholds = np.ascontiguousarray(thresholds, np.float64)
        self.buckets = np.zeros((len(thresholds) + 1, len(crowd)), np.int32)

    def __call__(self, camera: Camera) -> np.ndarray:
        """Agents a LOD (n,) int64; their indices are in `buckets`."""
        frustum = frustum_of(camera)
        crowd = self.crowd
        number = ctypes.c_double
        sides = np.column_stack(
            [frustum.normals, frustum.offsets + frustum.normals @ camera.origin]
        )
        depth = np.append(camera.Z, camera.Z @ camera.origin)
        counts = np.zeros(len(self.buckets), np.int64)
        library().cull(
            ctypes.c_int64(len(crowd)),
            _at(crowd.x),
            _at(crowd.y),
            _at(crowd.z),
            number(self.group.center),
            number(self.group.radius),
            _at(sides),
            _at(depth),
            len(self.thresholds),
            _at(self.thresholds),
            _at(self.buckets),
            _at(counts),
        )
        return counts


class Step:
    """One step of behavior after another, on copies of a crowd's columns.

    No timers, no random choices.
    """

    def __init__(self, crowd: Crowd, machine: StateMachine, world: LabelMap, seconds: float):
        self.columns = [np.array(c) for c in (crowd.x, crowd.y, crowd.heading, crowd.state)]
        area = world.area
        velocity = np.ascontiguousarray(machine.velocity)
        self.tables = [
            np.array([area.x_min, area.y_min, area.x_max, area.y_max]),
            np.ascontiguousarray(machine.next_state),
            velocity,
            np.arctan2(velocity[..., 1], velocity[..., 0]).astype(np.float32),
        ]
        self.labels = np.ascontiguousarray(world.labels)
        self.seconds = seconds

    def __call__(self) -> None:
        rows, columns = self.labels.shape
        area, following, *tables = self.tables
        library().step(
            ctypes.c_int64(len(self.columns[0])),
            *map(_at, self.columns),
            _at(self.labels),
            ctypes.c_int64(rows),
            ctypes.c_int64(columns),
            _at(area),
            ctypes.c_int64(following.shape[1]),
            _at(following),
            *map(_at, tables),
            ctypes.c_double(self.seconds),
        )
