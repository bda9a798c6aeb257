"""The costs of this machine, as *Calibrate* found them: kept in the user's folder.

One file, COSTS, holds a fit for each machine, device, version of Blender and engine.
"""

import json
import platform
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import bpy

from ...crowd_lod.format import counted
from ...crowd_lod.levels.cost_model import SECONDS, Costs, default_costs
from ...crowd_lod.reporting import files
from . import console, scene_data

COSTS = "costs.json"
EXTENSION = __package__.rpartition(".operators")[0]
# what tells fits apart, fields of Calibration
KEY = "machine", "device", "blender", "engine"


@dataclass(frozen=True)
class Calibration:
    """A fit of one machine.

    machine: its name in the network.
    device: what renders, as device_of says.
    blender: its version.
    engine: one of cost_model.NAMES.
    seconds: as of Costs.
    date: when it was made, ISO 8601 in UTC.
    off: root mean square of the relative errors of the renders.
    renders: how many.
    """

    machine: str
    device: str
    blender: str
    engine: str
    seconds: dict[str, float]
    date: str
    off: float
    renders: int

    @property
    def age(self) -> str:
        """How long ago it was made, in words."""
        days = (datetime.now(UTC) - datetime.fromisoformat(self.date)).days
        return f"{counted(days, 'day')} old" if days > 0 else "less than a day old"

    @property
    def costs(self) -> Costs:
        """The costs; their basis has no age, so that two runs say the same."""
        basis = f"this machine ({self.device}), calibrated on {self.date[:10]}"
        return Costs(self.engine, self.seconds, basis)


def device_of(scene: bpy.types.Scene) -> str:
    """Return what renders `scene`: of Cycles CPU, or the graphics cards; of EEVEE the library."""
    preferences = bpy.context.preferences
    if scene_data.engine_of(scene) == "EEVEE":
        return preferences.system.gpu_backend
    addon = preferences.addons.get("cycles")
    with console.quiet():  # asked for its device, Cycles looks for all that there are, and says so
        if scene.cycles.device == "CPU" or addon is None:
            return "CPU"
        kind = addon.preferences.compute_device_type
        cards = [
            device.name
            for device in addon.preferences.devices
            if device.use and device.type == kind
        ]
    return " and ".join(cards) or "CPU"


def key_of(scene: bpy.types.Scene) -> dict[str, str]:
    """Return what a fit is for that holds for renders of `scene` here: a value for each of KEY."""
    return {
        "machine": platform.node(),
        "device": device_of(scene),
        "blender": bpy.app.version_string,
        "engine": scene_data.engine_of(scene),
    }


def costs_path() -> Path:
    """Return the path of COSTS, in the extension's folder for the user or in Blender's settings."""
    try:
        folder = bpy.utils.extension_path_user(EXTENSION)
    except ValueError:  # a checkout that is no installed extension
        folder = bpy.utils.user_resource("CONFIG", path="crowd_lod")
    return Path(folder) / COSTS


def calibration_of(scene: bpy.types.Scene) -> Calibration | None:
    """Return the fit that holds for renders of `scene` on this machine, if there is one."""
    key = key_of(scene)
    for fit in _stored_fits():
        if all(getattr(fit, name) == value for name, value in key.items()):
            return fit
    return None


def costs_of(scene: bpy.types.Scene) -> Costs:
    """Return the costs of the scene's engine and samples: this machine's, else the developers'."""
    calibration = calibration_of(scene)
    engine = scene_data.engine_of(scene)
    samples = scene_data.samples_of(scene)
    if calibration is None:
        return default_costs(engine, samples)
    return calibration.costs.with_samples(samples)


def store_fit(fit: Calibration) -> Path:
    """Keep the fit in place of the one before; return the path of the file."""
    path = costs_path()
    path.parent.mkdir(parents=True, exist_ok=True)
    key = [getattr(fit, name) for name in KEY]
    others = [other for other in _stored_fits() if [getattr(other, name) for name in KEY] != key]
    with files.staged_file(path) as part:
        part.write_text(json.dumps([asdict(each) for each in [*others, fit]], indent=1), "utf-8")
    return path


def _stored_fits() -> list[Calibration]:
    """Return the fits of the file; none that was spoilt, or counts other things than today's."""
    with suppress(OSError, ValueError, TypeError, KeyError):
        fits = [Calibration(**row) for row in json.loads(costs_path().read_text("utf-8"))]
        return [
            fit
            for fit in fits
            if fit.seconds.keys() == SECONDS[fit.engine].keys()
            and all(seconds >= 0 for seconds in fit.seconds.values())
        ]
    return []
